#include "sources/simulation/sounds.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "sources/simulation/wav_file.h"

namespace soundmap::simulation {
namespace {

constexpr double kPi = std::numbers::pi;
using Engine = std::mt19937_64;

double Uniform(Engine& engine, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(engine);
}

// y[n] = x[n] - zero x[n-1] + pole y[n-1]
class FirstOrder {
 public:
  FirstOrder(double pole, double zero) : pole_(pole), zero_(zero) {}
  double operator()(double x) {
    const double y = x - zero_ * last_x_ + pole_ * last_y_;
    last_x_ = x;
    last_y_ = y;
    return y;
  }

 private:
  double pole_, zero_, last_x_ = 0.0, last_y_ = 0.0;
};

// Two conjugate poles; unit gain near the resonance.
class Resonator {
 public:
  Resonator() = default;
  void Tune(double frequency_hz, double bandwidth_hz, double sample_rate_hz) {
    const double radius = std::exp(-kPi * bandwidth_hz / sample_rate_hz);
    a1_ = 2.0 * radius * std::cos(2.0 * kPi * frequency_hz / sample_rate_hz);
    a2_ = -radius * radius;
    gain_ = (1.0 - radius) * std::sqrt(1.0 + radius * radius);
  }
  double operator()(double x) {
    const double y = gain_ * x + a1_ * y1_ + a2_ * y2_;
    y2_ = y1_;
    y1_ = y;
    return y;
  }

 private:
  double a1_ = 0.0, a2_ = 0.0, gain_ = 0.0, y1_ = 0.0, y2_ = 0.0;
};

// Sum of sines.
class Tones {
 public:
  void Add(double frequency_hz, double amplitude, double sample_rate_hz, Engine& engine) {
    if (frequency_hz > 0.45 * sample_rate_hz) return;
    tones_.push_back({std::polar(amplitude, Uniform(engine, 0.0, 2.0 * kPi)),
                      std::polar(1.0, 2.0 * kPi * frequency_hz / sample_rate_hz)});
  }
  double operator()() {
    double sum = 0.0;
    for (auto& tone : tones_) {
      sum += tone.phasor.real();
      tone.phasor = {tone.phasor.real() * tone.step.real() - tone.phasor.imag() * tone.step.imag(),
                     tone.phasor.real() * tone.step.imag() + tone.phasor.imag() * tone.step.real()};
    }
    return sum;
  }

 private:
  struct Tone {
    std::complex<double> phasor, step;
  };
  std::vector<Tone> tones_;
};

class Noise {
 public:
  explicit Noise(const Engine& engine) : engine_(engine) {}
  double operator()() { return normal_(engine_); }

 private:
  Engine engine_;
  std::normal_distribution<double> normal_;
};

// 1/f: poles and zeros in turn, an octave apart, each pair a step of 6 dB every two octaves.
class PinkNoise {
 public:
  PinkNoise(double sample_rate_hz, const Engine& engine) : noise_(engine) {
    for (double pole_hz = 30.0; 2.0 * pole_hz < 0.45 * sample_rate_hz; pole_hz *= 4.0) {
      sections_.emplace_back(std::exp(-2.0 * kPi * pole_hz / sample_rate_hz),
                             std::exp(-4.0 * kPi * pole_hz / sample_rate_hz));
    }
  }
  double operator()() {
    double value = noise_();
    for (auto& section : sections_) value = section(value);
    return value;
  }

 private:
  Noise noise_;
  std::vector<FirstOrder> sections_;
};

class Fan {
 public:
  Fan(double fs, Engine engine) : air_(fs, Engine(engine())) {
    const double blades_hz = Uniform(engine, 60.0, 140.0);
    for (int k = 1; k <= 5; ++k) hum_.Add(k * blades_hz, 0.6 / k, fs, engine);
  }
  double operator()() { return air_() + hum_(); }

 private:
  PinkNoise air_;
  Tones hum_;
};

class Hiss {
 public:
  Hiss(double fs, const Engine& engine)
      : noise_(engine),
        first_(std::exp(-2.0 * kPi * kCornerHz / fs), 1.0),
        second_(std::exp(-2.0 * kPi * kCornerHz / fs), 1.0) {}
  double operator()() { return second_(first_(noise_())); }

 private:
  static constexpr double kCornerHz = 1500.0;
  Noise noise_;
  FirstOrder first_, second_;
};

class Hum {
 public:
  Hum(double fs, Engine engine) : noise_(Engine(engine())) {
    for (int k = 1; k <= 40; ++k) tones_.Add(100.0 * k, std::pow(k, -0.7), fs, engine);
  }
  double operator()() { return tones_() + 0.1 * noise_(); }

 private:
  Noise noise_;
  Tones tones_;
};

class Machine {
 public:
  Machine(double fs, Engine engine) : noise_(fs, Engine(engine())) {
    const double turn_hz = Uniform(engine, 20.0, 30.0);
    modulation_.Add(turn_hz, 0.6, fs, engine);
    for (int k = 1; k <= 60; ++k) {
      rotation_.Add(k * turn_hz, Uniform(engine, 0.3, 1.0) / std::sqrt(k), fs, engine);
    }
    const double mesh_hz = 17.0 * turn_hz;
    for (int k = 1; k <= 5; ++k) {
      for (int side : {-1, 0, 1}) {
        rotation_.Add(k * mesh_hz + side * turn_hz, side == 0 ? 0.7 : 0.3, fs, engine);
      }
    }
  }
  double operator()() { return noise_() * (1.0 + modulation_()) + 0.5 * rotation_(); }

 private:
  PinkNoise noise_;
  Tones modulation_, rotation_;
};

// Syllables of a voiced vowel (pulses through three formants), some led in by a fricative, words
// with pauses between them.
class Speech {
 public:
  Speech(double fs, Engine engine)
      : fs_(fs),
        engine_(engine),
        noise_(Engine(engine())),
        tilt_(std::exp(-2.0 * kPi * 300.0 / fs), 0.0) {
    pitch_hz_ = Uniform(engine_, 95.0, 200.0);
  }
  double operator()() {
    if (left_ <= 0) NextPart();
    --left_;
    const double share = 1.0 - static_cast<double>(left_) / length_;
    const double envelope = std::sin(kPi * std::clamp(share, 0.0, 1.0));
    double pulse = 0.0;
    if (part_ == Part::kVowel) {
      phase_ += pitch_hz_ * bend_ * (1.1 - 0.2 * share) / fs_;
      if (phase_ >= 1.0) {
        phase_ -= 1.0;
        pulse = std::sqrt(fs_ / pitch_hz_);
      }
      pulse = tilt_(pulse + 0.05 * noise_());
    }
    double vowel = 0.0;
    constexpr double kStrength[] = {1.0, 2.0, 2.4, 1.8};
    for (int i = 0; i < 4; ++i) vowel += kStrength[i] * formants_[i](pulse * envelope);
    const double fricative =
        part_ == Part::kFricative ? fricative_(noise_()) * envelope : fricative_(0.0);
    return vowel + 1.6 * fricative;
  }

 private:
  enum class Part { kPause, kFricative, kVowel };
  void NextPart() {
    if (part_ == Part::kVowel && --syllables_ <= 0) {
      part_ = Part::kPause;
      syllables_ = static_cast<int>(Uniform(engine_, 1.0, 6.0));
      Start(Uniform(engine_, 0.0, 1.0) < 0.3 ? Uniform(engine_, 0.3, 0.8)
                                             : Uniform(engine_, 0.04, 0.15));
    } else if (part_ != Part::kFricative && Uniform(engine_, 0.0, 1.0) < 0.5) {
      part_ = Part::kFricative;
      fricative_.Tune(Uniform(engine_, 2000.0, std::min(6000.0, 0.4 * fs_)), 1200.0, fs_);
      Start(Uniform(engine_, 0.05, 0.12));
    } else {
      part_ = Part::kVowel;
      bend_ = Uniform(engine_, 0.85, 1.2);
      formants_[0].Tune(Uniform(engine_, 280.0, 800.0), 80.0, fs_);
      formants_[1].Tune(Uniform(engine_, 900.0, 2200.0), 110.0, fs_);
      formants_[2].Tune(Uniform(engine_, 2300.0, 3000.0), 160.0, fs_);
      formants_[3].Tune(Uniform(engine_, 3300.0, 4000.0), 250.0, fs_);
      Start(Uniform(engine_, 0.1, 0.26));
    }
  }
  void Start(double length_s) {
    length_ = std::max(1, static_cast<int>(length_s * fs_));
    left_ = length_;
  }

  double fs_;
  Engine engine_;
  Noise noise_;
  FirstOrder tilt_;
  Resonator formants_[4], fricative_;
  Part part_ = Part::kPause;
  double pitch_hz_ = 0.0, bend_ = 1.0, phase_ = 0.0;
  int left_ = 0, length_ = 1, syllables_ = 3;
};

template <typename Process>
class Endless final : public Sound {
 public:
  Endless(Process process, double gain) : process_(std::move(process)), gain_(gain) {}
  void Next(std::span<float> samples) override {
    for (float& sample : samples) sample = static_cast<float>(gain_ * process_());
  }

 private:
  Process process_;
  double gain_;
};

// Scales a process to unit rms, measured on a run of the same process.
template <typename Process>
std::unique_ptr<Sound> Normalized(const Process& process, double fs, double measured_s) {
  Process trial = process;
  double energy = 0.0;
  const auto count = static_cast<std::int64_t>(measured_s * fs);
  for (std::int64_t i = 0; i < count; ++i) {
    const double value = trial();
    energy += value * value;
  }
  return std::make_unique<Endless<Process>>(process, std::sqrt(count / std::max(energy, 1e-30)));
}

class Click final : public Sound {
 public:
  Click(std::int64_t period, std::int64_t first) : period_(period), next_(first) {}
  void Next(std::span<float> samples) override {
    for (float& sample : samples) {
      const std::int64_t phase = ((next_++ % period_) + period_) % period_;
      sample = phase == period_ / 2 ? 1.0f : 0.0f;
    }
  }

 private:
  std::int64_t period_, next_;
};

class Loop final : public Sound {
 public:
  explicit Loop(std::vector<float> samples) : samples_(std::move(samples)) {}
  void Next(std::span<float> samples) override {
    for (float& sample : samples) {
      sample = samples_[position_];
      position_ = (position_ + 1) % samples_.size();
    }
  }

 private:
  std::vector<float> samples_;
  std::size_t position_ = 0;
};

// Windowed sinc, band limited to the lower of the two rates.
std::vector<float> Resample(const std::vector<float>& samples, double from_hz, double to_hz) {
  if (from_hz == to_hz) return samples;
  constexpr int kLobes = 16;
  const double cut = std::min(1.0, to_hz / from_hz);
  const int reach = static_cast<int>(std::ceil(kLobes / cut));
  std::vector<float> resampled(std::max<std::size_t>(1, samples.size() * (to_hz / from_hz)));
  const auto count = static_cast<std::int64_t>(samples.size());
  for (std::size_t i = 0; i < resampled.size(); ++i) {
    const double position = i * from_hz / to_hz;
    const auto middle = static_cast<std::int64_t>(position);
    double sum = 0.0;
    for (std::int64_t k = std::max<std::int64_t>(0, middle - reach);
         k <= std::min(count - 1, middle + reach); ++k) {
      const double x = (k - position) * cut;
      if (std::abs(x) >= kLobes) continue;
      const double sinc = x == 0.0 ? 1.0 : std::sin(kPi * x) / (kPi * x);
      sum += samples[k] * sinc * cut * (0.5 + 0.5 * std::cos(kPi * x / kLobes));
    }
    resampled[i] = static_cast<float>(sum);
  }
  return resampled;
}

absl::StatusOr<std::unique_ptr<Sound>> MakeLoop(const std::string& path, int sample_rate_hz) {
  auto wav = ReadWav(path);
  if (!wav.ok()) return wav.status();
  std::vector<float> samples = Resample(wav->samples, wav->sample_rate_hz, sample_rate_hz);
  double energy = 0.0;
  for (float sample : samples) energy += static_cast<double>(sample) * sample;
  const double rms = std::sqrt(energy / samples.size());
  if (!(rms > 0.0)) return absl::InvalidArgumentError(path + ": is silent");
  for (float& sample : samples) sample = static_cast<float>(sample / rms);
  return std::make_unique<Loop>(std::move(samples));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Sound>> MakeSound(const SourceConfig& source, int sample_rate_hz,
                                                 std::int64_t first_sample, const Engine& engine) {
  const double fs = sample_rate_hz;
  constexpr double kMeasuredS = 10.0, kMeasuredSpeechS = 40.0;
  switch (source.kind) {
    case SoundKind::kFan:
      return Normalized(Fan(fs, engine), fs, kMeasuredS);
    case SoundKind::kHiss:
      return Normalized(Hiss(fs, engine), fs, kMeasuredS);
    case SoundKind::kHum:
      return Normalized(Hum(fs, engine), fs, kMeasuredS);
    case SoundKind::kSpeech:
      return Normalized(Speech(fs, engine), fs, kMeasuredSpeechS);
    case SoundKind::kMachine:
      return Normalized(Machine(fs, engine), fs, kMeasuredS);
    case SoundKind::kWhite:
      return Normalized(Noise(engine), fs, kMeasuredS);
    case SoundKind::kClick:
      return std::make_unique<Click>(sample_rate_hz, first_sample);
    case SoundKind::kWav:
      return MakeLoop(source.wav_path, sample_rate_hz);
  }
  return absl::InternalError("a sound of no known kind");
}

double CrestFactor(SoundKind kind) {
  switch (kind) {
    case SoundKind::kSpeech:
    case SoundKind::kWav:
      return 9.0;
    case SoundKind::kClick:
      return 1.0;
    default:
      return 5.5;
  }
}

}  // namespace soundmap::simulation
