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
        lookup(layout, config.speed_of_sound_mps, microphones, srp->grid()) {
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
    for (int i = 0; i < srp->grid().size(); i += 7) {
      const double power =
          acoustics::testing::LiteralPower(layout, microphones, spectra, srp->grid()[i]);
      error = std::max(error, std::abs(scan.power[i] - power) / layout.bins);
      gemm_error = std::max(gemm_error, std::abs(by_gemm[i] - power) / layout.bins);
      lookup_error = std::max(lookup_error, std::abs(by_lookup[i] - power) / layout.bins);
    }
    Require(error < 1e-4, "our power is off by 1e-4 B or more");
    Require(gemm_error < 1e-4, "the matrix product's power is off by 1e-4 B or more");
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
  std::vector<std::int16_t> sound;
  AudioScan scan;  // of the first samples
  double error = 0.0;
  double gemm_error = 0.0;
  double lookup_error = 0.0;
};

void Report(benchmark::State& state, const Case& c, double error) {
  state.counters["robots_per_core"] =
      benchmark::Counter(c.period_s(), benchmark::Counter::kIsIterationInvariantRate);
  state.counters["max_error_of_B"] = error;
}

void Ours(benchmark::State& state, const Case& c) {
  const auto scanner =
      AudioScanner::Create(c.config, acoustics::testing::CalibrationOf(c.microphones, kRate_hz))
          .value();
  std::vector<frames::AudioBlock> blocks(kScans);
  const std::size_t lead = static_cast<std::size_t>(c.layout.hop_samples()) * c.channels;
  const std::size_t period = static_cast<std::size_t>(c.layout.scan_period_samples()) * c.channels;
  for (int k = 0; k < kScans; ++k) {
    const auto first = c.sound.begin() + static_cast<std::ptrdiff_t>(lead + k * period);
    blocks[k] = {0, kRate_hz, c.channels, {first, first + static_cast<std::ptrdiff_t>(period)}};
  }
  // After these samples, each block completes one scan.
  frames::AudioBlock block{kStart_ns,
                           kRate_hz,
                           c.channels,
                           {c.sound.begin(), c.sound.begin() + static_cast<std::ptrdiff_t>(lead)}};
  Require(scanner->Push(block).value().empty(), "a scan before its time");
  frames::TimeNs stamp_ns =
      kStart_ns + frames::NsFromSeconds(static_cast<double>(c.layout.hop_samples()) / kRate_hz);
  int k = 0;
  for (auto _ : state) {
    blocks[k].stamp_ns = stamp_ns;
    auto scans = scanner->Push(blocks[k]);
    if (!scans.ok() || scans->size() != 1 || !scans->front().fault.empty()) {
      state.SkipWithError("not one scan a block");
      break;
    }
    benchmark::DoNotOptimize(scans->front().likelihood.data());
    stamp_ns += frames::NsFromSeconds(c.period_s());
    k = (k + 1) % kScans;
  }
  Report(state, c, c.error);
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
  add("audio_scan", "bin_gemm",
      [c](benchmark::State& state) { Peer(state, *c, c->gemm, c->gemm_error); });
  add("srp_power", "ours", [c](benchmark::State& state) {
    Power(state, *c, [&c](const auto& spectra) { return c->srp->Scan(spectra); });
  });
  add("srp_power", "gcc_lookup_x4", [c](benchmark::State& state) {
    Power(state, *c, [&c](const auto& spectra) { return c->lookup.Power(spectra); });
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

}  // namespace
}  // namespace soundmap::benchmarks

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  soundmap::benchmarks::Register("paper_4636", soundmap::acoustics::AcousticsConfig::Paper());
  soundmap::benchmarks::Register("default_10313", soundmap::acoustics::AcousticsConfig::Default());
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
