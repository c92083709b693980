#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <variant>
#include <vector>

#include "acoustics/audio_scanner.h"
#include "acoustics/evidence.h"
#include "acoustics/peak_finder.h"
#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"
#include "tests/benchmark/require.h"
#include "tests/benchmark/srp_peers.h"

// One audio scan, from interleaved 16-bit samples to the likelihood of every candidate direction.
// The peers share our short time Fourier transform and our evidence, and differ in the power.
namespace soundmap::benchmarks {
namespace {

using acoustics::AcousticsConfig;
using acoustics::AudioScan;
using acoustics::AudioScanner;
using acoustics::FrameLayout;
using acoustics::SrpPhat;

constexpr int kRate_hz = 16000;
constexpr int kScans = 8;
constexpr frames::TimeNs kStart_ns = 1'700'000'000'000'000'000;

struct Case {
  explicit Case(const AcousticsConfig& acoustics_config)
      : config(acoustics_config),
        layout(FrameLayout::Create(config, kRate_hz).value()),
        srp(SrpPhat::Create(layout, config.speed_of_sound_mps, microphones, config.MakeGrid())
                .value()),
        stft(layout, channels),
        gemm(layout, config.speed_of_sound_mps, microphones, srp->grid()),
        lookup(layout, config.speed_of_sound_mps, microphones, srp->grid()),
        cubic(layout, config.speed_of_sound_mps, microphones, srp->grid()) {
    if (const auto* evidence = std::get_if<acoustics::PeakEvidence>(&config.evidence)) {
      finder.emplace(*evidence, layout, config.speed_of_sound_mps, microphones, srp);
    }
    std::mt19937_64 random(1);
    const int samples = kScans * layout.scan_period_samples() + layout.hop_samples();
    sound = acoustics::testing::Record(
        microphones, kRate_hz, samples,
        {{geometry::DirectionFromAngles(geometry::RadFromDeg(-20.0), geometry::RadFromDeg(30.0))},
         {geometry::DirectionFromAngles(geometry::RadFromDeg(5.0), geometry::RadFromDeg(55.0)),
          700.0}},
        400.0, random);
    Check();
  }

  std::span<const std::int16_t> Samples(int scan) const {
    return {&sound[static_cast<std::size_t>(scan) * layout.scan_period_samples() * channels],
            static_cast<std::size_t>(layout.scan_samples()) * channels};
  }
  double period_s() const { return static_cast<double>(layout.scan_period_samples()) / kRate_hz; }

  std::vector<float> Likelihood(const AudioScan& scan) const {
    if (const auto* thresholds = std::get_if<acoustics::DoubleThreshold>(&config.evidence)) {
      return acoustics::DoubleThresholdLikelihood(scan.power, *thresholds);
    }
    return finder->Likelihood(finder->Find(scan).peaks);
  }

  // Every method against eqs. (2)-(5) in double precision.
  void Check() {
    const acoustics::PhatSpectra spectra = stft.Analyze(Samples(0));
    scan = srp->Scan(spectra);
    const std::vector<float> by_gemm = gemm.Power(spectra);
    const std::vector<float> by_lookup = lookup.Power(spectra);
    const std::vector<float> by_cubic = cubic.Power(spectra);
    for (int i = 0; i < srp->grid().size(); i += 7) {
      const double power =
          acoustics::testing::LiteralPower(layout, microphones, spectra, srp->grid()[i]);
      error = std::max(error, std::abs(scan.power[i] - power) / layout.bins);
      gemm_error = std::max(gemm_error, std::abs(by_gemm[i] - power) / layout.bins);
      lookup_error = std::max(lookup_error, std::abs(by_lookup[i] - power) / layout.bins);
      cubic_error = std::max(cubic_error, std::abs(by_cubic[i] - power) / layout.bins);
    }
    Require(error < 1e-4, "our power is off by 1e-4 B or more");
    Require(gemm_error < 1e-4, "the matrix product's power is off by 1e-4 B or more");
    Require(cubic_error < 1e-4, "the cubic look-up's power is off by 1e-4 B or more");
    Require(lookup_error < 3e-2, "the look-up's power is off by 3e-2 B or more");
  }

  AcousticsConfig config;
  FrameLayout layout;
  acoustics::testing::Microphones microphones = acoustics::testing::DomeArray();
  int channels = static_cast<int>(microphones.size());
  std::shared_ptr<const SrpPhat> srp;
  std::optional<acoustics::PeakFinder> finder;
  acoustics::Stft stft;
  BinGemm gemm;
  GccLookup lookup;
  CubicLookUp cubic;
  std::vector<std::int16_t> sound;
  AudioScan scan;  // of the first samples
  double error = 0.0;
  double gemm_error = 0.0;
  double lookup_error = 0.0;
  double cubic_error = 0.0;
};

void ReportRobots(benchmark::State& state, double period_s) {
  state.counters["robots_per_core"] =
      benchmark::Counter(period_s, benchmark::Counter::kIsIterationInvariantRate);
}

void Report(benchmark::State& state, const Case& c, double error) {
  ReportRobots(state, c.period_s());
  state.counters["max_error_of_B"] = error;
}

// A scanner, and blocks of sound of which each completes one scan.
class Robot {
 public:
  Robot(const AcousticsConfig& config, const acoustics::testing::Microphones& microphones,
        const std::vector<std::int16_t>& sound)
      : scanner_(
            AudioScanner::Create(config, acoustics::testing::CalibrationOf(microphones, kRate_hz))
                .value()),
        blocks_(kScans) {
    const int channels = static_cast<int>(microphones.size());
    const FrameLayout& layout = scanner_->layout();
    const std::ptrdiff_t lead = static_cast<std::ptrdiff_t>(layout.hop_samples()) * channels;
    const std::ptrdiff_t period =
        static_cast<std::ptrdiff_t>(layout.scan_period_samples()) * channels;
    Require(static_cast<std::ptrdiff_t>(sound.size()) >= lead + kScans * period,
            "too little sound");
    for (int k = 0; k < kScans; ++k) {
      const auto first = sound.begin() + lead + k * period;
      blocks_[k] = {0, kRate_hz, channels, {first, first + period}};
    }
    Require(scanner_->Push({kStart_ns, kRate_hz, channels, {sound.begin(), sound.begin() + lead}})
                .value()
                .empty(),
            "a scan before its time");
    stamp_ns_ =
        kStart_ns + frames::NsFromSeconds(static_cast<double>(layout.hop_samples()) / kRate_hz);
  }

  void Hear() {
    blocks_[next_].stamp_ns = stamp_ns_;
    auto scans = scanner_->Push(blocks_[next_]);
    Require(scans.ok() && scans->size() == 1 && scans->front().fault.empty(), "not a scan a block");
    benchmark::DoNotOptimize(scans->front().likelihood.data());
    stamp_ns_ += frames::NsFromSeconds(period_s());
    next_ = (next_ + 1) % kScans;
  }
  double period_s() const {
    return static_cast<double>(scanner_->layout().scan_period_samples()) / kRate_hz;
  }
  int directions() const { return scanner_->grid().size(); }

 private:
  std::unique_ptr<AudioScanner> scanner_;
  std::vector<frames::AudioBlock> blocks_;
  frames::TimeNs stamp_ns_ = 0;
  int next_ = 0;
};

void Ours(benchmark::State& state, const Case& c) {
  Robot robot(c.config, c.microphones, c.sound);
  for (auto _ : state) robot.Hear();
  Report(state, c, c.error);
}

// The same for robots in turn that share their tables, a scan an iteration. What batching their
// scans could save beyond is the reading of tables that are still in the cache.
void OursOfSixteen(benchmark::State& state, const Case& c) {
  std::vector<std::unique_ptr<Robot>> robots;
  for (int r = 0; r < 16; ++r) {
    robots.push_back(std::make_unique<Robot>(c.config, c.microphones, c.sound));
  }
  std::size_t next = 0;
  for (auto _ : state) robots[next++ % robots.size()]->Hear();
  Report(state, c, c.error);
}

// How the cost grows: the likelihood by thresholds, so that the power is most of it.
void Growth(benchmark::State& state, int microphones, int directions) {
  std::mt19937_64 random(2);
  AcousticsConfig config = AcousticsConfig::Paper();
  config.grid = acoustics::EqualAreaGrid{std::sqrt(4.0 * geometry::kPi / directions)};
  const auto array = acoustics::testing::RandomArray(microphones, 0.15, random);
  const FrameLayout layout = FrameLayout::Create(config, kRate_hz).value();
  Robot robot(config, array,
              acoustics::testing::Record(
                  array, kRate_hz, kScans * layout.scan_period_samples() + layout.hop_samples(), {},
                  400.0, random));
  for (auto _ : state) robot.Hear();
  ReportRobots(state, robot.period_s());
  state.counters["microphones"] = microphones;
  state.counters["directions"] = robot.directions();
}

template <typename Method>
void Peer(benchmark::State& state, Case& c, Method& method, double error) {
  AudioScan scan = c.scan;
  int k = 0;
  for (auto _ : state) {
    scan.power = method.Power(c.stft.Analyze(c.Samples(k)));
    auto likelihood = c.Likelihood(scan);
    benchmark::DoNotOptimize(likelihood.data());
    k = (k + 1) % kScans;
  }
  Report(state, c, error);
}

// From the spectra to the power alone.
template <typename Method>
void Power(benchmark::State& state, Case& c, Method method) {
  const acoustics::PhatSpectra spectra = c.stft.Analyze(c.Samples(0));
  for (auto _ : state) benchmark::DoNotOptimize(method(spectra));
}

void Register(const std::string& grid, const AcousticsConfig& config) {
  const auto c = std::make_shared<Case>(config);
  const auto add = [&grid](const char* what, const char* method, auto run) {
    benchmark::RegisterBenchmark((what + ("/" + grid) + "/" + method).c_str(), run)
        ->Unit(benchmark::kMillisecond);
  };
  add("audio_scan", "ours", [c](benchmark::State& state) { Ours(state, *c); });
  add("audio_scan", "gcc_lookup_x4",
      [c](benchmark::State& state) { Peer(state, *c, c->lookup, c->lookup_error); });
  add("audio_scan", "cubic_look_up",
      [c](benchmark::State& state) { Peer(state, *c, c->cubic, c->cubic_error); });
  add("audio_scan_of_16_robots", "ours",
      [c](benchmark::State& state) { OursOfSixteen(state, *c); });
  add("audio_scan", "bin_gemm",
      [c](benchmark::State& state) { Peer(state, *c, c->gemm, c->gemm_error); });
  add("srp_power", "ours", [c](benchmark::State& state) {
    Power(state, *c, [&c](const auto& spectra) { return c->srp->Scan(spectra); });
  });
  add("srp_power", "gcc_lookup_x4", [c](benchmark::State& state) {
    Power(state, *c, [&c](const auto& spectra) { return c->lookup.Power(spectra); });
  });
  add("srp_power", "cubic_look_up", [c](benchmark::State& state) {
    Power(state, *c, [&c](const auto& spectra) { return c->cubic.Power(spectra); });
  });
  add("srp_power", "bin_gemm", [c](benchmark::State& state) {
    Power(state, *c, [&c](const auto& spectra) { return c->gemm.Power(spectra); });
  });
  // The rest of a scan.
  add("rest_of_scan", "spectra", [c](benchmark::State& state) {
    for (auto _ : state) benchmark::DoNotOptimize(c->stft.Analyze(c->Samples(0)));
  });
  add("rest_of_scan", "evidence", [c](benchmark::State& state) {
    for (auto _ : state) benchmark::DoNotOptimize(c->Likelihood(c->scan));
  });
}

void RegisterGrowth() {
  const auto add = [](const char* by, int value, int microphones, int directions) {
    benchmark::RegisterBenchmark(
        ("audio_scan_by_" + std::string(by) + "/ours/" + std::to_string(value)).c_str(),
        [=](benchmark::State& state) { Growth(state, microphones, directions); })
        ->Unit(benchmark::kMillisecond);
  };
  for (const int microphones : {4, 8, 16, 32, 64}) {
    add("microphones", microphones, microphones, 10000);
  }
  for (const int directions : {500, 1000, 2000, 5000, 10000, 20000}) {
    add("directions", directions, 16, directions);
  }
}

// What run-time dispatch gains: the inner loop of most steps, on a table of the first-level cache.
void RegisterInnerLoops() {
  for (const acoustics::Kernels& kernels : acoustics::AllKernels()) {
    const bool best = &kernels == &acoustics::BestKernels();
    const std::string method = best ? "ours" : kernels.name;
    benchmark::RegisterBenchmark(
        ("inner_loop_of_sums/" + method).c_str(), [&kernels](benchmark::State& state) {
          constexpr int kRows = 51;
          constexpr int kWidth = 32;
          constexpr int kSums = 4;
          const std::vector<float> row(kRows * kWidth, 1.0f);
          const std::vector<float> weight(kRows * kSums, 1.0f);
          std::vector<float> sum(kWidth * kSums);
          for (auto _ : state) {
            kernels.weigh_rows({row.data(), kWidth, kRows, kWidth, weight.data(), kRows, 1, kSums,
                                sum.data(), kWidth});
            benchmark::DoNotOptimize(sum.data());
          }
          state.SetItemsProcessed(state.iterations() * kRows * kWidth * kSums);
        });
  }
}

}  // namespace
}  // namespace soundmap::benchmarks

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  soundmap::benchmarks::Register("paper_4636", soundmap::acoustics::AcousticsConfig::Paper());
  soundmap::benchmarks::Register("default_10312", soundmap::acoustics::AcousticsConfig::Default());
  soundmap::benchmarks::RegisterGrowth();
  soundmap::benchmarks::RegisterInnerLoops();
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
