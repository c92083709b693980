#include "acoustics/audio_scanner.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <iterator>
#include <mutex>
#include <optional>
#include <span>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "acoustics/evidence.h"
#include "acoustics/peak_level.h"

namespace soundmap::acoustics {
namespace {

constexpr frames::TimeNs kMaxJump_ns = 20'000'000;
constexpr frames::TimeNs kMaxStamp_ns = std::int64_t{1} << 62;

}  // namespace

struct AudioScanner::Tables {
  AcousticsConfig config;
  FrameLayout layout;
  std::vector<Eigen::Vector3d> mic_in_array_m;
  std::shared_ptr<const SrpPhat> srp;
  std::optional<PeakFinder> finder;  // with PeakEvidence
  std::optional<PeakLevel> level;    // with the finder
  std::optional<PeakRipple> ripple;  // with the finder, of microphones in a plane
};

absl::StatusOr<std::shared_ptr<const AudioScanner::Tables>> AudioScanner::MakeTables(
    const AcousticsConfig& config, const frames::Calibration& calibration) {
  absl::StatusOr<FrameLayout> layout =
      FrameLayout::Create(config, calibration.audio_sample_rate_hz);
  if (!layout.ok()) return layout.status();
  absl::StatusOr<std::shared_ptr<const SrpPhat>> srp = SrpPhat::Create(
      *layout, config.speed_of_sound_mps, calibration.mic_in_array_m, config.MakeGrid());
  if (!srp.ok()) return srp.status();
  auto tables =
      std::make_shared<Tables>(Tables{config, *layout, calibration.mic_in_array_m, *std::move(srp),
                                      std::nullopt, std::nullopt, std::nullopt});
  if (const auto* evidence = std::get_if<PeakEvidence>(&config.evidence)) {
    tables->finder.emplace(*evidence, *layout, config.speed_of_sound_mps,
                           calibration.mic_in_array_m, tables->srp);
    tables->level.emplace(*layout, config.speed_of_sound_mps, calibration.mic_in_array_m);
    if (tables->finder->beam().array_rank() == 2) {
      tables->ripple.emplace(*layout, config.speed_of_sound_mps, calibration.mic_in_array_m);
    }
  }
  return tables;
}

absl::StatusOr<std::shared_ptr<const AudioScanner::Tables>> AudioScanner::SharedTables(
    const AcousticsConfig& config, const frames::Calibration& calibration) {
  // Held while tables are made, so that robots that start together make theirs once.
  static std::mutex mutex;
  static std::vector<std::weak_ptr<const Tables>> in_use;  // guarded by mutex
  const std::lock_guard lock(mutex);
  std::erase_if(in_use, [](const auto& tables) { return tables.expired(); });
  for (const auto& weak : in_use) {
    const std::shared_ptr<const Tables> tables = weak.lock();
    if (tables && tables->config == config &&
        tables->layout.sample_rate_hz == calibration.audio_sample_rate_hz &&
        tables->mic_in_array_m == calibration.mic_in_array_m) {
      return tables;
    }
  }
  auto tables = MakeTables(config, calibration);
  if (!tables.ok()) return tables;
  in_use.push_back(*tables);
  // A robot that comes back finds its tables, which take a third of a second of a processor.
  constexpr std::size_t kKept = 4;
  static std::deque<std::shared_ptr<const Tables>> newest;  // guarded by mutex
  newest.push_back(*tables);
  if (newest.size() > kKept) newest.pop_front();
  return tables;
}

AudioScanner::AudioScanner(std::shared_ptr<const Tables> tables)
    : tables_(std::move(tables)),
      layout_(tables_->layout),
      stft_(layout_, tables_->srp->microphones()),
      polarity_(layout_, tables_->config.speed_of_sound_mps, tables_->mic_in_array_m),
      clock_(layout_.sample_rate_hz) {}

const geometry::DirectionGrid& AudioScanner::grid() const { return tables_->srp->grid(); }

std::optional<Eigen::Vector3d> AudioScanner::array_normal() const {
  if (!tables_->finder || tables_->finder->beam().array_rank() != 2) return std::nullopt;
  return tables_->finder->beam().array_axis();
}

std::vector<float> AudioScanner::Likelihood(std::span<const Peak> peaks) const {
  return tables_->finder->Likelihood(peaks);
}

absl::StatusOr<std::unique_ptr<AudioScanner>> AudioScanner::Create(
    const AcousticsConfig& config, const frames::Calibration& calibration) {
  absl::Status status = calibration.Validate();
  if (!status.ok()) return status;
  if (calibration.mic_in_array_m.empty()) {
    return absl::InvalidArgumentError("the calibration has no microphones");
  }
  absl::StatusOr<std::shared_ptr<const Tables>> tables = SharedTables(config, calibration);
  if (!tables.ok()) return tables.status();
  return std::unique_ptr<AudioScanner>(new AudioScanner(*std::move(tables)));
}

absl::StatusOr<std::vector<LikelihoodScan>> AudioScanner::Push(const frames::AudioBlock& block) {
  const int channels = tables_->srp->microphones();
  if (block.channels != channels || block.sample_rate_hz != layout_.sample_rate_hz) {
    return absl::InvalidArgumentError(absl::StrCat(
        "an audio block has ", block.channels, " channels at ", block.sample_rate_hz,
        " Hz; the calibration has ", channels, " microphones at ", layout_.sample_rate_hz, " Hz"));
  }
  if (block.samples.size() % channels != 0) {
    return absl::InvalidArgumentError(absl::StrCat("an audio block has ", block.samples.size(),
                                                   " samples, which do not fill ", channels,
                                                   " channels"));
  }
  if (block.stamp_ns < 0 || block.stamp_ns > kMaxStamp_ns) {
    return absl::InvalidArgumentError(absl::StrCat("an audio block's stamp is ", block.stamp_ns,
                                                   " ns, outside the years 1970 to 2116"));
  }
  std::vector<LikelihoodScan> scans;
  if (block.samples.empty()) return scans;
  if (!clock_.empty()) {
    const frames::TimeNs jump_ns = block.stamp_ns - clock_.TimeOf(next_sample_);
    if (block.stamp_ns < last_stamp_ns_ || jump_ns < -kMaxJump_ns) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "an audio block's time runs backwards: it starts %.3f s before the end of the last one",
          -frames::SecondsFromNs(jump_ns)));
    }
    if (jump_ns > kMaxJump_ns) {
      LikelihoodScan lost;
      lost.begin_ns =
          clock_.TimeOf(next_sample_ - static_cast<std::int64_t>(pending_.size()) / channels);
      lost.end_ns = clock_.TimeOf(next_sample_);
      lost.fault = absl::StrFormat("a gap of %.3f s in the audio", frames::SecondsFromNs(jump_ns));
      scans.push_back(std::move(lost));
      pending_.clear();
      clock_.Restart();
      next_sample_ = 0;
    }
  }
  clock_.Add({next_sample_, block.stamp_ns});
  last_stamp_ns_ = block.stamp_ns;
  pending_.insert(pending_.end(), block.samples.begin(), block.samples.end());
  next_sample_ += static_cast<std::int64_t>(block.samples.size()) / channels;

  const std::size_t scan_values = static_cast<std::size_t>(layout_.scan_samples()) * channels;
  const std::size_t period_values =
      static_cast<std::size_t>(layout_.scan_period_samples()) * channels;
  std::size_t done = 0;
  for (; pending_.size() - done >= scan_values; done += period_values) {
    scans.push_back(
        Scan(pending_.data() + done,
             next_sample_ - static_cast<std::int64_t>(pending_.size() - done) / channels));
  }
  pending_.erase(pending_.begin(), pending_.begin() + static_cast<std::ptrdiff_t>(done));
  return scans;
}

LikelihoodScan AudioScanner::Scan(const std::int16_t* samples, std::int64_t first_sample) {
  LikelihoodScan result;
  result.begin_ns = clock_.TimeOf(first_sample);
  result.end_ns = clock_.TimeOf(first_sample + layout_.scan_samples());
  result.fault = FaultIn(samples, result.dead_microphones);
  if (!result.fault.empty()) return result;

  const Tables* tables = tables_.get();
  Stft* stft = &stft_;
  if (!result.dead_microphones.empty()) {
    Remainder* rest = RemainderWithout(result.dead_microphones);
    if (rest == nullptr) {
      result.fault = "the microphones that are not dead cannot tell directions";
      return result;
    }
    tables = rest->tables.get();
    stft = &rest->stft;
  }
  std::set_difference(polarity_.inverted().begin(), polarity_.inverted().end(),
                      result.dead_microphones.begin(), result.dead_microphones.end(),
                      std::back_inserter(result.inverted_microphones));
  if (!result.dead_microphones.empty() || !result.inverted_microphones.empty()) {
    Mend(samples, result.dead_microphones, result.inverted_microphones);
    samples = mended_.data();
  }
  const std::size_t count =
      static_cast<std::size_t>(layout_.scan_samples()) * tables->srp->microphones();
  const PhatSpectra& spectra =
      stft->Analyze({samples, count}, [&](int frame, const FrameSpectra& transforms) {
        if (tables->ripple) tables->ripple->Keep(frame, transforms, frames_);
      });
  if (tables->finder) polarity_.Add(stft->newest_frame(), result.dead_microphones);
  Done(Step::kSpectra);
  tables->srp->Scan(spectra, scan_);
  Done(Step::kPower);
  const AudioScan& scan = scan_;
  if (!tables->finder) {
    const auto* scaled = std::get_if<ScaledPower>(&tables->config.evidence);
    result.likelihood = scaled != nullptr
                            ? ScaledPowerLikelihood(scan.power, *scaled)
                            : DoubleThresholdLikelihood(
                                  scan.power, std::get<DoubleThreshold>(tables->config.evidence));
    Done(Step::kEvidence);
    return result;
  }
  Peaks found = tables->finder->Find(scan, rest_);
  result.likelihood = tables->finder->Likelihood(found.peaks);
  result.noise_floor = found.noise_floor;
  result.maxima = std::move(found.maxima);
  result.peaks = std::move(found.peaks);
  result.levels = tables->level->Levels(stft->newest_frame(), result.peaks);
  if (tables->ripple) result.ripples = tables->ripple->Ripples(frames_, result.peaks);
  Done(Step::kEvidence);
  return result;
}

AudioScanner::Remainder* AudioScanner::RemainderWithout(const std::vector<int>& dead) {
  if (remainder_ && remainder_->dead == dead) return remainder_.get();
  frames::Calibration calibration;
  calibration.audio_sample_rate_hz = layout_.sample_rate_hz;
  for (int n = 0; n < tables_->srp->microphones(); ++n) {
    if (!std::binary_search(dead.begin(), dead.end(), n)) {
      calibration.mic_in_array_m.push_back(tables_->mic_in_array_m[n]);
    }
  }
  auto tables = SharedTables(tables_->config, calibration);
  if (!tables.ok()) return nullptr;
  Stft stft((*tables)->layout, (*tables)->srp->microphones());
  remainder_ = std::make_unique<Remainder>(Remainder{dead, *std::move(tables), std::move(stft)});
  return remainder_.get();
}

void AudioScanner::Mend(const std::int16_t* samples, const std::vector<int>& dead,
                        const std::vector<int>& inverted) {
  const int channels = tables_->srp->microphones();
  std::vector<int> factor(channels, 1);
  for (const int n : inverted) factor[n] = -1;
  for (const int n : dead) factor[n] = 0;
  mended_.clear();
  for (int s = 0; s < layout_.scan_samples(); ++s) {
    for (int n = 0; n < channels; ++n, ++samples) {
      if (factor[n] == 0) continue;
      mended_.push_back(static_cast<std::int16_t>(std::min(factor[n] * *samples, 32767)));
    }
  }
}

std::string AudioScanner::FaultIn(const std::int16_t* samples, std::vector<int>& dead) const {
  const int channels = tables_->srp->microphones();
  const int count = layout_.scan_samples();
  // A microphone that stands still for a hop does so from the start of some half hop to its end.
  const int half = layout_.hop_samples() / 2;
  const auto changes_in = [&](int first) {
    int moving = 0;  // those before it have changed
    for (int s = first + 1; s < first + half; ++s) {
      const std::int16_t* now = samples + static_cast<std::size_t>(s) * channels;
      // The first one that waits for a change leads.
      while (moving < channels && now[moving] != now[moving - channels]) ++moving;
    }
    return moving == channels;
  };
  bool all_move = half >= 2;
  for (int first = 0; all_move && first + half <= count; first += half) {
    all_move = changes_in(first);
  }
  if (all_move) return {};

  std::vector<int> run(channels, 1);
  std::vector<int> longest(channels, 1);
  for (int s = 1; s < count; ++s) {
    const std::int16_t* now = samples + static_cast<std::size_t>(s) * channels;
    for (int n = 0; n < channels; ++n) {
      run[n] = now[n] == now[n - channels] ? run[n] + 1 : 1;
      longest[n] = std::max(longest[n], run[n]);
    }
  }
  const auto still =
      static_cast<int>(std::count_if(longest.begin(), longest.end(), [this](int length) {
        return length >= layout_.hop_samples();
      }));
  if (still == 0) return {};
  for (int n = 0; n < channels; ++n) {
    if (longest[n] == count) dead.push_back(n);
  }
  const int alive = channels - static_cast<int>(dead.size());
  if (tables_->finder && static_cast<int>(dead.size()) == still && 4 * alive >= 3 * channels) {
    return {};
  }
  dead.clear();
  if (still == channels) return absl::StrCat("all ", channels, " microphones stand still");
  const int worst =
      static_cast<int>(std::max_element(longest.begin(), longest.end()) - longest.begin());
  const std::string others = still > 1 ? absl::StrCat(" and ", still - 1, " more") : "";
  if (longest[worst] == count) return absl::StrCat("mic_", worst, others, " dead: constant signal");
  return absl::StrFormat("mic_%d%s stood still for %.4f s: dropped samples", worst, others,
                         static_cast<double>(longest[worst]) / layout_.sample_rate_hz);
}

AudioScanner::State AudioScanner::state() const {
  return {last_stamp_ns_, next_sample_, clock_.points(), pending_, polarity_.state()};
}

absl::Status AudioScanner::Restore(State state) {
  const int channels = tables_->srp->microphones();
  const bool clock_runs =
      std::adjacent_find(state.clock.begin(), state.clock.end(), [](const auto& a, const auto& b) {
        return b.sample <= a.sample;
      }) == state.clock.end();
  const bool stamps_valid =
      std::all_of(state.clock.begin(), state.clock.end(), [&](const AudioClock::Point& point) {
        return point.stamp_ns >= 0 && point.stamp_ns <= kMaxStamp_ns && point.sample >= 0 &&
               point.sample < state.next_sample;
      });
  const auto pending = static_cast<std::int64_t>(state.pending.size()) / channels;
  if (!clock_runs || !stamps_valid || state.pending.size() % channels != 0 ||
      pending >= layout_.scan_samples() || pending > state.next_sample ||
      state.clock.empty() != (state.next_sample == 0) ||
      !polarity_.Restore(std::move(state.polarity))) {
    return absl::InvalidArgumentError(
        "the saved state of the audio scanner does not fit its configuration");
  }
  last_stamp_ns_ = state.last_stamp_ns;
  next_sample_ = state.next_sample;
  pending_ = std::move(state.pending);
  clock_.Restore(std::move(state.clock));
  return absl::OkStatus();
}

}  // namespace soundmap::acoustics
