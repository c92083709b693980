#include "recording/frame_coding.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "recording/flac_audio.h"
#include "recording/foxglove_messages.h"
#include "recording/packed_points.h"

namespace soundmap::recording {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kStamp_ns = 1'700'000'000'123'456'789;
const FrameCoding kAll{{v1::CODING_FLAC, v1::CODING_POINTS, v1::CODING_ZSTD}, 0.001};

enum class Sound { kSilence, kNoise, kTone, kExtremes };

std::vector<std::int16_t> Samples(Sound sound, int channels, int count) {
  std::mt19937 random(static_cast<unsigned>(channels * 1000 + count));
  std::vector<std::int16_t> samples;
  for (int s = 0; s < count; ++s) {
    for (int c = 0; c < channels; ++c) {
      switch (sound) {
        case Sound::kSilence:
          samples.push_back(0);
          break;
        case Sound::kNoise:
          samples.push_back(static_cast<std::int16_t>(random()));
          break;
        case Sound::kTone:
          samples.push_back(static_cast<std::int16_t>(8000.0 * std::sin(0.1 * s + c) +
                                                      static_cast<double>(random() % 20)));
          break;
        case Sound::kExtremes:
          samples.push_back(random() % 2 == 0 ? -32768 : 32767);
          break;
      }
    }
  }
  return samples;
}

std::string AudioPayload(Sound sound, int channels, int count) {
  return MakeRawAudio(kStamp_ns, 48000, channels, Samples(sound, channels, count))
      .SerializeAsString();
}

std::string AsBytes(const std::vector<std::int16_t>& samples) {
  return std::string(reinterpret_cast<const char*>(samples.data()),
                     samples.size() * sizeof(samples[0]));
}

absl::Status Decode(const std::vector<std::string>& streams, int channels, std::string& out) {
  std::vector<const std::string*> pointers;
  for (const std::string& stream : streams) pointers.push_back(&stream);
  return DecodeFlac(pointers, channels, out);
}

TEST(Flac, GivesBackEverySampleOfUpTo64ChannelsAndOddLengths) {
  for (int channels = 1; channels <= 64; ++channels) {
    for (const int count : {1, 2, 15, 16, 17, 333, 4095, 4096, 4097, 9001}) {
      if (channels % 7 != 1 && count > 1000) continue;
      for (const Sound sound : {Sound::kSilence, Sound::kNoise, Sound::kTone, Sound::kExtremes}) {
        const auto samples = Samples(sound, channels, count);
        const auto streams = EncodeFlac(samples, channels);
        ASSERT_TRUE(streams.ok()) << streams.status();
        EXPECT_EQ(streams->size(), static_cast<std::size_t>((channels + 7) / 8));
        std::string out(samples.size() * 2, 'x');
        const absl::Status decoded = Decode(*streams, channels, out);
        ASSERT_TRUE(decoded.ok()) << decoded << " " << channels << " x " << count;
        ASSERT_TRUE(out == AsBytes(samples)) << channels << " x " << count;
      }
    }
  }
}

TEST(Flac, LiesAboutChannelsAndSamplesAreRefused) {
  const auto streams = EncodeFlac(Samples(Sound::kTone, 12, 500), 12).value();
  const auto refused = [&](const std::vector<std::string>& lie, int channels, int samples,
                           const std::string& says) {
    std::string out(static_cast<std::size_t>(2 * channels * samples), '\0');
    const absl::Status status = Decode(lie, channels, out);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << says;
    EXPECT_THAT(std::string(status.message()), HasSubstr(says));
  };
  refused(streams, 11, 500, "other channels");
  refused(streams, 13, 500, "have 12 channels");
  refused(streams, 12, 499, "more samples");
  refused(streams, 12, 501, "fewer samples");
  refused({streams[0]}, 12, 500, "have 8 channels");
  refused({streams[0], streams[1], streams[0]}, 12, 500, "other channels");
  refused({}, 12, 500, "have 0 channels");
  refused({streams[0], streams[1] + std::string("more")}, 12, 500, "damaged");
  refused({streams[0], ""}, 12, 500, "fewer samples");
}

TEST(Flac, AStreamCutOrChangedAnywhereIsRefused) {
  const auto samples = Samples(Sound::kTone, 3, 60);
  const std::string stream = EncodeFlac(samples, 3).value()[0];
  std::string out(samples.size() * 2, '\0');
  for (std::size_t cut = 0; cut < stream.size(); ++cut) {
    EXPECT_FALSE(Decode({stream.substr(0, cut)}, 3, out).ok()) << cut;
  }
  for (std::size_t bit = 0; bit < 8 * stream.size(); ++bit) {
    std::string changed = stream;
    changed[bit / 8] = static_cast<char>(changed[bit / 8] ^ (1 << (bit % 8)));
    const absl::Status status = Decode({changed}, 3, out);
    EXPECT_TRUE(!status.ok() || out == AsBytes(samples)) << bit;
  }
}

// A spinning LIDAR in a box of 12 x 8 x 3 m, range noise 15 mm, 2 % of the beams without return.
struct Spin {
  int rings = 32;
  int azimuths = 938;
  bool ring_by_ring = false;
  bool keeps_no_returns = false;
  double turn = 1.0;
};

std::vector<Eigen::Vector3f> SpinPoints(const Spin& spin) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise_m(0.0, 0.015);
  std::uniform_real_distribution<double> chance(0.0, 1.0);
  std::vector<Eigen::Vector3f> points;
  const int total = spin.rings * spin.azimuths;
  for (int i = 0; i < total; ++i) {
    const int ring = spin.ring_by_ring ? i / spin.azimuths : i % spin.rings;
    const int step = spin.ring_by_ring ? i % spin.azimuths : i / spin.rings;
    const double azimuth_rad = spin.turn * 2.0 * std::numbers::pi * step / spin.azimuths;
    const double elevation_rad = (-25.0 + 40.0 * ring / spin.rings) * std::numbers::pi / 180.0;
    const Eigen::Vector3d direction(std::cos(azimuth_rad) * std::cos(elevation_rad),
                                    std::sin(azimuth_rad) * std::cos(elevation_rad),
                                    std::sin(elevation_rad));
    double range_m = 1e9;
    const double walls_m[3][2] = {{-5.0, 7.0}, {-3.0, 5.0}, {-1.0, 2.0}};
    for (int axis = 0; axis < 3; ++axis) {
      const double wall_m = walls_m[axis][direction[axis] > 0 ? 1 : 0];
      if (direction[axis] != 0.0) range_m = std::min(range_m, wall_m / direction[axis]);
    }
    if (chance(random) < 0.02) {
      if (spin.keeps_no_returns) points.push_back(Eigen::Vector3f::Zero());
      continue;
    }
    points.push_back((direction * (range_m + noise_m(random))).cast<float>());
  }
  return points;
}

std::string Snapped(const foxglove::PointCloud& cloud, double resolution_m = 0.001) {
  return SnapFrame("foxglove.PointCloud", cloud.SerializeAsString(), resolution_m);
}

// Codes, decodes, compares every byte; the coded size.
std::size_t RoundTrip(const std::string& schema, const std::string& payload, v1::Coding expected,
                      const FrameCoding& coding = kAll) {
  const CodedFrame coded = CodeFrame(schema, payload, coding);
  EXPECT_EQ(coded.coding, expected);
  if (coded.coding == v1::CODING_UNSPECIFIED) return payload.size();
  const auto decoded =
      DecodeFrame(coded.coding, coded.bytes, static_cast<std::int64_t>(payload.size()));
  EXPECT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_TRUE(decoded.ok() && *decoded == payload);
  return coded.bytes.size();
}

TEST(FrameCoding, EveryMessageComesBackByteForByte) {
  RoundTrip("foxglove.RawAudio", AudioPayload(Sound::kTone, 16, 800), v1::CODING_FLAC);
  RoundTrip("foxglove.RawAudio", AudioPayload(Sound::kNoise, 16, 800), v1::CODING_UNSPECIFIED);
  RoundTrip("foxglove.RawAudio", AudioPayload(Sound::kSilence, 64, 9000), v1::CODING_FLAC);
  RoundTrip("foxglove.RawAudio", AudioPayload(Sound::kTone, 16, 800), v1::CODING_UNSPECIFIED, {});
  // Fields that this version does not know, and in another order, stay.
  foxglove::RawAudio audio = MakeRawAudio(kStamp_ns, 48000, 2, Samples(Sound::kTone, 2, 800));
  audio.GetReflection()->MutableUnknownFields(&audio)->AddVarint(1000, 5);
  RoundTrip("foxglove.RawAudio", audio.SerializeAsString(), v1::CODING_FLAC);
  audio.clear_data();
  std::string reordered = audio.SerializeAsString();
  foxglove::RawAudio data;
  data.set_data(AsBytes(Samples(Sound::kTone, 2, 800)));
  RoundTrip("foxglove.RawAudio", reordered + data.SerializeAsString(), v1::CODING_FLAC);

  std::vector<double> ranges_m(541);
  for (std::size_t i = 0; i < ranges_m.size(); ++i) ranges_m[i] = 0.01 * (300 + i / 7);
  RoundTrip("foxglove.LaserScan", MakeLaserScan(kStamp_ns, -1.0, 1.0, ranges_m).SerializeAsString(),
            v1::CODING_ZSTD);
  RoundTrip("foxglove.Odometry",
            MakeOdometry(kStamp_ns, Eigen::Isometry3d::Identity()).SerializeAsString(),
            v1::CODING_UNSPECIFIED);
  RoundTrip("foxglove.RawAudio", std::string(2000, 'x'), v1::CODING_UNSPECIFIED);
}

TEST(PackedPoints, ASpinComesBackExactlyAndShort) {
  for (const bool ring_by_ring : {false, true}) {
    for (const bool keeps_no_returns : {false, true}) {
      for (const double turn : {1.0, -1.0}) {
        const auto points = SpinPoints(
            {.ring_by_ring = ring_by_ring, .keeps_no_returns = keeps_no_returns, .turn = turn});
        const std::string payload = Snapped(MakePointCloud(kStamp_ns, points));
        const std::size_t bytes = RoundTrip("foxglove.PointCloud", payload, v1::CODING_POINTS);
        const double share = static_cast<double>(bytes) / static_cast<double>(payload.size());
        EXPECT_LT(share, 0.18) << ring_by_ring << keeps_no_returns << turn;
        RecordProperty("share", std::to_string(share));
      }
    }
  }
}

TEST(PackedPoints, OtherLayoutsComeBackExactly) {
  const auto points = SpinPoints({.rings = 16, .azimuths = 200});
  std::vector<std::uint32_t> offset_ns;
  for (std::size_t i = 0; i < points.size(); ++i) {
    offset_ns.push_back(static_cast<std::uint32_t>(i / 16 * 55'555));
  }
  RoundTrip("foxglove.PointCloud", Snapped(MakePointCloud(kStamp_ns, points, offset_ns)),
            v1::CODING_POINTS);

  // Doubles behind an intensity, and bytes of no field.
  foxglove::PointCloud wide;
  wide.set_point_stride(40);
  const auto add_field = [&](const char* name, std::uint32_t offset,
                             foxglove::PackedElementField::NumericType type) {
    foxglove::PackedElementField& field = *wide.add_fields();
    field.set_name(name);
    field.set_offset(offset);
    field.set_type(type);
  };
  add_field("intensity", 0, foxglove::PackedElementField::UINT16);
  add_field("x", 8, foxglove::PackedElementField::FLOAT64);
  add_field("y", 16, foxglove::PackedElementField::FLOAT64);
  add_field("z", 24, foxglove::PackedElementField::FLOAT64);
  std::mt19937 random(1);
  for (const Eigen::Vector3f& point : points) {
    std::string element(40, '\0');
    for (char& byte : element) byte = static_cast<char>(random() % 3);
    const Eigen::Vector3d wide_point = point.cast<double>();
    std::memcpy(element.data() + 8, wide_point.data(), 24);
    wide.mutable_data()->append(element);
  }
  RoundTrip("foxglove.PointCloud", Snapped(wide), v1::CODING_POINTS);

  // Not on the resolution, too far for it, no numbers: as plain columns or as they are.
  std::vector<Eigen::Vector3f> odd(points.begin(), points.end());
  odd[7] = {1e9f, 0.0f, -0.0f};
  odd[8] = {std::numeric_limits<float>::quiet_NaN(), 1.0f, 2.0f};
  for (const auto& cloud : {MakePointCloud(kStamp_ns, odd), MakePointCloud(kStamp_ns, points)}) {
    const CodedFrame coded = CodeFrame("foxglove.PointCloud", cloud.SerializeAsString(), kAll);
    RoundTrip("foxglove.PointCloud", cloud.SerializeAsString(), coded.coding);
  }
}

TEST(SnapPoints, MovesAPointByHalfTheResolutionAtMost) {
  const auto points = SpinPoints({});
  for (const double resolution_m : {0.0005, 0.001, 0.01}) {
    foxglove::PointCloud snapped;
    ASSERT_TRUE(snapped.ParseFromString(Snapped(MakePointCloud(kStamp_ns, points), resolution_m)));
    ASSERT_EQ(snapped.data().size(), points.size() * 12);
    double largest_m = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      Eigen::Vector3f point;
      std::memcpy(point.data(), snapped.data().data() + 12 * i, 12);
      largest_m = std::max<double>(largest_m, (point - points[i]).cwiseAbs().maxCoeff());
    }
    EXPECT_LE(largest_m, 0.5 * resolution_m + 1e-6);
    EXPECT_GE(largest_m, 0.45 * resolution_m);
  }
}

TEST(SnapPoints, WhatIsNotFiniteIsNoReturn) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinite = std::numeric_limits<float>::infinity();
  foxglove::PointCloud cloud = MakePointCloud(
      kStamp_ns, std::vector<Eigen::Vector3f>{{1, 2, 3}, {nan, 1, 1}, {1, -infinite, 1}});
  ASSERT_TRUE(SnapPoints(0.001, cloud));
  float numbers[9];
  std::memcpy(numbers, cloud.data().data(), sizeof(numbers));
  EXPECT_THAT(numbers, testing::ElementsAre(1, 2, 3, 0, 0, 0, 0, 0, 0));
  foxglove::PointCloud far =
      MakePointCloud(kStamp_ns, std::vector<Eigen::Vector3f>{{1, 2, 3.0004f}, {1e6, 1, 1}});
  const std::string before = far.SerializeAsString();
  EXPECT_FALSE(SnapPoints(0.001, far));
  EXPECT_EQ(far.SerializeAsString(), before);
}

TEST(FrameCoding, DamageIsRefusedOrGivesAsManyBytes) {
  const std::string cloud =
      Snapped(MakePointCloud(kStamp_ns, SpinPoints({.rings = 8, .azimuths = 20})));
  const std::string audio = AudioPayload(Sound::kTone, 9, 100);
  const std::string laser =
      MakeLaserScan(kStamp_ns, -1, 1, std::vector<double>(200, 1.0)).SerializeAsString();
  std::mt19937 random(9);
  for (const auto& [schema, payload] :
       {std::pair("foxglove.PointCloud", cloud), std::pair("foxglove.RawAudio", audio),
        std::pair("foxglove.LaserScan", laser)}) {
    const CodedFrame coded = CodeFrame(schema, payload, kAll);
    ASSERT_NE(coded.coding, v1::CODING_UNSPECIFIED) << schema;
    const auto size = static_cast<std::int64_t>(payload.size());
    for (const std::int64_t lie : {std::int64_t{0}, size - 1, size + 1, std::int64_t{16 << 20}}) {
      EXPECT_FALSE(DecodeFrame(coded.coding, coded.bytes, lie).ok()) << schema;
    }
    for (std::size_t cut = 0; cut < coded.bytes.size(); ++cut) {
      EXPECT_FALSE(DecodeFrame(coded.coding, coded.bytes.substr(0, cut), size).ok()) << schema;
    }
    for (int i = 0; i < 20'000; ++i) {
      std::string changed = coded.bytes;
      for (int k = random() % 3; k >= 0; --k) {
        changed[random() % changed.size()] = static_cast<char>(random());
      }
      const auto decoded = DecodeFrame(coded.coding, changed, size);
      if (decoded.ok()) {
        EXPECT_EQ(decoded->size(), payload.size());
      } else {
        EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument);
      }
    }
  }
  EXPECT_FALSE(DecodeFrame(static_cast<v1::Coding>(77), "x", 1).ok());
}

}  // namespace
}  // namespace soundmap::recording
