#include "localization/localizer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "drive_along.h"
#include "synthetic_room.h"

namespace soundmap::localization {
namespace {

using frames::TimeNs;
using geometry::Pose2;

constexpr TimeNs kSecond_ns = 1'000'000'000;
constexpr TimeNs kStart_ns = 1'600'000'000 * kSecond_ns;

struct Drive {
  std::vector<frames::Frame> frames;
  TimeNs duration_ns = 0;
};

Pose2 Truth(TimeNs time_ns) { return LapPose(frames::SecondsFromNs(time_ns - kStart_ns)); }

// Odometry at 20 Hz that drifts by 2 % of the way and 3 degrees a metre, scans at 10 Hz between two
// odometry messages.
Drive MakeDrive(const SyntheticRoom& room, double duration_s, std::uint64_t seed,
                TimeNs scan_stamp_late_ns = 0) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal;
  Drive drive;
  drive.duration_ns = frames::NsFromSeconds(duration_s);
  Pose2 odom_from_base{0.5, -0.3, 0.9};
  for (TimeNs t = 0; t <= drive.duration_ns; t += kSecond_ns / 20) {
    if (t > 0) {
      const Pose2 step = Truth(kStart_ns + t - kSecond_ns / 20).Inverse() * Truth(kStart_ns + t);
      odom_from_base =
          odom_from_base * Pose2{1.02 * step.x_m + 0.0005 * normal(engine), step.y_m,
                                 step.yaw_rad + 0.052 * step.x_m + 0.0005 * normal(engine)};
    }
    drive.frames.emplace_back(frames::Odometry{kStart_ns + t, odom_from_base});
    if (t % (kSecond_ns / 10) == 0) {
      const TimeNs scan_ns = kStart_ns + t + kSecond_ns / 50;
      frames::LaserScan scan = ScanAt(room, Truth(scan_ns), scan_ns, 0.01, engine);
      scan.stamp_ns += scan_stamp_late_ns;
      drive.frames.emplace_back(std::move(scan));
    }
  }
  return drive;
}

std::shared_ptr<const PreparedPlan> Prepare(const SyntheticRoom& room, const Config& config = {}) {
  auto plan = PreparedPlan::Create(config, room.Plan());
  EXPECT_TRUE(plan.ok()) << plan.status();
  return *plan;
}

Localizer MakeLocalizer(std::shared_ptr<const PreparedPlan> plan, std::uint64_t seed = 1) {
  auto localizer =
      Localizer::Create(std::move(plan), LaserInFront(), InitialPose{Truth(kStart_ns)}, seed);
  EXPECT_TRUE(localizer.ok()) << localizer.status();
  return *std::move(localizer);
}

std::vector<PoseEstimate> Feed(Localizer& localizer, const frames::Frame& frame) {
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
    return localizer.Add(*odometry);
  }
  return localizer.Add(std::get<frames::LaserScan>(frame));
}

std::vector<PoseEstimate> FeedAll(Localizer& localizer, const std::vector<frames::Frame>& frames) {
  std::vector<PoseEstimate> all;
  for (const frames::Frame& frame : frames) {
    for (const PoseEstimate& estimate : Feed(localizer, frame)) all.push_back(estimate);
  }
  return all;
}

double PositionError(const PoseEstimate& estimate) {
  const Pose2 truth = Truth(estimate.stamp_ns);
  return std::hypot(estimate.map_from_base.x_m - truth.x_m, estimate.map_from_base.y_m - truth.y_m);
}

double YawError(const PoseEstimate& estimate) {
  return std::abs(
      geometry::NormalizeAngle(estimate.map_from_base.yaw_rad - Truth(estimate.stamp_ns).yaw_rad));
}

bool Same(const PoseEstimate& a, const PoseEstimate& b) {
  return a.stamp_ns == b.stamp_ns && a.map_from_base == b.map_from_base &&
         a.covariance == b.covariance && a.effective_particles == b.effective_particles &&
         a.scan_fit == b.scan_fit && a.state == b.state;
}

TEST(Localizer, TracksThroughDriftingOdometry) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 30.0, 5);
  for (const Config& config : {PaperConfig(), DefaultConfig()}) {
    const auto plan = Prepare(room, config);
    const double bound_m = config.refinement.enabled ? 0.01 : 0.03;
    for (std::uint64_t seed = 0; seed < 5; ++seed) {
      Localizer localizer = MakeLocalizer(plan, seed);
      double position_sum_m = 0.0;
      double yaw_sum_rad = 0.0;
      int count = 0;
      for (const frames::Frame& frame : drive.frames) {
        Feed(localizer, frame);
        // Half a second late, so that corrections lie on both sides.
        const auto estimate = localizer.At(frames::StampOf(frame) - kSecond_ns / 2);
        if (!estimate) continue;
        ++count;
        position_sum_m += PositionError(*estimate);
        yaw_sum_rad += YawError(*estimate);
        EXPECT_LT(PositionError(*estimate), 0.10);
        EXPECT_TRUE(count <= 5 || estimate->state == State::kTracking);
      }
      EXPECT_GT(count, 800);
      EXPECT_LT(position_sum_m / count, bound_m) << seed;
      EXPECT_LT(yaw_sum_rad / count, 0.006) << seed;
      EXPECT_GT(localizer.counters().corrections, 100);
      EXPECT_GT(localizer.counters().resamplings, 10);
    }
  }
}

TEST(Localizer, CorrectsOnlyAfterTheWayThatThePaperSays) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 10.0, 5);
  Localizer localizer = MakeLocalizer(Prepare(room));
  const auto corrections = FeedAll(localizer, drive.frames);
  ASSERT_GT(corrections.size(), 20u);
  EXPECT_EQ(corrections.front().stamp_ns, kStart_ns + kSecond_ns / 50);
  for (std::size_t i = 1; i < corrections.size(); ++i) {
    const Pose2 moved =
        Truth(corrections[i - 1].stamp_ns).Inverse() * Truth(corrections[i].stamp_ns);
    // The odometry reads 2 % and some noise more than was driven.
    EXPECT_TRUE(std::hypot(moved.x_m, moved.y_m) > 0.095 ||
                std::abs(moved.yaw_rad) > geometry::RadFromDeg(4.0));
  }
  EXPECT_EQ(localizer.newest_correction_ns(), corrections.back().stamp_ns);
}

TEST(Localizer, StandingStillKeepsThePose) {
  const SyntheticRoom room;
  std::mt19937_64 engine(1);
  Localizer localizer = MakeLocalizer(Prepare(room));
  const Pose2 truth = Truth(kStart_ns);
  TimeNs now_ns = kStart_ns;
  for (int i = 0; i < 1200; ++i, now_ns += kSecond_ns / 10) {
    localizer.Add(frames::Odometry{now_ns, {1.0, 2.0, 3.0}});
    localizer.Add(ScanAt(room, truth, now_ns, 0.01, engine));
  }
  EXPECT_EQ(localizer.counters().corrections, 1);
  EXPECT_EQ(localizer.considered_until_ns(), now_ns - kSecond_ns / 10);
  const auto estimate = localizer.At(now_ns - kSecond_ns);
  ASSERT_TRUE(estimate.has_value());
  EXPECT_NEAR(estimate->map_from_base.x_m, truth.x_m, 0.01);
  EXPECT_NEAR(estimate->map_from_base.y_m, truth.y_m, 0.01);
  EXPECT_EQ(estimate->state, State::kTracking);
}

TEST(Localizer, OnAWrongMapItIsLost) {
  const Drive drive = MakeDrive(SyntheticRoom(), 20.0, 5);
  // No wall of them stands where one of the right room does.
  const SyntheticRoom wrong_rooms[] = {
      {{-2.0, -2.0, 7.1, 5.2}, {{2.0, 3.0, 3.0, 4.0}}},
      {{-1.4, -1.2, 20.0, 15.0}, {}},
  };
  for (const SyntheticRoom& wrong : wrong_rooms) {
    Localizer localizer = MakeLocalizer(Prepare(wrong));
    const auto corrections = FeedAll(localizer, drive.frames);
    int lost = 0;
    for (const PoseEstimate& estimate : corrections) {
      EXPECT_NE(estimate.state, State::kTracking);
      lost += estimate.state == State::kLost;
    }
    EXPECT_GT(lost, 0.9 * static_cast<double>(corrections.size()));
    EXPECT_EQ(corrections.back().state, State::kLost) << corrections.back().scan_fit;
    EXPECT_EQ(localizer.At(kStart_ns + 19 * kSecond_ns)->state, State::kLost);
  }
}

TEST(Localizer, ScansWithoutReturnsCorrectNothingAndThenItIsLost) {
  const SyntheticRoom room;
  Drive drive = MakeDrive(room, 45.0, 5);
  Localizer localizer = MakeLocalizer(Prepare(room));
  const float bad[] = {std::numeric_limits<float>::quiet_NaN(),
                       std::numeric_limits<float>::infinity(), 0.0f, -1.0f};
  int scans = 0;
  for (frames::Frame& frame : drive.frames) {
    auto* scan = std::get_if<frames::LaserScan>(&frame);
    if (scan != nullptr && frames::StampOf(frame) > kStart_ns + 5 * kSecond_ns) {
      for (std::size_t i = 0; i < scan->range_m.size(); ++i)
        scan->range_m[i] = bad[(i + scans) % 4];
      ++scans;
    }
    Feed(localizer, frame);
    const auto estimate = localizer.At(frames::StampOf(frame));
    if (!estimate) continue;
    const double blind_s = frames::SecondsFromNs(frames::StampOf(frame) - kStart_ns) - 5.0;
    if (blind_s < 1.0) {
      EXPECT_EQ(estimate->state, State::kTracking) << blind_s;
    } else if (blind_s > 6.0 && blind_s < 24.0) {
      EXPECT_EQ(estimate->state, State::kUncertain) << blind_s;
    } else if (blind_s > 38.0) {
      EXPECT_EQ(estimate->state, State::kLost) << blind_s;
    }
  }
  EXPECT_GT(localizer.counters().scans_empty, 300);
  frames::LaserScan empty{kStart_ns + 1000 * kSecond_ns, 0.0, 0.01, {}};
  EXPECT_TRUE(localizer.Add(empty).empty());
  empty.range_m.assign(1'000'000, 1.0f);
  EXPECT_TRUE(localizer.Add(empty).empty());
  empty.range_m.assign(100, 1.0f);
  empty.angle_increment_rad = std::nan("");
  EXPECT_TRUE(localizer.Add(empty).empty());
}

TEST(Localizer, ScansWaitForOdometryAndTheOldestGoesWhenTooManyDo) {
  const SyntheticRoom room;
  std::mt19937_64 engine(1);
  Config config;
  config.max_waiting_scans = 5;
  Localizer localizer = MakeLocalizer(Prepare(room, config));
  for (int i = 0; i < 12; ++i) {
    const TimeNs stamp_ns = kStart_ns + i * kSecond_ns;
    EXPECT_TRUE(localizer.Add(ScanAt(room, Truth(stamp_ns), stamp_ns, 0.0, engine)).empty());
    EXPECT_LE(localizer.state().waiting_scans.size(), 5u);
  }
  EXPECT_EQ(localizer.counters().scans_overflowed, 7);
  EXPECT_FALSE(localizer.At(kStart_ns).has_value());
  // Those of seconds 7 to 11 still wait.
  std::vector<PoseEstimate> corrections;
  for (int i = 0; i <= 220; ++i) {
    const TimeNs stamp_ns = kStart_ns + i * kSecond_ns / 20;
    const Pose2 odom_from_base = Truth(kStart_ns).Inverse() * Truth(stamp_ns);
    for (const auto& estimate : localizer.Add(frames::Odometry{stamp_ns, odom_from_base})) {
      EXPECT_EQ(estimate.stamp_ns, stamp_ns);
      corrections.push_back(estimate);
    }
  }
  ASSERT_EQ(corrections.size(), 5u);
  EXPECT_LT(PositionError(corrections.back()), 0.02);
  // A scan from before the odometry, or a second time, is of no use.
  EXPECT_TRUE(localizer.Add(ScanAt(room, Truth(kStart_ns), kStart_ns, 0.0, engine)).empty());
  EXPECT_EQ(localizer.counters().scans_ignored, 1);
}

TEST(Localizer, RepeatedAndBrokenOdometryChangesNothing) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 5.0, 5);
  const auto plan = Prepare(room);
  Localizer clean = MakeLocalizer(plan);
  Localizer disturbed = MakeLocalizer(plan);
  for (const frames::Frame& frame : drive.frames) {
    Feed(clean, frame);
    Feed(disturbed, frame);
    if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      disturbed.Add(*odometry);
      disturbed.Add(frames::Odometry{odometry->stamp_ns - kSecond_ns, {9.0, 9.0, 9.0}});
      disturbed.Add(frames::Odometry{odometry->stamp_ns + 1, {std::nan(""), 0.0, 0.0}});
    }
  }
  const auto a = clean.At(kStart_ns + 4 * kSecond_ns);
  const auto b = disturbed.At(kStart_ns + 4 * kSecond_ns);
  ASSERT_TRUE(a && b);
  EXPECT_TRUE(Same(*a, *b));
  EXPECT_EQ(disturbed.counters().odometry_ignored, 3 * 101);
}

TEST(Localizer, AJumpOfTheOdometryIsNoMotion) {
  const SyntheticRoom room;
  Drive drive = MakeDrive(room, 12.0, 5);
  Localizer localizer = MakeLocalizer(Prepare(room));
  std::vector<PoseEstimate> corrections;
  for (frames::Frame& frame : drive.frames) {
    auto* odometry = std::get_if<frames::Odometry>(&frame);
    if (odometry != nullptr && odometry->stamp_ns > kStart_ns + 6 * kSecond_ns) {
      // The wheel encoders begin anew elsewhere.
      odometry->odom_from_base = Pose2{-40.0, 7.0, 2.0} * odometry->odom_from_base;
    }
    for (const auto& estimate : Feed(localizer, frame)) corrections.push_back(estimate);
  }
  EXPECT_EQ(localizer.counters().odometry_jumps, 1);
  for (const PoseEstimate& estimate : corrections) EXPECT_LT(PositionError(estimate), 0.10);
  EXPECT_EQ(corrections.back().state, State::kTracking);
  EXPECT_LT(PositionError(corrections.back()), 0.02);
}

TEST(Localizer, TheFrameOfTheOdometryCarriesLaterOdometryIntoTheMap) {
  const SyntheticRoom room;
  Drive drive = MakeDrive(room, 12.0, 5);
  Localizer localizer = MakeLocalizer(Prepare(room));
  EXPECT_FALSE(localizer.odometry_frame());
  const auto error_m = [](const OdometryFrame& frame, const frames::Odometry& odometry) {
    const Pose2 map_from_base = frame.map_from_odom * odometry.odom_from_base;
    const Pose2 truth = Truth(odometry.stamp_ns);
    return std::hypot(map_from_base.x_m - truth.x_m, map_from_base.y_m - truth.y_m);
  };
  std::optional<OdometryFrame> in_the_middle;
  frames::Odometry last;
  for (frames::Frame& frame : drive.frames) {
    if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      // The wheel encoders begin anew elsewhere.
      if (odometry->stamp_ns > kStart_ns + 3 * kSecond_ns) {
        odometry->odom_from_base = Pose2{-40.0, 7.0, 2.0} * odometry->odom_from_base;
      }
      last = *odometry;
    }
    Feed(localizer, frame);
    if (!in_the_middle && last.stamp_ns >= kStart_ns + 6 * kSecond_ns) {
      in_the_middle = localizer.odometry_frame();
      ASSERT_TRUE(in_the_middle);
      EXPECT_EQ(in_the_middle->stamp_ns, last.stamp_ns);
    }
  }
  const auto at_the_end = localizer.odometry_frame();
  ASSERT_TRUE(at_the_end);
  EXPECT_LT(error_m(*at_the_end, last), 0.10);
  // 6 s, 3 m and 9 degrees of drift later; a frame of the encoders before would be 40 m off.
  EXPECT_LT(error_m(*in_the_middle, last), 0.60);
  // One that goes on from its state knows the same.
  const auto again = Localizer::Restore(Prepare(room), LaserInFront(), localizer.state());
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->odometry_frame()->map_from_odom, at_the_end->map_from_odom);
}

TEST(Localizer, ALagOfTheLaserIsTakenOut) {
  const SyntheticRoom room;
  const TimeNs late_ns = kSecond_ns / 10;
  const Drive drive = MakeDrive(room, 15.0, 5, late_ns);
  Config config;
  double mean_error_m[2];
  for (int i = 0; i < 2; ++i) {
    config.laser_lag_s = i == 0 ? 0.0 : 0.1;
    Localizer localizer = MakeLocalizer(Prepare(room, config));
    const auto corrections = FeedAll(localizer, drive.frames);
    double sum_m = 0.0;
    for (const PoseEstimate& estimate : corrections) sum_m += PositionError(estimate);
    mean_error_m[i] = sum_m / static_cast<double>(corrections.size());
  }
  EXPECT_NEAR(mean_error_m[0], 0.5 * 0.1,
              0.015);  // half a metre a second, a tenth of a second late
  EXPECT_LT(mean_error_m[1], 0.01);
}

// Turns on the spot between straight drives tell the lag, whatever it is; what is known of it is
// part of the state.
TEST(Localizer, FindsTheLagOfTheLaserByItself) {
  const SyntheticRoom room;
  const DriveAlong along(room, {{1.5, 1.0},
                                {6.5, 1.0},
                                {6.5, 5.0},
                                {2.0, 5.0},
                                {2.0, 1.0},
                                {6.5, 1.0},
                                {6.5, 5.0},
                                {2.0, 5.0},
                                {1.5, 1.0},
                                {6.5, 1.0}});
  const auto plan = Prepare(room);
  for (const double lag_s : {0.0, 0.1, -0.08}) {
    std::mt19937_64 engine(3);
    Pose2 odom_from_base;
    std::vector<frames::Frame> frames = along.Frames(kStart_ns, odom_from_base, engine);
    for (frames::Frame& frame : frames) {
      if (auto* scan = std::get_if<frames::LaserScan>(&frame)) {
        scan->stamp_ns += frames::NsFromSeconds(lag_s);
      }
    }
    std::stable_sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) {
      return frames::StampOf(a) < frames::StampOf(b);
    });
    auto localizer =
        Localizer::Create(plan, LaserInFront(), InitialPose{along.TruthAt(0.0)}, 1).value();
    double late_error_m = 0.0;
    int late = 0;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (i % 101 == 0) {
        localizer = Localizer::Restore(plan, LaserInFront(), localizer.state()).value();
      }
      for (const PoseEstimate& estimate : Feed(localizer, frames[i])) {
        const double time_s = frames::SecondsFromNs(estimate.stamp_ns - kStart_ns);
        if (time_s < 0.5 * along.duration_s()) continue;
        const Pose2 off = along.TruthAt(time_s).Inverse() * estimate.map_from_base;
        late_error_m += std::hypot(off.x_m, off.y_m);
        ++late;
      }
    }
    EXPECT_NEAR(localizer.laser_lag_s(), lag_s, 0.015);
    EXPECT_LT(late_error_m / late, 0.015) << "lag " << lag_s;
  }
}

TEST(Localizer, BetweenCorrectionsBothAreCarriedByOdometryAndWeightedByTime) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 6.0, 5);
  Localizer localizer = MakeLocalizer(Prepare(room));
  const auto corrections = FeedAll(localizer, drive.frames);
  frames::OdometryTrack track;
  for (const frames::Frame& frame : drive.frames) {
    if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) track.Add(*odometry);
  }
  for (std::size_t i = 1; i < corrections.size(); ++i) {
    const PoseEstimate& a = corrections[i - 1];
    const PoseEstimate& b = corrections[i];
    const auto at_a = localizer.At(a.stamp_ns);
    ASSERT_TRUE(at_a.has_value());
    EXPECT_NEAR(at_a->map_from_base.x_m, a.map_from_base.x_m, 1e-9);
    EXPECT_NEAR(at_a->map_from_base.yaw_rad, a.map_from_base.yaw_rad, 1e-9);
    const TimeNs time_ns = a.stamp_ns + (b.stamp_ns - a.stamp_ns) / 4;
    const auto at = localizer.At(time_ns);
    ASSERT_TRUE(at.has_value());
    EXPECT_EQ(at->stamp_ns, time_ns);
    const auto carry = [&](const PoseEstimate& from) {
      return from.map_from_base.ToIsometry() * track.At(from.stamp_ns)->ToIsometry().inverse() *
             track.At(time_ns)->ToIsometry();
    };
    const Eigen::Vector3d expected = 0.75 * carry(a).translation() + 0.25 * carry(b).translation();
    EXPECT_NEAR(at->map_from_base.x_m, expected.x(), 1e-6);
    EXPECT_NEAR(at->map_from_base.y_m, expected.y(), 1e-6);
  }
  const TimeNs end_ns = kStart_ns + drive.duration_ns;
  const PoseEstimate& last = corrections.back();
  const auto carried = localizer.At(end_ns);
  ASSERT_TRUE(carried.has_value());
  EXPECT_GT(carried->covariance(0, 0), last.covariance(0, 0));
  EXPECT_FALSE(localizer.At(end_ns + 1).has_value());
  EXPECT_FALSE(localizer.At(kStart_ns - 1).has_value());
  EXPECT_TRUE(localizer.At(kStart_ns).has_value());
}

TEST(Localizer, GoesOnBitByBitFromItsState) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 8.0, 5);
  const auto plan = Prepare(room);
  Localizer whole = MakeLocalizer(plan);
  const auto expected = FeedAll(whole, drive.frames);
  for (const std::size_t cut : {0, 1, 2, 3, 50, 77, 121, 122, 123}) {
    Localizer first = MakeLocalizer(plan);
    const std::vector<frames::Frame> head(drive.frames.begin(), drive.frames.begin() + cut);
    const std::vector<frames::Frame> tail(drive.frames.begin() + cut, drive.frames.end());
    auto corrections = FeedAll(first, head);
    auto second = Localizer::Restore(plan, LaserInFront(), first.state());
    ASSERT_TRUE(second.ok()) << second.status();
    for (const auto& estimate : FeedAll(*second, tail)) corrections.push_back(estimate);
    ASSERT_EQ(corrections.size(), expected.size());
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_TRUE(Same(corrections[i], expected[i])) << "cut " << cut << ", correction " << i;
    }
    EXPECT_EQ(second->particles(), whole.particles());
    EXPECT_EQ(second->counters(), whole.counters());
    EXPECT_EQ(second->state().engine, whole.state().engine);
    const TimeNs time_ns = kStart_ns + 3 * kSecond_ns;
    EXPECT_TRUE(Same(*second->At(time_ns), *whole.At(time_ns)));
  }
}

TEST(Localizer, TheNumberOfParticlesCanAdapt) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 20.0, 5);
  Config config;
  config.adaptive.enabled = true;
  config.particles = 1500;
  config.adaptive.min_particles = 50;
  const auto plan = Prepare(room, config);
  auto localizer =
      Localizer::Create(plan, LaserInFront(), InitialPose{Truth(kStart_ns), 0.5, 0.2}, 1);
  ASSERT_TRUE(localizer.ok());
  EXPECT_EQ(localizer->particles().size(), 1500u);
  std::size_t most = 0, fewest = 1500;
  for (const frames::Frame& frame : drive.frames) {
    for (const PoseEstimate& estimate : Feed(*localizer, frame)) {
      if (estimate.stamp_ns < kStart_ns + 10 * kSecond_ns) continue;
      EXPECT_LT(PositionError(estimate), 0.1);
      most = std::max(most, localizer->particles().size());
      fewest = std::min(fewest, localizer->particles().size());
      EXPECT_TRUE(Localizer::Restore(plan, LaserInFront(), localizer->state()).ok());
    }
  }
  EXPECT_LT(most, 600u);
  EXPECT_GE(fewest, 50u);
}

TEST(Localizer, TheSeedDecides) {
  const SyntheticRoom room;
  const Drive drive = MakeDrive(room, 3.0, 5);
  const auto plan = Prepare(room);
  Localizer a = MakeLocalizer(plan, 1);
  Localizer b = MakeLocalizer(plan, 1);
  Localizer c = MakeLocalizer(plan, 2);
  FeedAll(a, drive.frames);
  FeedAll(b, drive.frames);
  FeedAll(c, drive.frames);
  EXPECT_EQ(a.particles(), b.particles());
  EXPECT_NE(a.particles(), c.particles());
}

TEST(Localizer, RefusesAStateOfAnotherConfiguration) {
  const SyntheticRoom room;
  const auto plan = Prepare(room);
  Localizer localizer = MakeLocalizer(plan);
  FeedAll(localizer, MakeDrive(room, 1.0, 5).frames);
  const LocalizerState good = localizer.state();
  ASSERT_TRUE(Localizer::Restore(plan, LaserInFront(), good).ok());
  const auto refused = [&](auto change) {
    LocalizerState state = good;
    change(state);
    return !Localizer::Restore(plan, LaserInFront(), state).ok();
  };
  EXPECT_TRUE(refused([](LocalizerState& s) { s.particles.pop_back(); }));
  EXPECT_TRUE(refused([](LocalizerState& s) { s.engine = "no engine"; }));
  EXPECT_TRUE(refused([](LocalizerState& s) { std::swap(s.odometry[0], s.odometry[1]); }));
  EXPECT_TRUE(refused([](LocalizerState& s) { s.particles[3].map_from_base.x_m = std::nan(""); }));
  EXPECT_TRUE(refused([](LocalizerState& s) { s.odom_from_particles.reset(); }));
  EXPECT_TRUE(refused([](LocalizerState& s) { s.waiting_scans.resize(1000); }));
  EXPECT_TRUE(refused([](LocalizerState& s) { s.laser_lag_s = 7.0; }));
  EXPECT_TRUE(refused([](LocalizerState& s) { s.lag.turned_rad = std::nan(""); }));
}

TEST(Localizer, SaysWhyItCannotStart) {
  const SyntheticRoom room;
  const auto plan = Prepare(room);
  Config no_search;
  no_search.search.enabled = false;
  const auto unknown = Localizer::Create(Prepare(room, no_search), LaserInFront(), std::nullopt, 1);
  EXPECT_TRUE(absl::IsFailedPrecondition(unknown.status()));
  EXPECT_THAT(std::string(unknown.status().message()), testing::HasSubstr("initial pose"));
  const auto off = Localizer::Create(plan, LaserInFront(), InitialPose{{50.0, 1.0, 0.0}}, 1);
  EXPECT_TRUE(absl::IsInvalidArgument(off.status()));
  EXPECT_THAT(std::string(off.status().message()), testing::HasSubstr("outside the floor plan"));
  EXPECT_FALSE(
      Localizer::Create(plan, LaserInFront(), InitialPose{{std::nan(""), 1.0, 0.0}}, 1).ok());
  EXPECT_FALSE(
      Localizer::Create(plan, LaserInFront(), InitialPose{{1.0, 1.0, 0.0}, -1.0, 0.1}, 1).ok());
  frames::Calibration tilted = LaserInFront();
  tilted.base_from_laser.rotate(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()));
  EXPECT_THAT(
      std::string(
          Localizer::Create(plan, tilted, InitialPose{{1.0, 1.0, 0.0}}, 1).status().message()),
      testing::HasSubstr("tilted"));
  Config config;
  config.beams = 0;
  EXPECT_FALSE(PreparedPlan::Create(config, room.Plan()).ok());
  EXPECT_FALSE(PreparedPlan::Create({}, building::FloorPlan()).ok());
}

}  // namespace
}  // namespace soundmap::localization
