#include "sources/simulation/sound_field.h"

#include <fftw3.h>

#include <Eigen/Core>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "absl/strings/str_cat.h"
#include "sources/simulation/random_streams.h"
#include "sources/simulation/ray_caster.h"
#include "sources/simulation/room_images.h"
#include "sources/simulation/sounds.h"

namespace soundmap::simulation {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kHopS = 0.008;
constexpr int kTailDirections = 128;
constexpr int kGeneratedSamples = 4096;  // as many samples of all signals at a time
constexpr int kLanes = 8;
constexpr double kNearestM = 0.05;  // 1/r grows no further
constexpr double kSwitchS = 0.01;   // a source goes on and off within
constexpr std::int64_t kLargestTailSamples = 1 << 18;
constexpr double kListenerSpacingS = 0.5;
constexpr int kMostListeners = 12;
constexpr double kNoiseCrest = 5.5;
const Eigen::Vector3d kRobotNoiseInBase{-0.1, 0.0, 0.2};

using Lanes = Eigen::Array<float, kLanes, 1>;

template <typename T>
class FftwBuffer {
 public:
  explicit FftwBuffer(std::size_t count)
      : data_(static_cast<T*>(fftwf_malloc(sizeof(T) * count))), count_(count) {
    std::fill(data_.get(), data_.get() + count, T{});
  }
  T* data() { return data_.get(); }
  T& operator[](std::size_t i) { return data_.get()[i]; }
  std::size_t size() const { return count_; }

 private:
  struct Free {
    void operator()(T* pointer) const { fftwf_free(pointer); }
  };
  std::unique_ptr<T[], Free> data_;
  std::size_t count_;
};

// Real transform of a fixed length, forward and back. The plans are FFTW's estimates: measured ones
// change the last bits from run to run.
class RealFft {
 public:
  explicit RealFft(int length)
      : time(length),
        spectrum(length / 2 + 1),
        forward_(fftwf_plan_dft_r2c_1d(length, time.data(), Complex(), FFTW_ESTIMATE)),
        backward_(fftwf_plan_dft_c2r_1d(length, Complex(), time.data(), FFTW_ESTIMATE)) {}
  RealFft(const RealFft&) = delete;
  RealFft& operator=(const RealFft&) = delete;
  ~RealFft() {
    fftwf_destroy_plan(forward_);
    fftwf_destroy_plan(backward_);
  }
  void Forward() { fftwf_execute(forward_); }
  void Backward() { fftwf_execute(backward_); }  // times the length; destroys the spectrum

  FftwBuffer<float> time;
  FftwBuffer<std::complex<float>> spectrum;

 private:
  fftwf_complex* Complex() { return reinterpret_cast<fftwf_complex*>(spectrum.data()); }
  fftwf_plan forward_, backward_;
};

// The next length that FFTW does well.
int GoodLength(int least) {
  for (int length = (least + 15) / 16 * 16;; length += 16) {
    int rest = length;
    for (int factor : {2, 3, 5}) {
      while (rest % factor == 0) rest /= factor;
    }
    if (rest == 1) return length;
  }
}

// Samples of one signal around the present, by their index since the start of the drive.
class History {
 public:
  explicit History(std::int64_t first) : first_(first) {}
  std::int64_t end() const { return first_ + static_cast<std::int64_t>(samples_.size()); }
  std::span<float> Append(int count) {
    samples_.resize(samples_.size() + count, 0.0f);
    return std::span<float>(samples_).last(count);
  }
  const float* At(std::int64_t index) const { return samples_.data() + (index - first_); }
  bool Holds(std::int64_t index, int count) const {
    return index >= first_ && index + count <= end();
  }
  void DropBefore(std::int64_t index) {
    if (index - first_ < 4 * kGeneratedSamples) return;
    samples_.erase(samples_.begin(), samples_.begin() + (index - first_));
    first_ = index;
  }

 private:
  std::vector<float> samples_;
  std::int64_t first_;
};

// Convolves one signal with the tails of all directions (overlap-save).
class TailFilter {
 public:
  TailFilter(const std::vector<double>& energy, int directions, std::uint64_t seed)
      : length_(static_cast<int>(energy.size())),
        fft_(GoodLength(kGeneratedSamples + length_)),
        input_(fft_.time.size(), 0.0f),
        input_spectrum_(fft_.spectrum.size()) {
    auto engine = MakeEngine(seed, RandomStream::kTail);
    std::normal_distribution<float> normal;
    for (int d = 0; d < directions; ++d) {
      std::fill_n(fft_.time.data(), fft_.time.size(), 0.0f);
      for (int i = 0; i < length_; ++i) {
        fft_.time[i] = normal(engine) * static_cast<float>(std::sqrt(energy[i] / directions));
      }
      fft_.Forward();
      filters_.emplace_back(fft_.spectrum.data(), fft_.spectrum.data() + fft_.spectrum.size());
    }
  }

  // `input` has kGeneratedSamples samples; `output(d)` is where as many of direction d go.
  template <typename Output>
  void Process(std::span<const float> input, Output output) {
    std::move(input_.begin() + input.size(), input_.end(), input_.begin());
    std::copy(input.begin(), input.end(), input_.end() - input.size());
    std::copy(input_.begin(), input_.end(), fft_.time.data());
    fft_.Forward();
    std::copy_n(fft_.spectrum.data(), fft_.spectrum.size(), input_spectrum_.data());
    const float scale = 1.0f / static_cast<float>(fft_.time.size());
    for (std::size_t d = 0; d < filters_.size(); ++d) {
      const auto& filter = filters_[d];
      for (std::size_t k = 0; k < filter.size(); ++k) {
        const auto a = input_spectrum_[k], b = filter[k];
        fft_.spectrum[k] = {scale * (a.real() * b.real() - a.imag() * b.imag()),
                            scale * (a.real() * b.imag() + a.imag() * b.real())};
      }
      fft_.Backward();
      const std::span<float> samples = output(static_cast<int>(d));
      std::copy_n(fft_.time.data() + fft_.time.size() - samples.size(), samples.size(),
                  samples.data());
    }
  }

 private:
  int length_;
  RealFft fft_;
  std::vector<float> input_;
  FftwBuffer<std::complex<float>> input_spectrum_;
  std::vector<std::vector<std::complex<float>>> filters_;
};

// One emitting point of a source.
struct PointSignal {
  std::unique_ptr<Sound> sound;
  double gain;
  int source;
};

// A point that sounds: an emitting point or an image. `signal` counts in
// SoundFieldImpl::histories_.
struct Emitter {
  Eigen::Vector3d position_m;
  double gain;
  int signal;
  bool direct;
};

struct ComplexRow {
  std::vector<float> re, im;
  explicit ComplexRow(int count) : re(count, 0.0f), im(count, 0.0f) {}
};

// Pressure of a source's reverberation against that of an omnidirectional one.
double RoomGain(const SourceConfig& source) {
  return std::pow(10.0, -source.directivity_db / 20.0);
}

double HeardGain(const SourceConfig& source, const RoomImage& image) {
  return image.order == 0 ? image.gain : image.gain * RoomGain(source);
}

// y += gain * x, delayed by `delay_samples` in a transform of `length` samples.
void AddDelayed(const ComplexRow& x, double delay_samples, double gain, int length, ComplexRow& y) {
  const double step_rad = -2.0 * kPi * delay_samples / length;
  const std::complex<double> step = std::polar(1.0, step_rad);
  std::complex<double> phasor = gain;
  Lanes wr, wi;
  for (int lane = 0; lane < kLanes; ++lane) {
    wr[lane] = static_cast<float>(phasor.real());
    wi[lane] = static_cast<float>(phasor.imag());
    phasor *= step;
  }
  const std::complex<double> stride = std::polar(1.0, kLanes * step_rad);
  const float sr = static_cast<float>(stride.real()), si = static_cast<float>(stride.imag());
  const int count = static_cast<int>(x.re.size());
  for (int k = 0; k < count; k += kLanes) {
    const Lanes xr = Eigen::Map<const Lanes>(x.re.data() + k);
    const Lanes xi = Eigen::Map<const Lanes>(x.im.data() + k);
    Eigen::Map<Lanes>(y.re.data() + k) += xr * wr - xi * wi;
    Eigen::Map<Lanes>(y.im.data() + k) += xr * wi + xi * wr;
    const Lanes turned = wr * sr - wi * si;
    wi = wr * si + wi * sr;
    wr = turned;
  }
}

class SoundFieldImpl final : public SoundField {
 public:
  SoundFieldImpl(const Scene& scene, const Trajectory& trajectory, int pad_samples)
      : scene_(scene),
        trajectory_(trajectory),
        rays_(scene.room_m, scene.furniture),
        sample_rate_hz_(scene.audio.sample_rate_hz * (1.0 + 1e-6 * scene.audio.clock_drift_ppm)),
        samples_per_m_(sample_rate_hz_ / scene.speed_of_sound_mps),
        hop_(std::max(16, static_cast<int>(std::lround(kHopS * sample_rate_hz_ / 16)) * 16)),
        fft_(GoodLength(2 * hop_ + 2 * pad_samples)),
        pad_(static_cast<int>(fft_.time.size() - 2 * hop_) / 2),
        channels_(static_cast<int>(scene.array.microphone_in_array_m.size())),
        frame_((static_cast<int>(fft_.spectrum.size()) + kLanes - 1) / kLanes * kLanes),
        sums_(channels_, frame_),
        overlap_(channels_, std::vector<float>(fft_.time.size() + 3 * hop_ + 2 * pad_, 0.0f)),
        output_(static_cast<std::size_t>(hop_) * channels_),
        window_(2 * hop_),
        noise_engine_(MakeEngine(scene.seed, RandomStream::kMicrophones)) {
    for (int i = 0; i < 2 * hop_; ++i) {
      window_[i] = static_cast<float>(1.0 - std::abs(i - hop_) / static_cast<double>(hop_));
    }
  }

  absl::Status Prepare();
  std::span<const float> Next() override;
  double expected_peak() const override { return expected_peak_; }

 private:
  void Generate();
  void AddFrame(std::int64_t middle);
  bool LoadFrame(const History& history, std::int64_t start);
  double TimeOf(std::int64_t sample) const { return sample / sample_rate_hz_; }
  void EstimatePeak(const std::vector<Eigen::Vector3d>& listeners_m, double tail_energy);

  const Scene scene_;
  const Trajectory trajectory_;
  const RayCaster rays_;
  const double sample_rate_hz_, samples_per_m_;
  const int hop_;
  RealFft fft_;
  const int pad_, channels_;
  ComplexRow frame_;
  std::vector<ComplexRow> sums_;             // one a microphone
  std::vector<std::vector<float>> overlap_;  // output that is not whole yet: from output_start_ on
  std::vector<float> output_, window_;
  std::mt19937_64 noise_engine_;
  std::normal_distribution<float> normal_;

  std::vector<PointSignal> points_;
  std::vector<History> histories_;  // point signals, then one a source (the sum of its points),
                                    // then the robot's if it sounds
  std::vector<Emitter> emitters_;
  std::unique_ptr<Sound> robot_sound_;
  std::vector<double> tail_gain_;  // one a source
  std::optional<TailFilter> tail_filter_;
  std::vector<Eigen::Vector3d> tail_directions_;
  std::vector<History> tail_histories_;

  std::int64_t longest_delay_ = 0, look_ahead_ = 0, generated_ = 0, next_middle_ = 0,
               output_start_ = 0;
  double expected_peak_ = 0.0;
};

absl::Status SoundFieldImpl::Prepare() {
  const double diagonal_m = scene_.room_m.norm();
  const double furthest_m = (scene_.reverberation.image_order + 2) * diagonal_m;
  const auto tail_samples =
      static_cast<std::int64_t>(scene_.reverberation.rt60_s * sample_rate_hz_);
  look_ahead_ = static_cast<std::int64_t>(diagonal_m * samples_per_m_) + fft_.time.size();
  longest_delay_ = static_cast<std::int64_t>(furthest_m * samples_per_m_) + look_ahead_;
  if (tail_samples > kLargestTailSamples || longest_delay_ > (1 << 20)) {
    return absl::InvalidArgumentError(
        "the room's reverberation is too long to be computed at this sample rate");
  }
  // Sound is on its way when the drive starts.
  generated_ = -(longest_delay_ + tail_samples) / kGeneratedSamples * kGeneratedSamples -
               2 * kGeneratedSamples;

  std::vector<Eigen::Vector3d> sources_m, listeners_m;
  for (int s = 0; s < static_cast<int>(scene_.sources.size()); ++s) {
    const auto& source = scene_.sources[s];
    sources_m.push_back(source.position_m);
    tail_gain_.push_back(RoomGain(source) *
                         std::sqrt(RadiationShare(scene_.room_m, source.position_m)));
    const auto positions = EmittingPoints(scene_, source);
    for (const auto& position_m : positions) {
      const int index = static_cast<int>(points_.size());
      auto sound = MakeSound(source, scene_.audio.sample_rate_hz, generated_,
                             MakeEngine(scene_.seed, RandomStream::kSound, index));
      if (!sound.ok()) return sound.status();
      points_.push_back({*std::move(sound), source.level / std::sqrt(positions.size()), s});
      for (const auto& image :
           RoomImages(scene_.room_m, scene_.reverberation, position_m,
                      std::min(1, scene_.reverberation.image_order), furthest_m)) {
        emitters_.push_back({image.position_m, HeardGain(source, image), index, image.order == 0});
      }
    }
  }
  // Further images are far enough for a source to be one point.
  for (int s = 0; s < static_cast<int>(scene_.sources.size()); ++s) {
    for (const auto& image :
         RoomImages(scene_.room_m, scene_.reverberation, scene_.sources[s].position_m,
                    scene_.reverberation.image_order, furthest_m)) {
      if (image.order < 2) continue;
      emitters_.push_back({image.position_m, HeardGain(scene_.sources[s], image),
                           static_cast<int>(points_.size()) + s, false});
    }
  }
  histories_.assign(points_.size() + scene_.sources.size(), History(generated_));
  if (scene_.audio.robot_noise > 0.0) {
    SourceConfig robot;
    robot.kind = SoundKind::kMachine;
    auto sound = MakeSound(robot, scene_.audio.sample_rate_hz, generated_,
                           MakeEngine(scene_.seed, RandomStream::kSound, 1 << 20));
    if (!sound.ok()) return sound.status();
    robot_sound_ = *std::move(sound);
    histories_.emplace_back(generated_);
    sources_m.push_back(trajectory_.At(0.0).map_from_base() * kRobotNoiseInBase);
  }

  const double spacing_s = std::max(kListenerSpacingS, trajectory_.duration_s() / kMostListeners);
  const int spacings = static_cast<int>(trajectory_.duration_s() / spacing_s);
  for (int i = 0; i <= spacings; ++i) {
    listeners_m.push_back(
        (trajectory_.At(i * spacing_s).map_from_base() * scene_.array.base_from_array)
            .translation());
  }
  const auto energy = TailEnergy(scene_, sample_rate_hz_, sources_m, listeners_m);
  double total = 0.0;
  for (double sample : energy) total += sample;
  if (total > 0.0) {
    tail_filter_.emplace(energy, kTailDirections, scene_.seed);
    tail_histories_.assign(kTailDirections, History(generated_));
    const double golden_angle_rad = kPi * (3.0 - std::sqrt(5.0));
    for (int d = 0; d < kTailDirections; ++d) {
      const double z = 1.0 - (2.0 * d + 1.0) / kTailDirections;
      const double r = std::sqrt(1.0 - z * z);
      tail_directions_.emplace_back(r * std::cos(golden_angle_rad * d),
                                    r * std::sin(golden_angle_rad * d), z);
    }
  }
  EstimatePeak(listeners_m, total);
  next_middle_ = -hop_ * (2 + pad_ / hop_);  // the first frame that may reach into the drive
  return absl::OkStatus();
}

void SoundFieldImpl::EstimatePeak(const std::vector<Eigen::Vector3d>& listeners_m,
                                  double tail_energy) {
  const double noise = kNoiseCrest * scene_.audio.sensor_noise;
  double robot = 0.0;
  for (const auto& microphone_in_array_m : scene_.array.microphone_in_array_m) {
    const double distance_m =
        (scene_.array.base_from_array * microphone_in_array_m - kRobotNoiseInBase).norm();
    robot =
        std::max(robot, kNoiseCrest * scene_.audio.robot_noise / std::max(distance_m, kNearestM));
  }
  for (const auto& listener_m : listeners_m) {
    double power = noise * noise + robot * robot;
    for (const auto& emitter : emitters_) {
      const int point = emitter.signal;
      if (point >= static_cast<int>(points_.size())) continue;
      const double distance_m = std::max((emitter.position_m - listener_m).norm(), 0.3);
      const double peak = CrestFactor(scene_.sources[points_[point].source].kind) *
                          points_[point].gain * emitter.gain / distance_m;
      power += peak * peak;
    }
    for (std::size_t s = 0; s < scene_.sources.size(); ++s) {
      const double peak =
          CrestFactor(scene_.sources[s].kind) * scene_.sources[s].level * tail_gain_[s];
      power += peak * peak * tail_energy;
    }
    expected_peak_ = std::max(expected_peak_, std::sqrt(power));
  }
}

// kGeneratedSamples more of every signal.
void SoundFieldImpl::Generate() {
  std::vector<std::span<float>> sums;
  for (std::size_t s = 0; s < scene_.sources.size(); ++s) {
    sums.push_back(histories_[points_.size() + s].Append(kGeneratedSamples));
  }
  for (std::size_t p = 0; p < points_.size(); ++p) {
    const auto& source = scene_.sources[points_[p].source];
    const auto samples = histories_[p].Append(kGeneratedSamples);
    points_[p].sound->Next(samples);
    for (int i = 0; i < kGeneratedSamples; ++i) {
      double gain = points_[p].gain;
      const double time_s = TimeOf(generated_ + i);
      if (source.on_s) gain *= std::clamp((time_s - *source.on_s) / kSwitchS, 0.0, 1.0);
      if (source.off_s) gain *= std::clamp((*source.off_s - time_s) / kSwitchS, 0.0, 1.0);
      samples[i] *= static_cast<float>(gain);
      sums[points_[p].source][i] += samples[i];
    }
  }
  if (robot_sound_) {
    const auto samples = histories_.back().Append(kGeneratedSamples);
    robot_sound_->Next(samples);
    for (float& sample : samples) sample *= static_cast<float>(scene_.audio.robot_noise);
  }
  if (tail_filter_) {
    std::vector<float> input(kGeneratedSamples, 0.0f);
    if (robot_sound_) {
      const float* robot = histories_.back().At(generated_);
      std::copy_n(robot, kGeneratedSamples, input.begin());
    }
    for (std::size_t s = 0; s < sums.size(); ++s) {
      const auto gain = static_cast<float>(tail_gain_[s]);
      for (int i = 0; i < kGeneratedSamples; ++i) input[i] += gain * sums[s][i];
    }
    tail_filter_->Process(input,
                          [&](int d) { return tail_histories_[d].Append(kGeneratedSamples); });
  }
  generated_ += kGeneratedSamples;
}

// The spectrum of the windowed samples from `start` on; false if they are silent.
bool SoundFieldImpl::LoadFrame(const History& history, std::int64_t start) {
  assert(history.Holds(start, 2 * hop_));
  const float* samples = history.At(start);
  float* time = fft_.time.data();
  std::fill(time, time + fft_.time.size(), 0.0f);
  float loudest = 0.0f;
  for (int i = 0; i < 2 * hop_; ++i) {
    time[pad_ + i] = window_[i] * samples[i];
    loudest = std::max(loudest, std::abs(time[pad_ + i]));
  }
  if (loudest == 0.0f) return false;
  fft_.Forward();
  const std::size_t nyquist = fft_.spectrum.size() - 1;  // has no fractional delay
  for (std::size_t k = 0; k < nyquist; ++k) {
    frame_.re[k] = fft_.spectrum[k].real();
    frame_.im[k] = fft_.spectrum[k].imag();
  }
  return true;
}

// Adds what the microphones hear in the window around sample `middle`.
void SoundFieldImpl::AddFrame(std::int64_t middle) {
  while (generated_ < middle + hop_ + look_ahead_) Generate();
  const double time_s = TimeOf(middle);
  const Eigen::Isometry3d base_from_array = scene_.array.base_from_array;
  const Eigen::Isometry3d map_from_base = trajectory_.At(time_s).map_from_base();
  std::vector<Eigen::Vector3d> microphones_m;
  for (const auto& microphone_in_array_m : scene_.array.microphone_in_array_m) {
    microphones_m.push_back(map_from_base * (base_from_array * microphone_in_array_m));
  }
  const Eigen::Vector3d array_m = map_from_base * base_from_array.translation();
  const auto people = PeopleAt(scene_.people, time_s);
  const double through = std::pow(10.0, -scene_.audio.obstruction_db / 20.0);
  const int length = static_cast<int>(fft_.time.size());
  for (auto& sum : sums_) {
    std::fill(sum.re.begin(), sum.re.end(), 0.0f);
    std::fill(sum.im.begin(), sum.im.end(), 0.0f);
  }

  const auto add_point = [&](const Eigen::Vector3d& position_m, double gain, int signal) {
    const std::int64_t whole = std::llround((position_m - array_m).norm() * samples_per_m_);
    if (!LoadFrame(histories_[signal], middle - hop_ - whole)) return;
    for (int m = 0; m < channels_; ++m) {
      const double distance_m = (position_m - microphones_m[m]).norm();
      AddDelayed(frame_, distance_m * samples_per_m_ - whole,
                 gain / std::max(distance_m, kNearestM), length, sums_[m]);
    }
  };
  for (const auto& emitter : emitters_) {
    const bool blocked = emitter.direct && rays_.IsBlocked(emitter.position_m, array_m, people);
    add_point(emitter.position_m, blocked ? emitter.gain * through : emitter.gain, emitter.signal);
  }
  if (robot_sound_) {
    for (const auto& image :
         RoomImages(scene_.room_m, scene_.reverberation, map_from_base * kRobotNoiseInBase,
                    scene_.reverberation.image_order,
                    (scene_.reverberation.image_order + 2) * scene_.room_m.norm())) {
      add_point(image.position_m, image.gain, static_cast<int>(histories_.size()) - 1);
    }
  }
  // Plane waves; the tail's time counts at the middle of the room.
  const Eigen::Vector3d middle_m = scene_.room_m / 2;
  for (std::size_t d = 0; d < tail_directions_.size(); ++d) {
    const Eigen::Vector3d samples_along = -samples_per_m_ * tail_directions_[d];
    const std::int64_t whole = std::llround(samples_along.dot(array_m - middle_m));
    if (!LoadFrame(tail_histories_[d], middle - hop_ - whole)) continue;
    for (int m = 0; m < channels_; ++m) {
      AddDelayed(frame_, samples_along.dot(microphones_m[m] - middle_m) - whole, 1.0, length,
                 sums_[m]);
    }
  }

  const float scale = 1.0f / static_cast<float>(length);
  for (int m = 0; m < channels_; ++m) {
    for (std::size_t k = 0; k < fft_.spectrum.size(); ++k) {
      fft_.spectrum[k] = {scale * sums_[m].re[k], scale * sums_[m].im[k]};
    }
    fft_.Backward();
    const std::int64_t offset = middle - hop_ - pad_ - output_start_;
    for (std::int64_t i = std::max<std::int64_t>(0, -offset); i < length; ++i) {
      overlap_[m][offset + i] += fft_.time[i];
    }
  }
  for (auto& history : histories_) history.DropBefore(middle - hop_ - longest_delay_);
  for (auto& history : tail_histories_) history.DropBefore(middle - hop_ - look_ahead_);
}

std::span<const float> SoundFieldImpl::Next() {
  while (next_middle_ - hop_ - pad_ < output_start_ + hop_) {
    AddFrame(next_middle_);
    next_middle_ += hop_;
  }
  const auto noise = static_cast<float>(scene_.audio.sensor_noise);
  for (int i = 0; i < hop_; ++i) {
    for (int m = 0; m < channels_; ++m) {
      output_[static_cast<std::size_t>(i) * channels_ + m] =
          overlap_[m][i] + noise * normal_(noise_engine_);
    }
  }
  for (auto& samples : overlap_) {
    std::move(samples.begin() + hop_, samples.end(), samples.begin());
    std::fill(samples.end() - hop_, samples.end(), 0.0f);
  }
  output_start_ += hop_;
  return output_;
}

}  // namespace

absl::StatusOr<std::unique_ptr<SoundField>> SoundField::Create(const Scene& scene,
                                                               const Trajectory& trajectory) {
  double radius_m = 0.0;
  for (const auto& microphone_in_array_m : scene.array.microphone_in_array_m) {
    radius_m = std::max(radius_m, microphone_in_array_m.norm());
  }
  constexpr int kRoomForRinging = 16;
  const int pad_samples = static_cast<int>(std::ceil(radius_m * scene.audio.sample_rate_hz /
                                                     scene.speed_of_sound_mps)) +
                          kRoomForRinging;
  auto field = std::make_unique<SoundFieldImpl>(scene, trajectory, pad_samples);
  if (absl::Status status = field->Prepare(); !status.ok()) return status;
  return field;
}

}  // namespace soundmap::simulation
