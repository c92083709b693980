#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <numbers>

#include "foxglove/FrameTransforms.pb.h"
#include "foxglove/RawAudio.pb.h"
#include "recording/reader.h"
#include "sources/simulation/simulate.h"
#include "tests/simulation/scene_texts.h"

// The shipped grill room beside the sample of another simulator: the steered response power must be
// neither easier nor harder to read.
namespace soundmap::simulation {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kComparedS = 28.0;  // one lap

struct Drive {
  std::vector<Eigen::Vector3d> microphone_in_array_m;
  std::vector<std::vector<double>> audio;  // by channel
};

Drive Read(const std::string& path) {
  Drive drive;
  auto reader = recording::Reader::Open(path);
  EXPECT_TRUE(reader.ok()) << reader.status();
  std::size_t count = 0;
  while (count < kComparedS * 16000) {
    auto message = (*reader)->Next();
    EXPECT_TRUE(message.ok()) << message.status();
    if (!message.ok() || !*message) break;
    if ((*message)->topic == "/tf_static") {
      foxglove::FrameTransforms transforms;
      transforms.ParseFromString((*message)->data);
      for (const auto& transform : transforms.transforms()) {
        if (!transform.child_frame_id().starts_with("mic_") ||
            transform.child_frame_id() == "mic_array")
          continue;
        drive.microphone_in_array_m.emplace_back(
            transform.translation().x(), transform.translation().y(), transform.translation().z());
      }
    } else if ((*message)->topic == "/audio") {
      foxglove::RawAudio chunk;
      chunk.ParseFromString((*message)->data);
      const std::size_t channels = chunk.number_of_channels();
      drive.audio.resize(channels);
      for (std::size_t i = 0; i < chunk.data().size() / 2; ++i) {
        std::int16_t sample;
        std::memcpy(&sample, chunk.data().data() + 2 * i, 2);
        drive.audio[i % channels].push_back(sample);
      }
      count = drive.audio[0].size();
    }
  }
  return drive;
}

// S(theta_i, phi_i, k) of eqs. (1)-(5), as they stand, in double precision, of all scans that begin
// at `first_samples`; u_i from the array to the source, so that the phase delay to be undone is
// -omega p.u / c.
std::vector<double> SteeredPower(const Drive& drive, const std::vector<std::size_t>& first_samples,
                                 const std::vector<Eigen::Vector3d>& directions) {
  constexpr int kWindow = 400, kFrames = 10, kFirstBin = 25, kLastBin = 75;
  using Complex = std::complex<double>;
  const int microphones = static_cast<int>(drive.microphone_in_array_m.size());
  std::vector<double> power(first_samples.size() * directions.size(), 0.0);
  std::vector<Complex> h(directions.size() * microphones), v(kFrames * microphones);
  for (int f = kFirstBin; f <= kLastBin; ++f) {
    const double omega = 2 * kPi * f * 16000.0 / kWindow;
    std::vector<Complex> transform(kWindow);
    for (int i = 0; i < kWindow; ++i) {
      const double hann = 0.5 - 0.5 * std::cos(2 * kPi * i / kWindow);
      transform[i] = std::polar(hann, -2 * kPi * ((f * i) % kWindow) / kWindow);
    }
    for (std::size_t d = 0; d < directions.size(); ++d) {
      for (int n = 0; n < microphones; ++n) {  // (3)
        h[d * microphones + n] = std::polar(
            1.0 / microphones, -omega * drive.microphone_in_array_m[n].dot(directions[d]) / 343.0);
      }
    }
    for (std::size_t scan = 0; scan < first_samples.size(); ++scan) {
      for (int t = 0; t < kFrames; ++t) {
        for (int n = 0; n < microphones; ++n) {
          const double* samples = &drive.audio[n][first_samples[scan] + t * kWindow / 2];
          Complex x = 0.0;
          for (int i = 0; i < kWindow; ++i) x += samples[i] * transform[i];
          v[t * microphones + n] = std::abs(x) > 0.0 ? x / std::abs(x) : 0.0;  // (1)
        }
      }
      for (std::size_t d = 0; d < directions.size(); ++d) {
        double mean = 0.0;
        for (int t = 0; t < kFrames; ++t) {
          double re = 0.0, im = 0.0;
          for (int n = 0; n < microphones; ++n) {  // (2)
            const Complex a = h[d * microphones + n], b = v[t * microphones + n];
            re += a.real() * b.real() - a.imag() * b.imag();
            im += a.real() * b.imag() + a.imag() * b.real();
          }
          mean += (re * re + im * im) / kFrames;  // (4)
        }
        power[scan * directions.size() + d] += mean;  // (5)
      }
    }
  }
  return power;
}

struct Summary {
  double median, q99, max;
};

Summary Summarize(const Drive& drive) {
  std::vector<Eigen::Vector3d> directions;  // spread evenly over the sphere, about 4 degrees apart
  constexpr int kDirections = 2600;
  for (int i = 0; i < kDirections; ++i) {
    const double z = 1 - (2 * i + 1.0) / kDirections, r = std::sqrt(1 - z * z);
    const double azimuth_rad = kPi * (1 + std::sqrt(5.0)) * i;
    directions.emplace_back(r * std::cos(azimuth_rad), r * std::sin(azimuth_rad), z);
  }
  constexpr int kScans = 56;
  std::vector<std::size_t> first_samples;
  for (int scan = 0; scan < kScans; ++scan) {
    first_samples.push_back(static_cast<std::size_t>(scan * (kComparedS - 0.5) / kScans * 16000));
  }
  std::vector<double> all = SteeredPower(drive, first_samples, directions);
  std::sort(all.begin(), all.end());
  return {all[all.size() / 2], all[all.size() * 99 / 100], all.back()};
}

TEST(SampleComparison, SteeredPowerOfTheGrillRoomIsThatOfTheSample) {
  const char* folder = std::getenv("SOUNDMAP_DATA");
  const std::filesystem::path data = folder ? folder : SOUNDMAP_SOURCE_DIR "/../shared/data";
  const auto sample_path = data / "grill_room/drive.mcap";
  if (!std::filesystem::exists(sample_path)) {
    GTEST_SKIP() << "there is no " << sample_path << " to compare with";
  }
  const std::string out = FreshFolder() + "/drive.mcap";
  SimulateOptions options;
  options.seconds = kComparedS + 0.1;
  const auto result = Simulate("grill_room", out, options);
  ASSERT_TRUE(result.ok()) << result.status();
  const Drive ours = Read(out), sample = Read(sample_path.string());
  ASSERT_EQ(ours.microphone_in_array_m.size(), sample.microphone_in_array_m.size());
  for (std::size_t n = 0; n < sample.microphone_in_array_m.size(); ++n) {
    EXPECT_LT((ours.microphone_in_array_m[n] - sample.microphone_in_array_m[n]).norm(), 1e-6);
  }
  const Summary a = Summarize(ours), b = Summarize(sample);
  std::cout << "S ours/sample: median " << a.median << "/" << b.median << ", 99 % " << a.q99 << "/"
            << b.q99 << ", max " << a.max << "/" << b.max << "\n";
  EXPECT_NEAR(a.median / b.median, 1.0, 0.15);
  EXPECT_NEAR(a.q99 / b.q99, 1.0, 0.15);
  EXPECT_NEAR(a.max / b.max, 1.0, 0.15);
}

}  // namespace
}  // namespace soundmap::simulation
