#include "pipeline/listening.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "pipeline/serialization.h"
#include "ray_casting/reflections.h"

namespace boost::serialization {

template <class Archive>
void serialize(Archive& archive, soundmap::acoustics::AudioClock::Point& point, unsigned) {
  archive& point.sample& point.stamp_ns;
}

template <class Archive>
void serialize(Archive& archive, soundmap::acoustics::Polarity::State& state, unsigned) {
  archive& state.agreement& state.bin_weight& state.inverted;
}

template <class Archive>
void serialize(Archive& archive, soundmap::acoustics::AudioScanner::State& state, unsigned) {
  archive& state.last_stamp_ns& state.next_sample& state.clock& state.pending& state.polarity;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::Particle& particle, unsigned) {
  archive& particle.map_from_base& particle.log_weight;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::Correction& correction, unsigned) {
  archive& correction.estimate& correction.odom_from_base;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::Beam& beam, unsigned) {
  archive& beam.origin_in_base_m& beam.direction_in_base& beam.range_m;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::KeptScan& scan, unsigned) {
  archive& scan.stamp_ns& scan.odom_from_base& scan.beams& scan.jumped;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::Hypothesis& hypothesis, unsigned) {
  archive& hypothesis.particles& hypothesis.evidence& hypothesis.fit& hypothesis.recent& hypothesis
      .weight& hypothesis.taken_up_at;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::Health& health, unsigned) {
  archive& health.mean_fit& health.slow_fit& health.misfit_m& health.misfit& health.chance_m;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::LookBack& look_back, unsigned) {
  archive& look_back.particles& look_back.at_ns& look_back.health& look_back.found;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::Counters& counters, unsigned) {
  archive& counters.corrections& counters.resamplings& counters.scans_ignored& counters
      .scans_overflowed& counters.scans_empty& counters.odometry_ignored& counters
      .odometry_jumps& counters.searches& counters.losses& counters.recoveries& counters
      .scans_given_up;
}

// Boost.Serialization of this version knows boost::optional only.
template <class Archive, typename Value>
void serialize(Archive& archive, std::optional<Value>& optional, unsigned) {
  bool present = optional.has_value();
  archive& present;
  if (!present) {
    optional.reset();
  } else {
    if (!optional) optional = Value();
    archive&* optional;
  }
}

template <class Archive>
void serialize(Archive& archive, soundmap::frames::LaserLag::Turn& turn, unsigned) {
  archive& turn.begin_ns& turn.end_ns& turn.turn_rad;
}

template <class Archive>
void serialize(Archive& archive, soundmap::frames::LaserLag::State& lag, unsigned) {
  archive& lag.last& lag.waiting& lag.squared_error& lag.turns& lag.turned_rad;
}

template <class Archive>
void serialize(Archive& archive, soundmap::localization::LocalizerState& state, unsigned) {
  archive& state.particles& state.engine& state.odometry& state.raw_odometry& state
      .waiting_scans& state.corrections& state.newest_scan_ns& state.considered_until_ns& state
      .odom_from_particles& state.mean_fit& state.slow_fit& state.misfit_m& state.misfit& state
      .chance_m& state.rivalled& state.travelled_m& state.jumped& state.counters& state
      .odometry_limit& state.keep_from_ns& state.lost_since_ns& state.searching& state
      .search_from_ns& state.sectors_searched& state.unrivalled& state.since_sector_m& state
      .hypotheses& state.kept_scans& state.look_back& state.laser_lag_s& state.lag;
}

template <class Archive>
void serialize(Archive& archive, soundmap::pipeline::Listening::Counters& counters, unsigned) {
  archive& counters.audio_scans& counters.backward_odometry& counters.backward_lidar& counters
      .dead_microphone_scans& counters.faulty_audio_scans& counters
      .inverted_microphone_scans& counters.inverted_microphones& counters.refused_audio& counters
      .scans_without_range& counters.scans_without_pose& counters.unheard_ns;
}

}  // namespace boost::serialization

namespace soundmap::pipeline {
namespace {

// LIDAR scans, and audio scans of each band, that wait for what comes after them; with more, the
// oldest are done without.
constexpr std::size_t kMaxLidarScans = 64;
constexpr std::size_t kMaxPendingScans = 64;

// A new audio scan is not older than this when it comes.
constexpr frames::TimeNs kNewScanAge_ns = 5'000'000'000;

// SaveState()'s bytes: a later layout has another number.
constexpr std::uint64_t kStateVersion = 0x534d'4c06;

// A peak lies where a ray through it ends; neighbouring rays end in one voxel or the next.
const double kMinPeakCosine = std::cos(geometry::RadFromDeg(5.0));

// Where the peaks' sound comes from and how loud it is there: a level at 1 m, by the square of the
// distance. Peaks without an end point near their direction have no place; those of an array in a
// plane have one above it and one below.
std::vector<sound_map::HeardPeak> PlacePeaks(const acoustics::LikelihoodScan& scan,
                                             const sound_map::EvidenceScan& evidence,
                                             const Eigen::Isometry3d& map_from_array,
                                             const std::optional<Eigen::Vector3d>& array_normal,
                                             double voxel_size_m) {
  std::vector<Eigen::Vector3d> supporting_in_map;
  for (const sound_map::EndPoint& end_point : evidence.end_points) {
    if (end_point.likelihood > 0.5f) {
      supporting_in_map.push_back(geometry::PointFromKey(end_point.key, voxel_size_m));
    }
  }
  std::vector<sound_map::HeardPeak> heard;
  for (std::size_t i = 0; i < scan.levels.size(); ++i) {
    std::vector<Eigen::Vector3d> directions_in_array = {scan.peaks[i].direction_in_array};
    if (array_normal) {
      directions_in_array.push_back(
          directions_in_array[0] - 2.0 * array_normal->dot(directions_in_array[0]) * *array_normal);
    }
    bool has_ripple = false;  // one of the two places is enough
    for (const Eigen::Vector3d& in_array : directions_in_array) {
      const Eigen::Vector3d direction = map_from_array.linear() * in_array;
      double best_cosine = kMinPeakCosine;
      double range_m = 0.0;
      for (const Eigen::Vector3d& place : supporting_in_map) {
        const Eigen::Vector3d ray = place - map_from_array.translation();
        const double length_m = ray.norm();
        const double cosine = ray.dot(direction) / length_m;
        if (!(cosine > best_cosine)) continue;
        best_cosine = cosine;
        range_m = length_m;
      }
      if (range_m == 0.0) continue;
      sound_map::HeardPeak& peak = heard.emplace_back();
      peak.place_in_map_m = map_from_array.translation() + range_m * direction;
      if (&in_array == &directions_in_array.front()) {
        peak.surface_normal_in_map =
            (map_from_array.linear() * scan.peaks[i].surface_normal_in_array).cast<float>();
      }
      if (i < scan.ripples.size() && !has_ripple) peak.ripple = scan.ripples[i];
      has_ripple = true;
      for (int band = 0; band < frames::kOctaveBands; ++band) {
        peak.power_at_1m[band] = scan.levels[i][band] * static_cast<float>(range_m * range_m);
      }
    }
  }
  return heard;
}

frames::TimeNs MiddleOf(const frames::LidarScan& scan) {
  if (scan.time_offset_ns.empty()) return scan.stamp_ns;
  return scan.stamp_ns +
         *std::max_element(scan.time_offset_ns.begin(), scan.time_offset_ns.end()) / 2;
}

// How the robot is heard in one band. Which scans there are, and which of them have a fault, says
// the audio alone: the bands wait for the same and are ready together.
struct BandEar {
  std::uint8_t band = kMainBand;
  std::unique_ptr<acoustics::AudioScanner> scanner;
  ray_casting::RayCaster caster;
  std::deque<acoustics::LikelihoodScan> pending_scans;  // oldest first
};

}  // namespace

struct Listening::State {
  const Profile& profile;
  StageClock* const clock;
  const frames::Calibration calibration;
  std::shared_ptr<const PreparedBuilding> building;
  localization::Localizer localizer;
  std::vector<BandEar> ears;               // by band; none: the robot has no audio
  std::vector<std::string> unheard_bands;  // a sentence each

  frames::OdometryTrack track;
  std::deque<frames::LidarScan> lidar_scans;  // oldest first
  std::int64_t heard = 0;                     // frames
  Counters counters;

  // Section V's points of the LIDAR scan that the last audio scan used.
  std::optional<frames::TimeNs> view_stamp_ns;
  frames::TimeNs view_reference_ns = 0;
  std::vector<Eigen::Vector3f> view_point_in_base;

  template <typename SensorFrame>
  void Localize(const SensorFrame& frame, Output& output);
  void Lap(Stage stage) {
    if (clock != nullptr) clock->Lap(stage);
  }

  void Hear(const frames::Odometry& odometry);
  void Hear(const frames::LaserScan&) {}
  void Hear(frames::LidarScan&& scan);
  void Hear(const frames::AudioBlock& block);
  void Count(const acoustics::LikelihoodScan& scan);

  absl::Status AddEar(std::uint8_t band, const acoustics::AcousticsConfig& config);
  // t_k of the oldest audio scan that waits.
  std::optional<frames::TimeNs> oldest_pending_ns() const;
  // Whether nothing that may still be heard changes what the scan is given.
  bool IsReady(const acoustics::LikelihoodScan& scan) const;
  // Whether the robot may learn where it was then.
  bool Waits(const acoustics::LikelihoodScan& scan) const;
  // Whose oldest scan is the next one to fuse; null: all wait.
  BandEar* NextToFuse(bool all);
  void Drain(bool all, Output& output);
  void Fuse(const BandEar& ear, acoustics::LikelihoodScan scan, Output& output);
  bool View(frames::TimeNs time_ns);
};

Listening::Listening(std::unique_ptr<State> state) : state_(std::move(state)) {}
Listening::~Listening() = default;

absl::Status Listening::State::AddEar(std::uint8_t band, const acoustics::AcousticsConfig& config) {
  auto scanner = acoustics::AudioScanner::Create(config, calibration);
  if (!scanner.ok()) return scanner.status();
  if (clock != nullptr) {
    (*scanner)->WatchSteps([clock = clock](acoustics::AudioScanner::Step step) {
      using Step = acoustics::AudioScanner::Step;
      clock->Lap(step == Step::kSpectra ? Stage::kSpectra
                 : step == Step::kPower ? Stage::kPower
                                        : Stage::kEvidence);
    });
  }
  auto caster = ray_casting::RayCaster::Create(profile.ray_casting, (*scanner)->grid(),
                                               calibration.base_from_array, building->surroundings);
  if (!caster.ok()) return caster.status();
  ears.push_back({band, *std::move(scanner), *std::move(caster), {}});
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Listening>> Listening::Create(
    const Profile& profile, const std::vector<Band>& bands, const frames::Calibration& calibration,
    std::shared_ptr<const PreparedBuilding> building,
    const std::optional<geometry::Pose2>& initial_pose, std::uint64_t seed, StageClock* clock) {
  std::optional<localization::InitialPose> start;
  if (initial_pose) start = localization::InitialPose{*initial_pose};
  auto localizer = localization::Localizer::Create(building->plan, calibration, start, seed);
  if (!localizer.ok()) return localizer.status();
  std::unique_ptr<State> state(new State{profile,
                                         clock,
                                         calibration,
                                         building,
                                         *std::move(localizer),
                                         {},
                                         {},
                                         frames::OdometryTrack()});
  if (!calibration.mic_in_array_m.empty() && calibration.audio_sample_rate_hz != 0) {
    const absl::Status main = state->AddEar(kMainBand, profile.acoustics);
    if (!main.ok()) return main;
    for (std::size_t i = 0; i < bands.size(); ++i) {
      const Band& band = bands[i];
      const int rate_hz = calibration.audio_sample_rate_hz;
      const absl::Status added =
          2.0 * band.f_min_hz >= rate_hz
              ? absl::InvalidArgumentError(
                    absl::StrFormat("audio sampled at %d Hz does not reach it", rate_hz))
              : state->AddEar(static_cast<std::uint8_t>(1 + i), ProfileOf(band, profile).acoustics);
      if (added.ok()) continue;
      state->unheard_bands.push_back(
          absl::StrFormat("nothing was heard in the band '%s', %g to %g Hz: %s", band.name,
                          band.f_min_hz, band.f_max_hz, std::string(added.message())));
    }
  }
  return std::unique_ptr<Listening>(new Listening(std::move(state)));
}

void Listening::Localize(const frames::Frame& frame, Output& output) {
  state_->Lap(Stage::kSession);
  std::visit([&](const auto& sensor_frame) { state_->Localize(sensor_frame, output); }, frame);
  state_->Lap(Stage::kLocalize);
}

void Listening::Hear(frames::Frame&& frame, Output& output) {
  std::visit([&](auto& sensor_frame) { state_->Hear(std::move(sensor_frame)); }, frame);
  ++state_->heard;
  state_->Drain(/*all=*/false, output);
}

void Listening::SkipHearing() { ++state_->heard; }

bool Listening::waits() const {
  return std::any_of(state_->ears.begin(), state_->ears.end(), [this](const BandEar& ear) {
    return !ear.pending_scans.empty() && state_->Waits(ear.pending_scans.front());
  });
}

std::int64_t Listening::heard() const { return state_->heard; }

std::optional<localization::OdometryFrame> Listening::odometry_frame() const {
  return state_->localizer.odometry_frame();
}

void Listening::Finish(Output& output) {
  for (const BandEar& ear : state_->ears) {
    if (ear.band != kMainBand || ear.pending_scans.empty()) continue;
    const acoustics::LikelihoodScan& oldest = ear.pending_scans.front();
    if (!state_->Waits(oldest)) continue;
    state_->counters.unheard_ns =
        state_->localizer.newest_odometry_ns().value_or(0) - oldest.begin_ns;
  }
  state_->Drain(/*all=*/true, output);
}

const Listening::Counters& Listening::counters() const { return state_->counters; }

template <typename SensorFrame>
void Listening::State::Localize(const SensorFrame& frame, Output& output) {
  if constexpr (std::is_same_v<SensorFrame, frames::Odometry> ||
                std::is_same_v<SensorFrame, frames::LaserScan>) {
    const std::vector<localization::PoseEstimate> corrections = localizer.Add(frame);
    if (const auto learnt_since_ns = localizer.learnt_since_ns()) {
      // Where it was meanwhile, instead of the guesses.
      output.path = localizer.Path(*learnt_since_ns, frame.stamp_ns);
    }
    output.path.insert(output.path.end(), corrections.begin(), corrections.end());
  }
}

void Listening::State::Hear(const frames::Odometry& odometry) {
  if (!track.Add(odometry)) ++counters.backward_odometry;
}

void Listening::State::Hear(frames::LidarScan&& scan) {
  if (ears.empty()) return;
  if (!lidar_scans.empty() && scan.stamp_ns <= lidar_scans.back().stamp_ns) {
    ++counters.backward_lidar;
    return;
  }
  const frames::TimeNs stamp_ns = scan.stamp_ns;
  lidar_scans.push_back(std::move(scan));
  // The oldest pending scan may still want the one before the newest that is not after it.
  const frames::TimeNs oldest_ns = oldest_pending_ns().value_or(stamp_ns);
  const frames::TimeNs keep_ns =
      oldest_ns - 2 * frames::NsFromSeconds(profile.ray_casting.max_lidar_age_s);
  while (lidar_scans.size() > kMaxLidarScans ||
         (lidar_scans.size() > 1 && lidar_scans.front().stamp_ns < keep_ns)) {
    lidar_scans.pop_front();
  }
}

void Listening::State::Hear(const frames::AudioBlock& block) {
  if (ears.empty()) ++counters.refused_audio;
  for (BandEar& ear : ears) {
    auto scans = ear.scanner->Push(block);
    if (!scans.ok()) {
      if (ear.band == kMainBand) ++counters.refused_audio;
      continue;
    }
    for (acoustics::LikelihoodScan& scan : *scans) {
      if (ear.band == kMainBand) Count(scan);
      if (scan.fault.empty()) ear.pending_scans.push_back(std::move(scan));
    }
  }
}

void Listening::State::Count(const acoustics::LikelihoodScan& scan) {
  if (!scan.fault.empty()) {
    ++counters.faulty_audio_scans;
    return;
  }
  if (!scan.dead_microphones.empty()) ++counters.dead_microphone_scans;
  if (!scan.inverted_microphones.empty()) ++counters.inverted_microphone_scans;
  for (const int n : scan.inverted_microphones) {
    std::vector<int>& all = counters.inverted_microphones;
    const auto at = std::lower_bound(all.begin(), all.end(), n);
    if (at == all.end() || *at != n) all.insert(at, n);
  }
}

std::optional<frames::TimeNs> Listening::State::oldest_pending_ns() const {
  std::optional<frames::TimeNs> oldest_ns;
  for (const BandEar& ear : ears) {
    if (ear.pending_scans.empty()) continue;
    const frames::TimeNs mid_ns = ear.pending_scans.front().mid_ns();
    oldest_ns = std::min(oldest_ns.value_or(mid_ns), mid_ns);
  }
  return oldest_ns;
}

bool Listening::State::IsReady(const acoustics::LikelihoodScan& scan) const {
  if (track.empty()) return false;
  const frames::TimeNs mid_ns = scan.mid_ns();
  const frames::TimeNs now_ns = track.newest_ns();
  if (now_ns < mid_ns + frames::NsFromSeconds(profile.fusion.pose_wait_s)) return false;
  // The nearest LIDAR scan is known once one is newer than the audio scan, or none can come in
  // time.
  const bool lidar_known = !lidar_scans.empty() && MiddleOf(lidar_scans.back()) >= mid_ns;
  return lidar_known || now_ns >= mid_ns + frames::NsFromSeconds(profile.fusion.lidar_wait_s);
}

bool Listening::State::Waits(const acoustics::LikelihoodScan& scan) const {
  if (!IsReady(scan)) return false;
  const frames::TimeNs mid_ns = scan.mid_ns();
  const std::optional<frames::TimeNs> lost_since_ns = localizer.lost_since_ns();
  if (lost_since_ns && mid_ns >= *lost_since_ns) return true;
  // A robot in doubt either knows again soon, or finds that it has been lost.
  const std::optional<frames::TimeNs> now_ns = localizer.newest_odometry_ns();
  if (!now_ns || *now_ns - mid_ns > frames::NsFromSeconds(profile.fusion.doubt_wait_s)) {
    return false;
  }
  const auto in_doubt = [this](frames::TimeNs time_ns) {
    const auto pose = localizer.At(time_ns);
    return pose && pose->state == localization::State::kUncertain;
  };
  return in_doubt(mid_ns) && in_doubt(*now_ns);
}

BandEar* Listening::State::NextToFuse(bool all) {
  BandEar* next = nullptr;
  for (BandEar& ear : ears) {
    if (ear.pending_scans.empty()) continue;
    const acoustics::LikelihoodScan& scan = ear.pending_scans.front();
    if (!all) {
      if (ear.pending_scans.size() <= kMaxPendingScans && !IsReady(scan)) continue;
      if (Waits(scan)) continue;
    }
    if (next == nullptr || scan.mid_ns() < next->pending_scans.front().mid_ns()) next = &ear;
  }
  return next;
}

void Listening::State::Drain(bool all, Output& output) {
  while (BandEar* ear = NextToFuse(all)) {
    acoustics::LikelihoodScan scan = std::move(ear->pending_scans.front());
    ear->pending_scans.pop_front();
    Fuse(*ear, std::move(scan), output);
  }
  if (const auto oldest_ns = oldest_pending_ns()) {
    localizer.KeepFrom(*oldest_ns);
  } else if (!track.empty()) {
    localizer.KeepFrom(track.newest_ns() - kNewScanAge_ns);
  }
}

// Chooses the LIDAR scan nearest in time and straightens its sweep. False when there is none near
// enough.
bool Listening::State::View(frames::TimeNs time_ns) {
  const frames::LidarScan* nearest = nullptr;
  frames::TimeNs nearest_age_ns = frames::NsFromSeconds(profile.ray_casting.max_lidar_age_s);
  for (const frames::LidarScan& scan : lidar_scans) {
    const frames::TimeNs age_ns = std::abs(MiddleOf(scan) - time_ns);
    if (age_ns > nearest_age_ns) continue;
    nearest = &scan;
    nearest_age_ns = age_ns;
  }
  if (nearest == nullptr) return false;
  if (view_stamp_ns == nearest->stamp_ns) return true;
  view_stamp_ns.reset();
  view_reference_ns = MiddleOf(*nearest);
  auto points =
      frames::PointsInBaseAt(*nearest, calibration.base_from_lidar, track, view_reference_ns);
  if (!points) return false;
  view_point_in_base = *std::move(points);
  view_stamp_ns = nearest->stamp_ns;
  return true;
}

// Section V for one audio scan: the pose and the ranges at its middle send its likelihoods into the
// map.
void Listening::State::Fuse(const BandEar& ear, acoustics::LikelihoodScan scan, Output& output) {
  const bool counts = ear.band == kMainBand;
  const frames::TimeNs mid_ns = scan.mid_ns();
  const auto pose = localizer.At(mid_ns);
  if (!pose || pose->state == localization::State::kLost) {
    if (counts) ++counters.scans_without_pose;
    return;
  }
  Lap(Stage::kSession);
  ray_casting::LidarView view;
  if (profile.ray_casting.range == ray_casting::RangeSource::kLidar) {
    const auto odom_from_audio_base = track.At(mid_ns);
    if (!odom_from_audio_base || !View(mid_ns)) {
      if (counts) ++counters.scans_without_range;
      return;
    }
    const auto odom_from_reference_base = track.Near(view_reference_ns, 1.0);
    if (!odom_from_reference_base) {
      if (counts) ++counters.scans_without_range;
      return;
    }
    view.reference_ns = view_reference_ns;
    view.point_in_base = view_point_in_base;
    view.reference_base_from_audio_base =
        (odom_from_reference_base->Inverse() * *odom_from_audio_base).ToIsometry();
  }
  if (std::holds_alternative<acoustics::PeakEvidence>(profile.acoustics.evidence)) {
    ray_casting::MarkReflections(view, calibration.base_from_array, ear.scanner->array_normal(),
                                 scan.peaks);
    if (std::any_of(scan.peaks.begin(), scan.peaks.end(),
                    [](const acoustics::Peak& peak) { return peak.reflection; })) {
      scan.likelihood = ear.scanner->Likelihood(scan.peaks);
    }
  }
  auto evidence = ear.caster.Cast(scan, view, *pose);
  Lap(Stage::kCast);
  if (!evidence.ok() || evidence->end_points.empty()) {
    if (counts) ++counters.scans_without_range;
    return;
  }
  if (counts) ++counters.audio_scans;
  scan.likelihood.clear();
  const Eigen::Isometry3d map_from_array =
      pose->map_from_base.ToIsometry() * calibration.base_from_array;
  std::vector<sound_map::HeardPeak> heard = PlacePeaks(
      scan, *evidence, map_from_array, ear.scanner->array_normal(), profile.sound_map.voxel_size_m);
  std::optional<sound_map::ArrayPlane> array_plane;
  if (const auto normal = ear.scanner->array_normal()) {
    array_plane = {map_from_array.translation(), map_from_array.linear() * *normal};
  }
  output.scans.push_back({std::move(scan), *pose, *std::move(evidence), std::move(heard),
                          array_plane, calibration.full_scale_spl_db, map_from_array.translation(),
                          ear.band});
}

std::vector<std::string> Listening::Warnings() const {
  const Counters& counters = state_->counters;
  const localization::Counters& localization = state_->localizer.counters();
  const std::pair<std::int64_t, const char*> sentences[] = {
      {counters.backward_odometry, " odometry frame(s) ran backwards in time and were left out"},
      {localization.odometry_jumps,
       " odometry frame(s) jumped; the robot was uncertain for a while"},
      {localization.scans_empty, " laser scan(s) had too few valid beams"},
      {counters.backward_lidar, " LIDAR scan(s) ran backwards in time and were left out"},
      {counters.refused_audio, " audio block(s) did not fit the ones before and were left out"},
      {counters.dead_microphone_scans, " audio scan(s) did without a dead microphone"},
      {counters.faulty_audio_scans,
       " audio scan(s) had a dead microphone or lost samples and were left out"},
      {counters.scans_without_pose,
       " audio scan(s) were left out since the robot did not know where it was"},
      {counters.scans_without_range,
       " audio scan(s) were left out since no LIDAR scan was near in time"}};
  std::vector<std::string> warnings;
  for (const auto& [count, sentence] : sentences) {
    if (count > 0) warnings.push_back(absl::StrCat(count, sentence));
  }
  if (counters.inverted_microphone_scans > 0) {
    warnings.push_back(absl::StrCat(counters.inverted_microphone_scans,
                                    " audio scan(s) mended the inverted polarity of mic_",
                                    absl::StrJoin(counters.inverted_microphones, ", mic_")));
  }
  if (counters.unheard_ns > 0) {
    warnings.push_back(absl::StrFormat(
        "the last %.0f s of sound were left out: the robot did not learn where it was",
        frames::SecondsFromNs(counters.unheard_ns)));
  }
  warnings.insert(warnings.end(), state_->unheard_bands.begin(), state_->unheard_bands.end());
  if (localization.corrections == 0) {
    warnings.push_back("the robot was never localized: no usable laser scan");
  }
  return warnings;
}

std::string Listening::SaveState() const {
  const State& state = *state_;
  const std::vector<frames::Odometry> track(state.track.entries().begin(),
                                            state.track.entries().end());
  std::vector<acoustics::AudioScanner::State> scanners;
  std::vector<std::deque<acoustics::LikelihoodScan>> pending_scans;
  for (const BandEar& ear : state.ears) {
    scanners.push_back(ear.scanner->state());
    pending_scans.push_back(ear.pending_scans);
  }
  return ToBytes(kStateVersion, state.localizer.state(), scanners, track, state.lidar_scans,
                 pending_scans, state.heard, state.counters);
}

absl::Status Listening::RestoreState(const std::string& bytes) {
  std::uint64_t version = 0;
  if (absl::Status read = FromBytes(bytes, version); !read.ok()) return read;
  if (version != kStateVersion) {
    return absl::DataLossError("the stored state of a drive is of another version");
  }
  localization::LocalizerState localizer_state;
  std::vector<acoustics::AudioScanner::State> scanners;
  std::vector<frames::Odometry> track;
  std::deque<frames::LidarScan> lidar_scans;
  std::vector<std::deque<acoustics::LikelihoodScan>> pending_scans;
  std::int64_t heard = 0;
  Counters counters;
  const absl::Status read = FromBytes(bytes, version, localizer_state, scanners, track, lidar_scans,
                                      pending_scans, heard, counters);
  if (!read.ok()) return read;
  State& state = *state_;
  if (scanners.size() != state.ears.size() || pending_scans.size() != state.ears.size()) {
    return absl::DataLossError("the stored state of a drive is of other bands");
  }
  auto localizer =
      localization::Localizer::Restore(state.building->plan, state.calibration, localizer_state);
  if (!localizer.ok()) return localizer.status();
  for (std::size_t i = 0; i < state.ears.size(); ++i) {
    const absl::Status restored = state.ears[i].scanner->Restore(std::move(scanners[i]));
    if (!restored.ok()) return restored;
  }
  state.localizer = *std::move(localizer);
  state.track = frames::OdometryTrack();
  for (const frames::Odometry& odometry : track) state.track.Add(odometry);
  state.lidar_scans = std::move(lidar_scans);
  for (std::size_t i = 0; i < state.ears.size(); ++i) {
    state.ears[i].pending_scans = std::move(pending_scans[i]);
  }
  state.heard = heard;
  state.counters = counters;
  state.view_stamp_ns.reset();
  return absl::OkStatus();
}

}  // namespace soundmap::pipeline
