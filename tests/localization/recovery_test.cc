#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>

#include "drive_along.h"
#include "localization/localizer.h"

namespace soundmap::localization {
namespace {

using frames::TimeNs;
using geometry::Pose2;

constexpr TimeNs kSecond_ns = 1'000'000'000;
constexpr TimeNs kStart_ns = 1'600'000'000 * kSecond_ns;

struct Drive {
  std::vector<frames::Frame> frames;
  std::vector<std::pair<TimeNs, Pose2>> truth;  // at each frame's stamp

  Pose2 TruthAt(TimeNs stamp_ns) const {
    const auto found = std::find_if(truth.begin(), truth.end(),
                                    [&](const auto& entry) { return entry.first == stamp_ns; });
    EXPECT_NE(found, truth.end());
    return found->second;
  }
  double ErrorOf(const PoseEstimate& estimate) const {
    const Pose2 pose = TruthAt(estimate.stamp_ns);
    return std::hypot(estimate.map_from_base.x_m - pose.x_m, estimate.map_from_base.y_m - pose.y_m);
  }
};

// Legs one after another, 0.1 s apart; the odometry does not notice that the robot was carried.
Drive MakeDrive(const std::vector<DriveAlong>& legs) {
  std::mt19937_64 engine(7);
  Drive drive;
  Pose2 odom_from_base{3.0, -2.0, 1.0};
  TimeNs now_ns = kStart_ns;
  for (const DriveAlong& leg : legs) {
    const auto frames = leg.Frames(now_ns, odom_from_base, engine);
    for (const frames::Frame& frame : frames) {
      const TimeNs stamp_ns = frames::StampOf(frame);
      if (drive.truth.empty() || drive.truth.back().first != stamp_ns) {
        drive.truth.emplace_back(stamp_ns, leg.TruthAt(frames::SecondsFromNs(stamp_ns - now_ns)));
      }
      drive.frames.push_back(frame);
    }
    now_ns = frames::StampOf(frames.back()) + kSecond_ns / 10;
  }
  return drive;
}

DriveAlong FirstLeg() {
  return {OfficeFloor(),
          {{12.5, 7.0}, {7.5, 7.0}, {7.5, 10.1}, {17.5, 10.1}, {17.5, 13.5}, {24.0, 17.5}}};
}

DriveAlong SecondLeg() {
  return {OfficeFloor(),
          {{38.5, 12.5}, {35.0, 12.5}, {35.0, 10.1}, {29.5, 10.1}, {29.5, 14.0}, {28.0, 18.0}}};
}

std::shared_ptr<const PreparedPlan> Prepare(const SyntheticRoom& room, const Config& config = {}) {
  auto plan = PreparedPlan::Create(config, room.Plan());
  EXPECT_TRUE(plan.ok()) << plan.status();
  return *plan;
}

Localizer Start(std::shared_ptr<const PreparedPlan> plan,
                const std::optional<InitialPose>& start = std::nullopt) {
  auto localizer = Localizer::Create(std::move(plan), LaserInFront(), start, 3);
  EXPECT_TRUE(localizer.ok()) << localizer.status();
  return *std::move(localizer);
}

std::vector<PoseEstimate> Feed(Localizer& localizer, const frames::Frame& frame) {
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
    return localizer.Add(*odometry);
  }
  return localizer.Add(std::get<frames::LaserScan>(frame));
}

TEST(Recovery, ARobotWithoutAStartFindsItsPlace) {
  const Drive drive = MakeDrive({FirstLeg()});
  Localizer localizer = Start(Prepare(OfficeFloor()));
  localizer.KeepFrom(kStart_ns);
  EXPECT_EQ(localizer.lost_since_ns(), std::numeric_limits<TimeNs>::min());
  std::optional<TimeNs> found_ns;
  for (const frames::Frame& frame : drive.frames) {
    for (const PoseEstimate& estimate : Feed(localizer, frame)) {
      if (estimate.state == State::kTracking) {
        EXPECT_LT(drive.ErrorOf(estimate), 0.1);
        if (!found_ns) found_ns = estimate.stamp_ns;
      } else {
        EXPECT_FALSE(found_ns.has_value()) << "lost again";
        EXPECT_EQ(estimate.state, State::kLost);
        EXPECT_EQ(localizer.lost_since_ns(), kStart_ns);
        EXPECT_EQ(localizer.At(estimate.stamp_ns)->state, State::kLost);
      }
    }
  }
  ASSERT_TRUE(found_ns.has_value());
  EXPECT_LT(*found_ns, kStart_ns + 12 * kSecond_ns);  // 0.5 m/s
  EXPECT_EQ(localizer.counters().recoveries, 1);
  EXPECT_EQ(localizer.counters().losses, 0);

  // And now it knows where it was from the first scan on.
  EXPECT_FALSE(localizer.lost_since_ns().has_value());
  int looked_at = 0;
  for (const auto& [stamp_ns, pose] : drive.truth) {
    const auto estimate = localizer.At(stamp_ns);
    ASSERT_TRUE(estimate.has_value());
    EXPECT_NE(estimate->state, State::kLost);
    EXPECT_LT(drive.ErrorOf(*estimate), 0.1);
    looked_at += stamp_ns < *found_ns;
  }
  EXPECT_GT(looked_at, 20);
  const auto path = localizer.Path(kStart_ns, *found_ns);
  ASSERT_GT(path.size(), 10u);
  for (std::size_t i = 1; i < path.size(); ++i) EXPECT_GT(path[i].stamp_ns, path[i - 1].stamp_ns);
}

TEST(Recovery, ARobotThatIsCarriedOffNoticesAndFindsItsPlace) {
  const DriveAlong first = FirstLeg();
  const Drive drive = MakeDrive({first, SecondLeg()});
  const TimeNs carried_ns =
      kStart_ns + static_cast<int>(first.duration_s() * 20.0) * 50'000'000LL + kSecond_ns / 10;
  Localizer localizer = Start(Prepare(OfficeFloor()), InitialPose{first.TruthAt(0.0)});
  localizer.KeepFrom(kStart_ns);
  int wrong_tracking = 0;
  std::optional<TimeNs> found_ns, lost_since_ns;
  for (const frames::Frame& frame : drive.frames) {
    for (const PoseEstimate& estimate : Feed(localizer, frame)) {
      const bool right = drive.ErrorOf(estimate) < 0.2;
      if (estimate.stamp_ns < carried_ns) {
        EXPECT_EQ(estimate.state, State::kTracking);
        EXPECT_TRUE(right);
        continue;
      }
      wrong_tracking += estimate.state == State::kTracking && !right;
      if (estimate.state == State::kTracking && right && !found_ns) found_ns = estimate.stamp_ns;
      if (localizer.lost_since_ns()) lost_since_ns = localizer.lost_since_ns();
    }
  }
  EXPECT_LE(wrong_tracking, 3);
  ASSERT_TRUE(found_ns.has_value());
  EXPECT_LT(*found_ns, carried_ns + 12 * kSecond_ns);
  EXPECT_EQ(localizer.counters().losses, 1);
  EXPECT_EQ(localizer.counters().recoveries, 1);
  // Lost from the moment on when it was carried off, or little before; all known afterwards.
  ASSERT_TRUE(lost_since_ns.has_value());
  EXPECT_GT(*lost_since_ns, carried_ns - 2 * kSecond_ns);
  EXPECT_LT(*lost_since_ns, carried_ns + kSecond_ns);
  EXPECT_FALSE(localizer.lost_since_ns().has_value());
  int lost = 0;
  for (const auto& [stamp_ns, pose] : drive.truth) {
    if (stamp_ns > *localizer.newest_odometry_ns() - kSecond_ns) break;
    const auto estimate = localizer.At(stamp_ns);
    ASSERT_TRUE(estimate.has_value());
    if (estimate->state == State::kLost) {
      ++lost;
      EXPECT_NEAR(frames::SecondsFromNs(stamp_ns - carried_ns), 0.0, 2.0);
    } else {
      EXPECT_LT(drive.ErrorOf(*estimate), 0.2) << frames::SecondsFromNs(stamp_ns - carried_ns);
    }
  }
  EXPECT_LE(lost, 30);
}

// Into a building that the map does not have: nothing there may pass for one that has changed.
TEST(Recovery, ARobotThatIsCarriedOffTheMapIsLost) {
  const DriveAlong first = FirstLeg();
  const DriveAlong elsewhere(
      {{0.0, 0.0, 17.0, 13.0}, {{5.0, 4.0, 9.0, 7.5}, {12.0, 0.0, 12.6, 6.0}}},
      {{3.0, 2.0}, {10.5, 2.0}, {10.5, 6.0}});
  const Drive drive = MakeDrive({first, elsewhere});
  const TimeNs carried_ns = kStart_ns + frames::NsFromSeconds(first.duration_s());
  Localizer localizer = Start(Prepare(OfficeFloor()), InitialPose{first.TruthAt(0.0)});
  int believed = 0, tracking = 0, all = 0;
  for (const frames::Frame& frame : drive.frames) {
    for (const PoseEstimate& estimate : Feed(localizer, frame)) {
      if (estimate.stamp_ns < carried_ns) continue;
      ++all;
      believed += estimate.state != State::kLost;
      tracking += estimate.state == State::kTracking;
    }
  }
  EXPECT_GT(all, 100);
  EXPECT_LE(believed, 30);  // some 0.1 m each
  EXPECT_LE(tracking, 3);
}

// The floor looks the same from both of its ends.
TEST(Recovery, WhereTwoPlacesAreTheSameItDoesNotChoose) {
  const SyntheticRoom floor = SymmetricFloor();
  const Drive drive = MakeDrive({DriveAlong(floor, {{8.5, 3.0}, {8.5, 10.0}, {18.0, 10.0}})});
  Localizer localizer = Start(Prepare(floor));
  for (const frames::Frame& frame : drive.frames) {
    for (const PoseEstimate& estimate : Feed(localizer, frame)) {
      EXPECT_EQ(estimate.state, State::kLost);
    }
  }
  EXPECT_EQ(localizer.counters().recoveries, 0);
  // It follows both.
  const auto hypotheses = localizer.state().hypotheses;
  ASSERT_GE(hypotheses.size(), 2u);
  const Pose2 truth = drive.truth.back().second;
  const Pose2 twin = Pose2{40.0, 20.0, geometry::kPi} * truth;
  for (const Pose2& place : {truth, twin}) {
    double nearest_m = 1e9;
    for (int i = 0; i < 2; ++i) {
      const Pose2 at = Summarize(hypotheses[i].particles).mean;
      nearest_m = std::min(nearest_m, std::hypot(at.x_m - place.x_m, at.y_m - place.y_m));
    }
    EXPECT_LT(nearest_m, 0.3);
  }
  // The spread says so.
  EXPECT_GT(std::sqrt(localizer.At(*localizer.newest_correction_ns())->covariance.trace()), 2.0);
}

TEST(Recovery, GoesOnBitByBitFromItsState) {
  const DriveAlong first = FirstLeg();
  const Drive drive = MakeDrive({first, SecondLeg()});
  Config config;
  config.search.look_back_scans = 3;
  const auto plan = Prepare(OfficeFloor(), config);
  for (const bool known_start : {false, true}) {
    std::optional<InitialPose> start;
    if (known_start) start = InitialPose{first.TruthAt(0.0)};
    Localizer whole = Start(plan, start);
    std::vector<LocalizerState> states;
    int searching = 0, looking_back = 0;
    std::vector<std::size_t> cuts;
    for (std::size_t i = 0; i < drive.frames.size(); ++i) {
      Feed(whole, drive.frames[i]);
      // Cuts of all kinds: every 40th frame, some in the search and some in the look back.
      const LocalizerState state = whole.state();
      searching += state.searching;
      looking_back += state.look_back.has_value();
      if (i % 900 == 60 || (state.searching && searching % 90 == 5) ||
          (state.look_back && looking_back % 30 == 2)) {
        states.push_back(state);
        cuts.push_back(i + 1);
      }
    }
    EXPECT_GT(searching, 40);
    EXPECT_GT(looking_back, 0);
    const LocalizerState expected = whole.state();
    for (std::size_t k = 0; k < cuts.size(); ++k) {
      auto restored = Localizer::Restore(plan, LaserInFront(), states[k]);
      ASSERT_TRUE(restored.ok()) << restored.status();
      for (std::size_t i = cuts[k]; i < drive.frames.size(); ++i) Feed(*restored, drive.frames[i]);
      const LocalizerState state = restored->state();
      EXPECT_EQ(state.particles, expected.particles) << "cut " << cuts[k];
      EXPECT_EQ(state.engine, expected.engine);
      EXPECT_EQ(state.counters, expected.counters);
      EXPECT_EQ(state.lost_since_ns, expected.lost_since_ns);
      EXPECT_EQ(state.odometry.size(), expected.odometry.size());
      ASSERT_EQ(state.corrections.size(), expected.corrections.size());
      for (std::size_t c = 0; c < state.corrections.size(); ++c) {
        EXPECT_EQ(state.corrections[c].estimate.map_from_base,
                  expected.corrections[c].estimate.map_from_base);
        EXPECT_EQ(state.corrections[c].estimate.state, expected.corrections[c].estimate.state);
      }
    }
  }
}

TEST(Recovery, WhatIsKeptIsBounded) {
  const SyntheticRoom floor = SymmetricFloor();
  Config config;
  config.search.max_kept_scans = 40;
  Localizer localizer = Start(Prepare(floor, config));
  localizer.KeepFrom(std::numeric_limits<TimeNs>::min());
  // Some 250 corrections, in the end turned round by hand.
  const Drive drive = MakeDrive({DriveAlong(floor, {{8.5, 3.0}, {8.5, 10.0}, {31.5, 10.0}}),
                                 DriveAlong(floor, {{31.5, 10.0}, {28.5, 10.0}})});
  for (const frames::Frame& frame : drive.frames) Feed(localizer, frame);
  const LocalizerState state = localizer.state();
  EXPECT_EQ(state.kept_scans.size(), 40u);
  EXPECT_LE(state.corrections.size(), 80u);
  EXPECT_GT(localizer.counters().scans_given_up, 100);
  EXPECT_EQ(localizer.lost_since_ns(), state.kept_scans.front().stamp_ns);
}

TEST(Recovery, HistoryReachesBackToWhereItIsAskedFor) {
  const DriveAlong leg(OfficeFloor(), {{2.0, 10.1}, {38.0, 10.1}});
  const Drive drive = MakeDrive({leg});  // 72 s
  const auto plan = Prepare(OfficeFloor());
  for (const bool keep : {false, true}) {
    Localizer localizer = Start(plan, InitialPose{leg.TruthAt(0.0)});
    if (keep) localizer.KeepFrom(kStart_ns + 10 * kSecond_ns);
    for (const frames::Frame& frame : drive.frames) Feed(localizer, frame);
    EXPECT_EQ(localizer.At(kStart_ns + 12 * kSecond_ns).has_value(), keep);
    EXPECT_TRUE(localizer.At(kStart_ns + 50 * kSecond_ns).has_value());
  }
}

// Lost, and then nothing but odometry for an hour, most of it standing.
TEST(Recovery, AnHourOfOdometryIsThinned) {
  Localizer localizer = Start(Prepare(SyntheticRoom()));
  Pose2 odom_from_base;
  for (int i = 0; i < 3600 * 20; ++i) {
    if (i % 1000 < 20) odom_from_base = odom_from_base * Pose2{0.02, 0.0, 0.01};
    localizer.Add(frames::Odometry{kStart_ns + i * kSecond_ns / 20, odom_from_base});
  }
  EXPECT_LT(localizer.state().odometry.size(), 6000u);
  EXPECT_EQ(localizer.lost_since_ns(), kStart_ns);
}

TEST(Recovery, BlindScansWhileLostChangeNothing) {
  const Drive drive = MakeDrive({FirstLeg()});
  Localizer localizer = Start(Prepare(OfficeFloor()));
  const float bad[] = {std::numeric_limits<float>::quiet_NaN(),
                       std::numeric_limits<float>::infinity(), 0.0f, -1.0f};
  int scans = 0;
  for (frames::Frame frame : drive.frames) {
    if (auto* scan = std::get_if<frames::LaserScan>(&frame)) {
      for (std::size_t i = 0; i < scan->range_m.size(); ++i)
        scan->range_m[i] = bad[(i + scans) % 4];
      ++scans;
    }
    EXPECT_TRUE(Feed(localizer, frame).empty());
    EXPECT_FALSE(localizer.At(frames::StampOf(frame)).has_value());
  }
  EXPECT_EQ(localizer.counters().scans_empty, scans);
  EXPECT_EQ(localizer.counters().searches, 0);
  EXPECT_EQ(localizer.lost_since_ns(), kStart_ns);
}

// Forward for 8 s, back for 3 s, and on: the odometry tells of way, but never that it is backwards.
TEST(Recovery, OdometryThatKnowsNoReverseIsSurvived) {
  const DriveAlong leg = FirstLeg();
  const Drive drive = MakeDrive({leg});
  const auto begin = [&drive](double time_s) {
    return std::find_if(drive.frames.begin(), drive.frames.end(), [time_s](const auto& frame) {
      return frames::SecondsFromNs(frames::StampOf(frame) - kStart_ns) >= time_s;
    });
  };
  std::vector<std::pair<frames::Frame, TimeNs>> played;  // and when
  for (auto frame = drive.frames.begin(); frame != begin(8.0); ++frame) {
    played.emplace_back(*frame, frames::StampOf(*frame));
  }
  for (auto frame = begin(8.0); frame-- != begin(5.0);) {
    played.emplace_back(*frame, 2 * kStart_ns + 16 * kSecond_ns - frames::StampOf(*frame));
  }
  for (auto frame = begin(5.0); frame != drive.frames.end(); ++frame) {
    played.emplace_back(*frame, frames::StampOf(*frame) + 6 * kSecond_ns);
  }
  Localizer localizer = Start(Prepare(OfficeFloor()), InitialPose{leg.TruthAt(0.0)});
  std::optional<Pose2> last;
  Pose2 told;
  std::map<TimeNs, Pose2> truth;
  double wrong_m = 0.0, end_error_m = 1.0;
  Pose2 before = leg.TruthAt(0.0);
  State end_state = State::kLost;
  for (auto& [frame, stamp_ns] : played) {
    truth[stamp_ns] = drive.TruthAt(frames::StampOf(frame));
    std::visit([stamp_ns](auto& f) { f.stamp_ns = stamp_ns; }, frame);
    if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      Pose2 step = last.value_or(odometry->odom_from_base).Inverse() * odometry->odom_from_base;
      step.x_m = std::abs(step.x_m);
      last = odometry->odom_from_base;
      odometry->odom_from_base = told = told * step;
    }
    for (const PoseEstimate& estimate : Feed(localizer, frame)) {
      const Pose2 pose = truth.at(estimate.stamp_ns);
      const Pose2 off = pose.Inverse() * estimate.map_from_base;
      end_error_m = std::hypot(off.x_m, off.y_m);
      end_state = estimate.state;
      if (end_state == State::kTracking && end_error_m > 0.5) {
        wrong_m += std::hypot(pose.x_m - before.x_m, pose.y_m - before.y_m);
      }
      before = pose;
    }
  }
  EXPECT_LT(wrong_m, 2.0);
  EXPECT_EQ(end_state, State::kTracking);
  EXPECT_LT(end_error_m, 0.2);
}

// It stands still while the robot drives.
TEST(Recovery, OdometryThatStopsIsNoticed) {
  const DriveAlong leg = FirstLeg();
  const Drive drive = MakeDrive({leg});
  Localizer localizer = Start(Prepare(OfficeFloor()), InitialPose{leg.TruthAt(0.0)});
  std::optional<Pose2> stuck;
  for (frames::Frame frame : drive.frames) {
    if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      const double time_s = frames::SecondsFromNs(odometry->stamp_ns - kStart_ns);
      if (time_s > 8.0 && time_s < 12.0) {
        if (!stuck) stuck = odometry->odom_from_base;
        odometry->odom_from_base = *stuck;  // 2 m of driving are missing
      }
    }
    for (const PoseEstimate& estimate : Feed(localizer, frame)) {
      const double time_s = frames::SecondsFromNs(estimate.stamp_ns - kStart_ns);
      if (time_s < 8.0 || time_s > 25.0) {
        EXPECT_EQ(estimate.state, State::kTracking) << time_s;
        EXPECT_LT(drive.ErrorOf(estimate), 0.2) << time_s;
      }
    }
  }
}

TEST(Recovery, APlanWithoutAFreeCellIsRefused) {
  building::FloorPlan plan(80, 60, 0.05, {0.0, 0.0});
  plan.at(3, 3) = building::Cell::kOccupied;
  const auto prepared = PreparedPlan::Create({}, plan);
  EXPECT_TRUE(absl::IsInvalidArgument(prepared.status()));
  EXPECT_THAT(std::string(prepared.status().message()), testing::HasSubstr("no free cell"));
}

}  // namespace
}  // namespace soundmap::localization
