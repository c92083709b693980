#include "pipeline/listening.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "geometry/angles.h"

namespace soundmap::pipeline {
namespace {

// A square room of 6 m with its centre at the origin of the map, maybe with a pillar in a corner, a
// robot that drives along x, and noise in its microphones.
constexpr double kHalf_m = 3.0;
constexpr double kSpeed_mps = 0.4;
constexpr frames::TimeNs kStart_ns = 1'700'000'000'000'000'000;

geometry::Pose2 TruePose(double time_s) { return {-1.0 + kSpeed_mps * time_s, 0.2, 0.1}; }

// The pillar fills the corner of the largest x and y.
constexpr double kPillar_m = 1.5;

double RangeToWall(double x_m, double y_m, double angle_rad, bool pillar) {
  const double c = std::cos(angle_rad);
  const double s = std::sin(angle_rad);
  const double to_x = c == 0.0 ? 1e9 : (c > 0.0 ? kHalf_m - x_m : -kHalf_m - x_m) / c;
  const double to_y = s == 0.0 ? 1e9 : (s > 0.0 ? kHalf_m - y_m : -kHalf_m - y_m) / s;
  double range_m = std::min(to_x, to_y);
  constexpr double kFace_m = kHalf_m - kPillar_m;
  if (pillar && c > 0.0 && x_m < kFace_m) {
    const double to_face = (kFace_m - x_m) / c;
    if (y_m + to_face * s > kFace_m) range_m = std::min(range_m, to_face);
  }
  if (pillar && s > 0.0 && y_m < kFace_m) {
    const double to_face = (kFace_m - y_m) / s;
    if (x_m + to_face * c > kFace_m) range_m = std::min(range_m, to_face);
  }
  return range_m;
}

std::shared_ptr<const PreparedBuilding> Room(const Profile& profile, bool pillar) {
  building::FloorPlan plan(130, 130, 0.05, {-3.25, -3.25});
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      const int edge = std::min({column, row, plan.width() - 1 - column, plan.height() - 1 - row});
      plan.at(column, row) = edge < 4    ? building::Cell::kUnknown
                             : edge == 4 ? building::Cell::kOccupied
                                         : building::Cell::kFree;
      // The face of the pillar lies on the near edge of its first cells.
      const int inside =
          std::min(column, row) - static_cast<int>((kHalf_m - kPillar_m + 3.25) / 0.05);
      if (pillar && edge > 4 && inside >= 0) {
        plan.at(column, row) = inside == 0 ? building::Cell::kOccupied : building::Cell::kUnknown;
      }
    }
  }
  return PreparedBuilding::Create(profile, {nullptr, plan}).value();
}

frames::Calibration Robot() {
  frames::Calibration calibration;
  calibration.base_from_array.translation().z() = 1.0;
  calibration.base_from_lidar.translation().z() = 1.2;
  calibration.base_from_laser.translation().z() = 0.3;
  calibration.mic_in_array_m = {{0.1, 0, 0}, {0, 0.1, 0}, {-0.1, 0, 0.05}, {0, -0.1, 0.1}};
  calibration.audio_sample_rate_hz = 16000;
  return calibration;
}

std::vector<frames::Frame> Drive(double seconds, bool pillar = false) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0.0, 300.0);
  std::vector<frames::Frame> drive;
  for (int tick = 0; tick < static_cast<int>(seconds * 20.0); ++tick) {
    const double time_s = tick / 20.0;
    const frames::TimeNs stamp_ns = kStart_ns + frames::NsFromSeconds(time_s);
    const geometry::Pose2 pose = TruePose(time_s);
    drive.push_back(frames::Odometry{stamp_ns, TruePose(0.0).Inverse() * pose});
    if (tick % 2 == 0) {
      frames::LaserScan scan{stamp_ns, -geometry::kPi / 2.0, geometry::kPi / 180.0, {}};
      for (int beam = 0; beam <= 180; ++beam) {
        const double angle_rad = pose.yaw_rad - geometry::kPi / 2.0 + beam * geometry::kPi / 180.0;
        scan.range_m.push_back(
            static_cast<float>(RangeToWall(pose.x_m, pose.y_m, angle_rad, pillar)));
      }
      drive.push_back(scan);
    }
    if (tick % 10 == 0) {
      frames::LidarScan scan;
      scan.stamp_ns = stamp_ns;
      for (int ring = -5; ring <= 5; ++ring) {
        for (int step = 0; step < 360; ++step) {
          const double angle_rad = step * geometry::kPi / 180.0;
          const double range_m = RangeToWall(pose.x_m, pose.y_m, pose.yaw_rad + angle_rad, pillar);
          scan.point_in_lidar.emplace_back(range_m * std::cos(angle_rad),
                                           range_m * std::sin(angle_rad), 0.1 * ring);
        }
      }
      drive.push_back(scan);
    }
    frames::AudioBlock block{stamp_ns, 16000, 4, {}};
    for (int sample = 0; sample < 800 * 4; ++sample) {
      block.samples.push_back(static_cast<std::int16_t>(noise(random)));
    }
    drive.push_back(block);
  }
  return drive;
}

class ListeningTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::get<acoustics::EqualAreaGrid>(profile_.acoustics.grid).spacing_rad =
        geometry::RadFromDeg(15.0);
  }
  std::unique_ptr<Listening> Create() { return Create(profile_, {}, TruePose(0.0)); }
  std::unique_ptr<Listening> Create(const Profile& profile, const std::vector<Band>& bands,
                                    const std::optional<geometry::Pose2>& start) {
    return Listening::Create(profile, bands, Robot(), Room(profile, pillar_), start, /*seed=*/1)
        .value();
  }

  Profile profile_ = *ProfileByName("default");
  bool pillar_ = false;
};

// As a session does that knows where the robot is.
void Process(Listening& listening, const frames::Frame& frame, Listening::Output& output) {
  listening.Localize(frame, output);
  listening.Hear(frame, output);
}

bool SameOutput(const Listening::Output& a, const Listening::Output& b) {
  if (a.scans.size() != b.scans.size() || a.path.size() != b.path.size()) return false;
  for (std::size_t i = 0; i < a.scans.size(); ++i) {
    if (!(a.scans[i].evidence == b.scans[i].evidence)) return false;
  }
  for (std::size_t i = 0; i < a.path.size(); ++i) {
    if (!(a.path[i].map_from_base == b.path[i].map_from_base)) return false;
  }
  return true;
}

TEST_F(ListeningTest, EvidenceLiesOnTheWalls) {
  const auto listening = Create();
  Listening::Output output;
  for (const frames::Frame& frame : Drive(4.0)) Process(*listening, frame, output);
  listening->Finish(output);
  ASSERT_GT(output.scans.size(), 20u);
  EXPECT_EQ(listening->counters().audio_scans, static_cast<std::int64_t>(output.scans.size()));
  for (const Listening::Scan& scan : output.scans) {
    const double time_s = frames::SecondsFromNs(scan.evidence.stamp_ns - kStart_ns);
    const geometry::Pose2 truth = TruePose(time_s);
    EXPECT_NEAR(scan.pose.map_from_base.x_m, truth.x_m, 0.05) << time_s;
    EXPECT_NEAR(scan.pose.map_from_base.y_m, truth.y_m, 0.05) << time_s;
    for (const sound_map::EndPoint& end : scan.evidence.end_points) {
      const Eigen::Vector3d point = geometry::PointFromKey(end.key, 0.05);
      EXPECT_NEAR(std::max(std::abs(point.x()), std::abs(point.y())), kHalf_m, 0.12);
    }
  }
}

// Localizes each frame from `next` on and hears what can be heard, as a session does; returns the
// frames heard.
std::size_t ProcessInOrder(Listening& listening, const std::vector<frames::Frame>& drive,
                           Listening::Output& output, std::size_t next = 0) {
  auto heard = static_cast<std::size_t>(listening.heard());
  for (std::size_t i = next; i < drive.size(); ++i) {
    listening.Localize(drive[i], output);
    while (heard <= i && !listening.waits()) listening.Hear(drive[heard++], output);
  }
  return heard;
}

TEST_F(ListeningTest, ARobotWithoutAStartIsHeardOnceItKnowsWhereItWas) {
  // The square room looks the same from four places; a pillar tells them apart.
  pillar_ = true;
  const std::vector<frames::Frame> drive = Drive(6.0, pillar_);
  const auto known = Create();
  Listening::Output expected;
  EXPECT_EQ(ProcessInOrder(*known, drive, expected), drive.size());
  known->Finish(expected);

  const auto unknown = Create(profile_, {}, std::nullopt);
  Listening::Output output;
  const std::vector<frames::Frame> beginning(drive.begin(), drive.begin() + 70);
  EXPECT_LT(ProcessInOrder(*unknown, beginning, output), beginning.size());
  EXPECT_TRUE(output.scans.empty()) << "it does not know where it is";
  EXPECT_EQ(ProcessInOrder(*unknown, drive, output, beginning.size()), drive.size());
  unknown->Finish(output);
  EXPECT_GE(output.scans.size(), expected.scans.size() - 2) << "nothing is lost";
  for (const Listening::Scan& scan : output.scans) {
    const geometry::Pose2 truth =
        TruePose(frames::SecondsFromNs(scan.evidence.stamp_ns - kStart_ns));
    EXPECT_NEAR(scan.pose.map_from_base.x_m, truth.x_m, 0.05);
    EXPECT_NEAR(scan.pose.map_from_base.y_m, truth.y_m, 0.05);
  }
  for (std::size_t i = 1; i < output.scans.size(); ++i) {
    EXPECT_LT(output.scans[i - 1].evidence.stamp_ns, output.scans[i].evidence.stamp_ns);
  }
  EXPECT_EQ(unknown->counters().unheard_ns, 0);
}

TEST_F(ListeningTest, WhatARobotHeardThatNeverKnewWhereItWasIsLeftOutAndSaid) {
  // Four places look the same for ever.
  const auto listening = Create(profile_, {}, std::nullopt);
  Listening::Output output;
  EXPECT_LT(ProcessInOrder(*listening, Drive(4.0, false), output), 60u);
  listening->Finish(output);
  EXPECT_TRUE(output.scans.empty());
  EXPECT_NEAR(frames::SecondsFromNs(listening->counters().unheard_ns), 4.0, 0.6);
  const std::vector<std::string> warnings = listening->Warnings();
  EXPECT_TRUE(std::any_of(warnings.begin(), warnings.end(), [](const std::string& warning) {
    return warning.find("did not learn where it was") != std::string::npos;
  }));
}

// From the start, or a third of the way, a robot that knows where it is; one that searches, and
// one that has just been found and looks back.
TEST_F(ListeningTest, GoesOnBitForBitFromASavedState) {
  for (const bool known_start : {true, false}) {
    pillar_ = !known_start;
    const std::vector<frames::Frame> drive = Drive(6.0, pillar_);
    const auto create = [&] {
      const auto start = known_start ? std::optional(TruePose(0.0)) : std::nullopt;
      return Create(profile_, {}, start);
    };
    for (std::size_t moment = 1; moment < drive.size(); moment += drive.size() / 9) {
      const auto first = create();
      Listening::Output before;
      const std::vector<frames::Frame> beginning(drive.begin(), drive.begin() + moment);
      ProcessInOrder(*first, beginning, before);
      const std::string state = first->SaveState();
      const auto second = create();
      ASSERT_TRUE(second->RestoreState(state).ok());
      EXPECT_EQ(second->heard(), first->heard());
      Listening::Output a;
      Listening::Output b;
      ProcessInOrder(*first, drive, a, moment);
      ProcessInOrder(*second, drive, b, moment);
      first->Finish(a);
      second->Finish(b);
      EXPECT_GT(a.scans.size() + a.path.size(), 0u);
      EXPECT_TRUE(SameOutput(a, b)) << moment;
      EXPECT_EQ(first->SaveState(), second->SaveState()) << moment;
      EXPECT_TRUE(absl::IsDataLoss(second->RestoreState(state.substr(0, state.size() / 2))));
    }
  }
}

TEST_F(ListeningTest, WithoutLidarThereIsNoEvidenceAndAWarning) {
  const auto listening = Create();
  Listening::Output output;
  for (const frames::Frame& frame : Drive(3.0)) {
    if (!std::holds_alternative<frames::LidarScan>(frame)) Process(*listening, frame, output);
  }
  listening->Finish(output);
  EXPECT_TRUE(output.scans.empty());
  EXPECT_GT(output.path.size(), 3u);
  const std::vector<std::string> warnings = listening->Warnings();
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("LIDAR"), std::string::npos);
}

TEST_F(ListeningTest, AMicrophoneOfInvertedPolarityIsNamed) {
  const auto mended = [&](const std::vector<int>& inverted) {
    const auto listening = Create();
    Listening::Output output;
    std::mt19937 random(8);
    std::normal_distribution<double> noise(0.0, 1000.0);
    std::vector<frames::Frame> drive = Drive(8.0);
    for (frames::Frame& frame : drive) {
      if (auto* audio = std::get_if<frames::AudioBlock>(&frame)) {
        // A sound that reaches all microphones at once.
        for (std::size_t i = 0; i < audio->samples.size(); i += 4) {
          const auto sound = static_cast<std::int16_t>(noise(random));
          for (int n = 0; n < 4; ++n) audio->samples[i + n] += sound;
          for (const int n : inverted) audio->samples[i + n] *= -1;
        }
      }
      Process(*listening, frame, output);
    }
    listening->Finish(output);
    EXPECT_EQ(listening->counters().inverted_microphones, inverted);
    return listening->Warnings();
  };
  EXPECT_EQ(mended({}), std::vector<std::string>{});
  const std::vector<std::string> warnings = mended({2});
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("audio scan(s) mended the inverted polarity of mic_2"),
            std::string::npos)
      << warnings[0];
}

TEST_F(ListeningTest, OdometryThatRunsBackwardsIsCountedAndLeftOut) {
  const auto listening = Create();
  Listening::Output output;
  const std::vector<frames::Frame> drive = Drive(2.0);
  for (const frames::Frame& frame : drive) Process(*listening, frame, output);
  const std::size_t scans = output.scans.size();
  for (const frames::Frame& frame : drive) Process(*listening, frame, output);
  listening->Finish(output);
  EXPECT_EQ(listening->counters().backward_odometry, 40);
  EXPECT_LE(output.scans.size(), scans + 8);  // those that waited, not the drive again
}

// The scans of one band, in their order.
std::vector<Listening::Scan> OfBand(const Listening::Output& output, std::uint8_t band) {
  std::vector<Listening::Scan> scans;
  for (const Listening::Scan& scan : output.scans) {
    if (scan.band == band) scans.push_back(scan);
  }
  return scans;
}

// Bit for bit all that enters a map.
void ExpectSame(const std::vector<Listening::Scan>& a, const std::vector<Listening::Scan>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_TRUE(a[i].evidence == b[i].evidence) << i;
    ASSERT_EQ(a[i].heard, b[i].heard);
    ASSERT_EQ(a[i].array_plane, b[i].array_plane);
    ASSERT_EQ(a[i].audio.noise_floor, b[i].audio.noise_floor);
    ASSERT_EQ(a[i].audio.peaks.size(), b[i].audio.peaks.size());
    for (std::size_t peak = 0; peak < a[i].audio.peaks.size(); ++peak) {
      ASSERT_EQ(a[i].audio.peaks[peak].power, b[i].audio.peaks[peak].power);
    }
    ASSERT_EQ(a[i].pose.map_from_base, b[i].pose.map_from_base);
  }
}

// The drive, with a sound of high frequencies ahead of the robot and one of low ones on its left.
std::vector<frames::Frame> DriveBetweenTwoSounds(double seconds, bool pillar) {
  // Of the microphones, in samples of 2 cm.
  constexpr int kFromAhead[] = {0, 5, 9, 5};
  constexpr int kFromTheLeft[] = {5, 0, 5, 9};
  constexpr int kLowPass = 16;
  std::vector<frames::Frame> drive = Drive(seconds, pillar);
  std::mt19937 random(6);
  std::normal_distribution<double> noise(0.0, 1000.0);
  std::vector<double> high(static_cast<std::size_t>(seconds * 16000.0) + 32);
  std::vector<double> low(high.size());
  for (double& sample : high) sample = noise(random);
  for (double& sample : low) sample = noise(random);
  for (std::size_t i = high.size() - 1; i > 0; --i) high[i] -= high[i - 1];
  for (std::size_t i = low.size() - 1; i >= kLowPass; --i) {
    for (int n = 1; n < kLowPass; ++n) low[i] += low[i - n];
  }
  std::size_t begin = 16;
  for (frames::Frame& frame : drive) {
    auto* audio = std::get_if<frames::AudioBlock>(&frame);
    if (audio == nullptr) continue;
    for (std::size_t i = 0; i < audio->samples.size(); ++i) {
      const std::size_t sample = begin + i / 4;
      audio->samples[i] += static_cast<std::int16_t>(high[sample - kFromAhead[i % 4]] +
                                                     low[sample - kFromTheLeft[i % 4]]);
    }
    begin += audio->samples.size() / 4;
  }
  return drive;
}

// Such an array hears above and below alike: a peak has a place on either side of it, and what the
// floor's echo says of it.
TEST_F(ListeningTest, APeakOfAnArrayInAPlaneHasTwoPlaces) {
  frames::Calibration robot = Robot();
  for (Eigen::Vector3d& mic : robot.mic_in_array_m) mic.z() = 0.0;
  robot.base_from_array.translation().z() = 1.3;  // the LIDAR sees what is level with it
  std::get<acoustics::EqualAreaGrid>(profile_.acoustics.grid).spacing_rad =
      geometry::RadFromDeg(3.0);
  const auto listening =
      Listening::Create(profile_, {}, robot, Room(profile_, false), TruePose(0.0), /*seed=*/1)
          .value();
  Listening::Output output;
  for (const frames::Frame& frame : DriveBetweenTwoSounds(4.0, false)) {
    Process(*listening, frame, output);
  }
  listening->Finish(output);
  int pairs = 0;
  for (const Listening::Scan& scan : output.scans) {
    ASSERT_TRUE(scan.array_plane);
    const auto along_plane = [&scan](const sound_map::HeardPeak& peak) -> Eigen::Vector2d {
      return (peak.place_in_map_m - scan.array_plane->origin_in_map_m).normalized().head<2>();
    };
    const std::vector<sound_map::HeardPeak>& heard = scan.heard;
    for (std::size_t i = 0; i + 1 < heard.size(); ++i) {
      if ((along_plane(heard[i]) - along_plane(heard[i + 1])).norm() > 1e-9) continue;
      ++pairs;
      EXPECT_FALSE(heard[i].ripple.values.empty());
      EXPECT_TRUE(heard[i + 1].ripple.values.empty());
      const double z_m = scan.array_plane->origin_in_map_m.z();
      EXPECT_LE((heard[i].place_in_map_m.z() - z_m) * (heard[i + 1].place_in_map_m.z() - z_m), 0.0);
    }
  }
  EXPECT_GT(pairs, 20);
}

const std::vector<Band> kHissAndHum = {{"hiss", 4000.0, 7000.0}, {"hum", 200.0, 900.0}};

class BandsTest : public ListeningTest {
 protected:
  // With both bands, against one robot for each band alone; `run` is given each.
  template <typename Run>
  void ExpectEachAsAlone(const Run& run, std::size_t min_scans) {
    for (const auto& start : {std::optional(TruePose(0.0)), std::optional<geometry::Pose2>()}) {
      SCOPED_TRACE(start ? "known start" : "unknown start");
      pillar_ = !start;
      const auto all = Create(profile_, kHissAndHum, start);
      const Listening::Output output = run(*all);
      EXPECT_TRUE(std::is_sorted(output.scans.begin(), output.scans.end(),
                                 [](const Listening::Scan& a, const Listening::Scan& b) {
                                   return std::pair(a.evidence.stamp_ns, a.band) <
                                          std::pair(b.evidence.stamp_ns, b.band);
                                 }));
      std::vector<Profile> profiles = {profile_};
      for (const Band& band : kHissAndHum) profiles.push_back(ProfileOf(band, profile_));
      for (std::uint8_t band = 0; band < 3; ++band) {
        SCOPED_TRACE(int{band});
        const auto alone = Create(profiles[band], {}, start);
        const Listening::Output expected = run(*alone);
        ASSERT_GT(expected.scans.size(), min_scans);
        ExpectSame(OfBand(output, band), expected.scans);
        if (band != kMainBand) continue;
        EXPECT_EQ(all->counters().audio_scans, alone->counters().audio_scans);
        EXPECT_EQ(all->counters().faulty_audio_scans, alone->counters().faulty_audio_scans);
        EXPECT_EQ(all->counters().dead_microphone_scans, alone->counters().dead_microphone_scans);
        EXPECT_EQ(all->counters().scans_without_pose, alone->counters().scans_without_pose);
        EXPECT_EQ(all->counters().scans_without_range, alone->counters().scans_without_range);
        EXPECT_EQ(all->Warnings(), alone->Warnings());
        ASSERT_EQ(output.path.size(), expected.path.size());
      }
      // They hear something, and not the same.
      int differ = 0;
      for (std::size_t i = 1; i < output.scans.size(); ++i) {
        differ += output.scans[i - 1].evidence == output.scans[i].evidence ? 0 : 1;
      }
      EXPECT_GT(differ, static_cast<int>(output.scans.size()) * 2 / 3);
    }
  }
};

TEST_F(BandsTest, EachBandIsHeardAsIfItWereTheOnlyOne) {
  ExpectEachAsAlone(
      [this](Listening& listening) {
        std::vector<frames::Frame> drive = DriveBetweenTwoSounds(6.0, pillar_);
        // A gap in the audio, a dead microphone for a while, LIDAR scans that are missing.
        int number = 0;
        std::erase_if(drive, [&number](const frames::Frame& frame) {
          ++number;
          if (std::holds_alternative<frames::LidarScan>(frame)) return number > 60 && number < 130;
          return std::holds_alternative<frames::AudioBlock>(frame) && number > 150 && number < 160;
        });
        for (std::size_t i = drive.size() / 2; i < drive.size() * 3 / 4; ++i) {
          if (auto* audio = std::get_if<frames::AudioBlock>(&drive[i])) {
            for (std::size_t n = 1; n < audio->samples.size(); n += 4) audio->samples[n] = 0;
          }
        }
        Listening::Output output;
        ProcessInOrder(listening, drive, output);
        listening.Finish(output);
        return output;
      },
      20);
}

// The sound comes first, and all else then: as many scans wait as may wait of one band.
TEST_F(BandsTest, OfEachBandAsManyScansMayWaitAsOfOne) {
  ExpectEachAsAlone(
      [this](Listening& listening) {
        std::vector<frames::Frame> drive = DriveBetweenTwoSounds(9.0, pillar_);
        std::stable_partition(drive.begin(), drive.end(), [](const frames::Frame& frame) {
          return std::holds_alternative<frames::AudioBlock>(frame);
        });
        Listening::Output output;
        for (const frames::Frame& frame : drive) Process(listening, frame, output);
        listening.Finish(output);
        EXPECT_GT(listening.counters().scans_without_pose, 3) << "the oldest did not wait";
        return output;
      },
      20);
}

TEST_F(BandsTest, GoOnBitForBitFromASavedState) {
  const std::vector<frames::Frame> drive = DriveBetweenTwoSounds(4.0, false);
  for (std::size_t moment = 1; moment < drive.size(); moment += drive.size() / 5) {
    const auto first = Create(profile_, kHissAndHum, TruePose(0.0));
    Listening::Output before;
    ProcessInOrder(*first, {drive.begin(), drive.begin() + static_cast<std::ptrdiff_t>(moment)},
                   before);
    const std::string state = first->SaveState();
    const auto second = Create(profile_, kHissAndHum, TruePose(0.0));
    ASSERT_TRUE(second->RestoreState(state).ok());
    Listening::Output a;
    Listening::Output b;
    ProcessInOrder(*first, drive, a, moment);
    ProcessInOrder(*second, drive, b, moment);
    first->Finish(a);
    second->Finish(b);
    EXPECT_GT(OfBand(a, 2).size(), 0u);
    for (std::uint8_t band = 0; band < 3; ++band) ExpectSame(OfBand(a, band), OfBand(b, band));
    EXPECT_EQ(first->SaveState(), second->SaveState()) << moment;
    EXPECT_TRUE(absl::IsDataLoss(Create()->RestoreState(state))) << "it is of other bands";
  }
}

TEST_F(BandsTest, WhatTheSampleRateDoesNotReachIsSaidOnceAndLeftOut) {
  const std::vector<frames::Frame> drive = Drive(3.0);
  const auto run = [&](Listening& listening) {
    Listening::Output output;
    ProcessInOrder(listening, drive, output);
    listening.Finish(output);
    return output;
  };
  const auto all = Create(profile_,
                          {{"bats", 20000.0, 40000.0},
                           {"half", 8000.0, 9000.0},
                           {"line", 101.0, 102.0},
                           {"hiss", 7000.0, 12000.0}},
                          TruePose(0.0));
  const Listening::Output output = run(*all);
  const auto alone = Create();
  ExpectSame(OfBand(output, kMainBand), run(*alone).scans);
  for (const std::uint8_t band : {1, 2, 3}) EXPECT_TRUE(OfBand(output, band).empty());
  EXPECT_EQ(OfBand(output, 4).size(), OfBand(output, kMainBand).size());
  const std::vector<std::string> warnings = all->Warnings();
  ASSERT_EQ(warnings.size(), 3u);
  EXPECT_EQ(warnings[0],
            "nothing was heard in the band 'bats', 20000 to 40000 Hz: audio sampled at 16000 Hz "
            "does not reach it");
  EXPECT_NE(warnings[1].find("'half'"), std::string::npos);
  EXPECT_NE(warnings[2].find("no frequency bin lies in the band"), std::string::npos);
}

}  // namespace
}  // namespace soundmap::pipeline
