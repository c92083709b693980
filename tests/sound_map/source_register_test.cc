#include "sound_map/source_register.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <random>
#include <set>

#include "geometry/angles.h"
#include "sound_map/sound_map.h"

namespace soundmap::sound_map {
namespace {

constexpr double kVoxel_m = 0.05;
constexpr double kHeight_m = 2.7;
constexpr frames::TimeNs kScan_ns = 125'000'000;

// A source in a ceiling of 6 x 4 m, and when it is on.
struct Emitter {
  Eigen::Vector2d place_m;
  double heard_share = 0.9;  // of the scans while it is on
  std::function<bool(frames::TimeNs)> on = [](frames::TimeNs) { return true; };
  double level_db = 0.0;  // over the others
};

using Emitters = std::vector<Emitter>;

// What a robot hears that drives up and down below, seeing all of the ceiling: each peak lands some
// centimetres beside its source.
class Room {
 public:
  explicit Room(std::vector<Emitter> emitters, unsigned seed = 7)
      : emitters_(std::move(emitters)), random_(seed) {}

  EvidenceScan Hear(frames::TimeNs stamp_ns) {
    std::vector<Eigen::Vector2d> peaks;
    heard.clear();
    for (const Emitter& emitter : emitters_) {
      const Eigen::Vector2d peak =
          emitter.place_m + 0.06 * Eigen::Vector2d(normal_(random_), normal_(random_));
      if (!(share_(random_) < emitter.heard_share && emitter.on(stamp_ns))) continue;
      peaks.push_back(peak);
      HeardPeak& level = heard.emplace_back();
      level.place_in_map_m << peak, kHeight_m;
      // Single scans scatter by half their mean.
      for (int band = 0; band < 5; ++band) {
        level.power_at_1m[band] = static_cast<float>(
            1e-3 * std::pow(10.0, emitter.level_db / 10.0) * (1.0 + 0.5 * normal_(random_)));
      }
    }
    EvidenceScan scan;
    scan.stamp_ns = stamp_ns;
    for (double x = 0.025; x < 6.0; x += kVoxel_m) {
      for (double y = 0.025; y < 4.0; y += kVoxel_m) {
        float likelihood = 0.4f;
        for (const Eigen::Vector2d& peak : peaks) {
          const double distance_m = (Eigen::Vector2d(x, y) - peak).norm();
          if (distance_m < 0.1) likelihood = 0.9f;
          if (distance_m < 0.35) likelihood = std::max(likelihood, 0.5f);
        }
        scan.end_points.push_back(
            {*geometry::KeyFromPoint(Eigen::Vector3d(x, y, kHeight_m), kVoxel_m), likelihood});
      }
    }
    return scan;
  }

  std::vector<HeardPeak> heard;  // in the last scan

  static Eigen::Vector2d RobotAt(frames::TimeNs stamp_ns, double y_m) {
    const double t_s = frames::SecondsFromNs(stamp_ns);
    return {3.0 + 2.0 * std::sin(0.2 * t_s), y_m};
  }

 private:
  std::vector<Emitter> emitters_;
  std::mt19937 random_;
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> share_;
};

// Map and register as a site has them.
class Listener {
 public:
  void Take(const EvidenceScan& scan, const std::string& robot = "r1",
            const std::vector<HeardPeak>* peaks = nullptr, double robot_y_m = 2.0) {
    ASSERT_TRUE(map_->Apply(scan).ok());
    sources_.Observe({robot, Room::RobotAt(scan.stamp_ns, robot_y_m), &scan, peaks});
    if (!sources_.due()) return;
    for (SourceEvent& event :
         sources_.Update(FindSoundSources(*map_->TakeSnapshot(), config_.sources))) {
      events_.push_back(std::move(event));
    }
  }
  void Hear(Room& room, double from_s, double to_s, const std::string& robot = "r1",
            double robot_y_m = 2.0) {
    for (frames::TimeNs t = frames::NsFromSeconds(from_s); t < frames::NsFromSeconds(to_s);
         t += kScan_ns) {
      Take(room.Hear(t), robot, &room.heard, robot_y_m);
    }
  }

  std::vector<RegisteredSource> Sources() const { return sources_.Sources(); }
  const RegisteredSource* Near(const Eigen::Vector2d& place_m) {
    shown_ = Sources();
    for (const RegisteredSource& source : shown_) {
      if ((source.found.position_in_map_m.head<2>() - place_m).norm() < 0.3) return &source;
    }
    return nullptr;
  }
  int Count(SourceEvent::Kind kind) const {
    return static_cast<int>(std::count_if(events_.begin(), events_.end(),
                                          [kind](const SourceEvent& e) { return e.kind == kind; }));
  }
  SourceRegister& sources() { return sources_; }
  const std::vector<SourceEvent>& events() const { return events_; }

 private:
  const SoundMapConfig config_ = DefaultConfig();
  const std::unique_ptr<SoundMap> map_ = SoundMap::Create(config_).value();
  SourceRegister sources_{config_};
  std::vector<SourceEvent> events_;
  std::vector<RegisteredSource> shown_;
};

using Kind = SourceEvent::Kind;

TEST(SourceRegister, ASourceIsOneObjectWhileMoreIsHeard) {
  Room room(Emitters{{{0.8, 0.9}}, {{4.1, 3.0}, /*heard_share=*/0.4}});
  Listener listener;
  listener.Hear(room, 0, 20);
  ASSERT_EQ(listener.Sources().size(), 2u);
  const std::uint64_t strong = listener.Near({0.8, 0.9})->found.id;
  const std::uint64_t weak = listener.Near({4.1, 3.0})->found.id;
  listener.Hear(room, 20, 60);
  ASSERT_EQ(listener.Sources().size(), 2u);
  EXPECT_EQ(listener.Near({0.8, 0.9})->found.id, strong);
  const RegisteredSource source = *listener.Near({4.1, 3.0});
  EXPECT_EQ(source.found.id, weak);
  EXPECT_EQ(source.state, SourceState::kActive);
  EXPECT_EQ(source.robots, std::vector<std::string>{"r1"});
  // The robot covers 4 m: the view points lie a metre apart.
  EXPECT_GE(source.view_points.size(), 3u);
  EXPECT_LE(source.view_points.size(), 5u);
  ASSERT_EQ(source.heard.size(), 1u);
  EXPECT_LT(source.heard[0].begin_ns, frames::NsFromSeconds(10));
  EXPECT_GT(source.heard[0].end_ns, frames::NsFromSeconds(55));
  EXPECT_EQ(listener.events().size(), 2u);
  EXPECT_EQ(listener.Count(Kind::kAppeared), 2);
  // The error of a single scan is 0.06 m an axis, beside the voxels' own.
  const double sigma_m = std::sqrt(source.position_covariance_m2(0, 0));
  EXPECT_LT(sigma_m, 0.06);
  EXPECT_GE(sigma_m, kVoxel_m / std::sqrt(12.0));
  EXPECT_NEAR(source.position_covariance_m2(2, 2), kVoxel_m * kVoxel_m / 12.0, 1e-9);
}

TEST(SourceRegister, ASourceThatStopsIsSilentWithinAMinuteAndComesBack) {
  const auto on = [](frames::TimeNs t) {
    return t < frames::NsFromSeconds(40) || t >= frames::NsFromSeconds(120);
  };
  Room room(Emitters{{{0.8, 0.9}, 0.9, on}, {{2.8, 1.2}, 0.4, on}, {{4.8, 3.0}}});
  Listener listener;
  listener.Hear(room, 0, 39);
  for (const RegisteredSource& source : listener.Sources()) {
    EXPECT_EQ(source.state, SourceState::kActive);
  }
  const std::uint64_t id = listener.Near({0.8, 0.9})->found.id;
  listener.Hear(room, 39, 100);
  ASSERT_NE(listener.Near({2.8, 1.2}), nullptr);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kSilent);
  EXPECT_EQ(listener.Near({2.8, 1.2})->state, SourceState::kSilent);
  EXPECT_EQ(listener.Near({4.8, 3.0})->state, SourceState::kActive);
  EXPECT_GT(listener.Near({0.8, 0.9})->found.probability, 0.9);
  EXPECT_EQ(listener.Count(Kind::kFellSilent), 2);
  listener.Hear(room, 120, 160);
  EXPECT_EQ(listener.Near({0.8, 0.9})->found.id, id);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kActive);
  EXPECT_EQ(listener.Near({0.8, 0.9})->heard.size(), 2u);
  EXPECT_EQ(listener.Count(Kind::kActiveAgain), 2);
  EXPECT_EQ(listener.Count(Kind::kAppeared), 3);
  EXPECT_EQ(listener.Count(Kind::kVanished), 0);
  EXPECT_EQ(listener.Sources().size(), 3u);
}

// Nobody listens: nothing is known to have changed.
TEST(SourceRegister, WhatIsNotListenedToDoesNotFallSilent) {
  Room room(Emitters{{{0.8, 0.9}}, {{4.8, 3.0}}});
  Listener listener;
  listener.Hear(room, 0, 30);
  for (double t_s = 30; t_s < 200; t_s += 0.125) {
    EvidenceScan scan = room.Hear(frames::NsFromSeconds(t_s));
    std::erase_if(scan.end_points, [](const EndPoint& end_point) {
      return geometry::PointFromKey(end_point.key, kVoxel_m).x() < 3.0;
    });
    listener.Take(scan);
  }
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kActive);
  EXPECT_LT(listener.Near({0.8, 0.9})->last_listened_ns, frames::NsFromSeconds(30));
}

// From far away it is not heard, though its place is seen.
TEST(SourceRegister, SilenceIsJudgedFromWhereItWasHeardBefore) {
  const auto on = [](frames::TimeNs t) { return t < frames::NsFromSeconds(30); };
  Room room(Emitters{{{0.8, 0.9}, 0.9, on}});
  Listener listener;
  listener.Hear(room, 0, 30);
  listener.Hear(room, 30, 130, "r1", /*robot_y_m=*/9.0);
  ASSERT_NE(listener.Near({0.8, 0.9}), nullptr);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kActive);
  EXPECT_GT(listener.Near({0.8, 0.9})->last_listened_ns, frames::NsFromSeconds(129));
  listener.Hear(room, 130, 190);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kSilent);
}

TEST(SourceRegister, LongSilenceIsGoneAndALateRecordingChangesHistoryAlone) {
  const auto on = [](frames::TimeNs t) { return t < frames::NsFromSeconds(1040); };
  Room room(Emitters{{{0.8, 0.9}, 0.9, on}});
  Listener listener;
  listener.Hear(room, 1000, 1060);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kSilent);
  // An hour of driving elsewhere does not count, but ten minutes of listening do.
  listener.Hear(room, 4600, 5150);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kSilent);
  listener.Hear(room, 5150, 5250);
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kGone);
  EXPECT_EQ(listener.Count(Kind::kVanished), 1);
  // What another robot recorded when it was on arrives now.
  listener.Hear(room, 500, 530, "r2");
  EXPECT_EQ(listener.Near({0.8, 0.9})->state, SourceState::kGone);
  EXPECT_EQ(listener.Near({0.8, 0.9})->heard.size(), 2u);
  EXPECT_EQ(listener.Near({0.8, 0.9})->robots, (std::vector<std::string>{"r1", "r2"}));
}

// Two drives, between which a source was carried 3 m.
TEST(SourceRegister, ASourceThatWasMovedKeepsItsNameAtItsNewPlace) {
  const Eigen::Vector2d old_place(1.2, 1.0);
  const Eigen::Vector2d new_place(4.2, 1.0);
  Room before(Emitters{{old_place}, {{4.8, 3.2}}});
  Room after(Emitters{{new_place}, {{4.8, 3.2}}}, 8);
  Listener listener;
  listener.Hear(before, 0, 60);
  const std::uint64_t id = listener.Near(old_place)->found.id;
  const std::uint64_t other = listener.Near({4.8, 3.2})->found.id;
  listener.Hear(after, 1000, 1060);
  EXPECT_EQ(listener.Near(old_place), nullptr);
  ASSERT_NE(listener.Near(new_place), nullptr);
  EXPECT_EQ(listener.Near(new_place)->found.id, id);
  EXPECT_EQ(listener.Near(new_place)->state, SourceState::kActive);
  EXPECT_EQ(listener.Near(new_place)->heard.size(), 2u);
  EXPECT_LT(listener.Near(new_place)->found.first_heard_ns, frames::NsFromSeconds(20));
  EXPECT_EQ(listener.Near({4.8, 3.2})->found.id, other);
  EXPECT_EQ(listener.Sources().size(), 2u);
  ASSERT_EQ(listener.Count(Kind::kMoved), 1);
  for (const SourceEvent& event : listener.events()) {
    if (event.kind != Kind::kMoved) continue;
    EXPECT_LT((event.from_in_map_m.head<2>() - old_place).norm(), 0.05);
    EXPECT_NE(event.other_id, id);
  }
  // Another one where it was is another one.
  Room both(Emitters{{old_place}, {new_place}, {{4.8, 3.2}}}, 9);
  listener.Hear(both, 2000, 2060);
  EXPECT_EQ(listener.Sources().size(), 3u);
  EXPECT_EQ(listener.Near(new_place)->found.id, id);
  EXPECT_NE(listener.Near(old_place)->found.id, id);
}

// Where nobody was before, it may have been all the time.
TEST(SourceRegister, OneThatIsFoundInANewPlaceHasNotMoved) {
  Room before(Emitters{{{1.2, 1.0}}});
  Room silent(Emitters{});
  Room after(Emitters{{{4.2, 1.0}}}, 8);
  Listener listener;
  listener.Hear(before, 0, 60);
  listener.Hear(silent, 60, 120);
  listener.Hear(after, 200, 260, "r1", /*robot_y_m=*/9.0);
  EXPECT_EQ(listener.Sources().size(), 2u);
  EXPECT_EQ(listener.Near({1.2, 1.0})->state, SourceState::kSilent);
  EXPECT_EQ(listener.Count(Kind::kMoved), 0);
}

// It sounds otherwise, or both have been heard at one time: another source.
TEST(SourceRegister, OneThatStopsAndAnotherThatStartsAreTwo) {
  Room before(Emitters{{{1.2, 1.0}}});
  Room both(Emitters{{{1.2, 1.0}}, {{4.2, 1.0}}});
  Room after(Emitters{{{4.2, 1.0}}}, 8);
  Room louder(Emitters{{.place_m = {4.2, 1.0}, .level_db = 12.0}}, 8);
  Listener overlapping;
  overlapping.Hear(before, 0, 30);
  overlapping.Hear(both, 30, 60);
  overlapping.Hear(after, 60, 120);
  EXPECT_EQ(overlapping.Sources().size(), 2u);
  EXPECT_EQ(overlapping.Near({1.2, 1.0})->state, SourceState::kSilent);
  Listener unlike;
  unlike.Hear(before, 0, 60);
  unlike.Hear(louder, 60, 120);
  EXPECT_EQ(unlike.Sources().size(), 2u);
  EXPECT_EQ(overlapping.Count(Kind::kMoved) + unlike.Count(Kind::kMoved), 0);
  const double quiet_db = *TotalLevel_db(unlike.Near({1.2, 1.0})->Spectrum_db());
  const double loud_db = *TotalLevel_db(unlike.Near({4.2, 1.0})->Spectrum_db());
  EXPECT_NEAR(quiet_db, 10.0 * std::log10(5e-3), 0.5);
  EXPECT_NEAR(loud_db, quiet_db + 12.0, 0.5);
}

// A sine of 94 dB SPL at 1 m, by microphones of several full scales.
TEST(RegisteredSource, SoundPressureIsOfCalibratedMicrophonesAlone) {
  const auto heard = [](ViewPoint& view_point, std::optional<double> full_scale_spl_db,
                        double level_spl_db) {
    frames::BandPowers power{};
    // The mean square of a full-scale sine is half.
    power[3] = static_cast<float>(
        0.5 * std::pow(10.0, (level_spl_db - full_scale_spl_db.value_or(100.0)) / 10.0));
    for (int scan = 0; scan < 4; ++scan) view_point.AddLevel(power, full_scale_spl_db);
  };
  RegisteredSource source;
  source.view_points.resize(3);
  heard(source.view_points[0], std::nullopt, 94.0);
  EXPECT_TRUE(TotalLevel_db(source.Spectrum_db()));
  EXPECT_FALSE(TotalLevel_db(source.SpectrumSpl_db()));

  heard(source.view_points[1], 120.0, 94.0);
  heard(source.view_points[2], 130.0, 94.0);
  heard(source.view_points[2], std::nullopt, 60.0);  // another robot, there too
  const Spectrum spl_db = source.SpectrumSpl_db();
  ASSERT_TRUE(spl_db[3]);
  EXPECT_NEAR(*spl_db[3], 94.0, 1e-4);
  EXPECT_FALSE(spl_db[2]);
  EXPECT_NEAR(*TotalLevel_db(spl_db), 94.0, 1e-4);
}

TEST(SourceRegister, TwoRobotsAtOnceOrOneAfterTheOtherFindTheSame) {
  const std::vector<Emitter> emitters = {{{0.8, 0.9}}, {{4.1, 3.0}, /*heard_share=*/0.4}};
  Room first(emitters, 1);
  Room second(emitters, 2);
  Listener after;
  after.Hear(first, 0, 40, "r1");
  after.Hear(second, 40, 80, "r2");
  Room third(emitters, 1);
  Room fourth(emitters, 2);
  Listener at_once;
  for (double t_s = 0; t_s < 40; t_s += 0.125) {
    at_once.Take(third.Hear(frames::NsFromSeconds(t_s)), "r1");
    at_once.Take(fourth.Hear(frames::NsFromSeconds(t_s) + 30'000'000), "r2");
  }
  ASSERT_EQ(after.Sources().size(), 2u);
  ASSERT_EQ(at_once.Sources().size(), 2u);
  for (const Emitter& emitter : emitters) {
    const RegisteredSource* a = after.Near(emitter.place_m);
    const RegisteredSource* b = at_once.Near(emitter.place_m);
    ASSERT_NE(a, nullptr);
    ASSERT_NE(b, nullptr);
    EXPECT_LT((a->found.position_in_map_m - b->found.position_in_map_m).norm(), 0.03);
    EXPECT_EQ(a->robots, b->robots);
    EXPECT_EQ(a->state, b->state);
  }
}

// A register that is restored goes on as the one that was saved.
TEST(SourceRegister, GoesOnFromItsState) {
  const auto on = [](frames::TimeNs t) { return t < frames::NsFromSeconds(20); };
  Room room(Emitters{{{0.8, 0.9}, 0.9, on}, {{4.1, 3.0}, 0.4}});
  Room same(Emitters{{{0.8, 0.9}, 0.9, on}, {{4.1, 3.0}, 0.4}});
  Listener undisturbed;
  Listener interrupted;
  undisturbed.Hear(room, 0, 40);
  interrupted.Hear(same, 0, 17.3);
  SourceRegister::State state = interrupted.sources().state();
  interrupted.sources() = SourceRegister(DefaultConfig());
  interrupted.sources().Restore(std::move(state));
  // The generator goes on; the scan times must meet those of the other.
  interrupted.Hear(same, 17.375, 40);
  EXPECT_EQ(interrupted.Sources(), undisturbed.Sources());
}

SoundSource Found(std::uint64_t id, double x_m, double probability, frames::TimeNs first_ns) {
  SoundSource source;
  source.id = id;
  source.position_in_map_m = {x_m, 1.0, 2.7};
  source.probability = probability;
  source.first_heard_ns = first_ns;
  source.last_heard_ns = first_ns + 1;
  return source;
}

// A robot drives past two places that have the same evidence. One is heard from everywhere, the
// other from two of its views: the odds of both in closed form.
TEST(SourceRegister, WhatIsHeardFromEveryViewIsASourceAndWhatIsHeardFromFewIsNot) {
  constexpr double kEvidence = 50.0;
  constexpr double kSourceX_m = 4.0;
  constexpr double kGhostX_m = 6.0;
  SourceRegister sources(DefaultConfig());
  const auto key_at = [](double x_m) {
    return *geometry::KeyFromPoint(Eigen::Vector3d(x_m, 1.0, 2.7), kVoxel_m);
  };
  const auto find = [&] {
    std::vector<SoundSource> found = {Found(1, kSourceX_m, 0.6, 100), Found(2, kGhostX_m, 0.6, 90)};
    for (SoundSource& source : found) source.evidence = kEvidence;
    sources.Update(found);
    return sources.Sources();
  };
  EXPECT_EQ(find()[0].found.probability, 0.6);  // by its evidence alone
  constexpr int kViews = 10;
  for (int scan = 0; scan < 8 * kViews; ++scan) {
    EvidenceScan evidence;
    evidence.stamp_ns = 200 + scan * kScan_ns;
    evidence.end_points = {{key_at(kSourceX_m), 0.4f}, {key_at(kGhostX_m), 0.4f}};
    evidence.maxima = {key_at(9.0)};
    // Every eighth scan is enough for a view; 0.1 m beside the place is near enough, 0.3 m is not.
    if (scan % 8 == 3) evidence.maxima.push_back(key_at(kSourceX_m + 0.1));
    evidence.maxima.push_back(key_at(scan < 16 ? kGhostX_m : kGhostX_m + 0.3));
    // Eight scans to a metre.
    sources.Observe({"r1", Eigen::Vector2d(0.125 * scan, 2.0), &evidence});
  }
  const auto odds = [](double heard) {
    return std::exp(-6.82) * std::pow(kEvidence, 1.37) * std::pow(heard + 1.0, 1.28);
  };
  const std::vector<RegisteredSource> judged = find();
  ASSERT_EQ(judged.size(), 2u);
  EXPECT_EQ(judged[0].found.id, 1u);
  EXPECT_NEAR(judged[0].found.probability, 1.0 - 1.0 / (1.0 + odds(kViews)), 1e-9);
  EXPECT_NEAR(judged[1].found.probability, 1.0 - 1.0 / (1.0 + odds(2)), 1e-9);
  EXPECT_GT(judged[0].found.probability, 0.75);
  EXPECT_LT(judged[1].found.probability, 0.5);
}

// Places and what a robot hears of them that stops every 1.5 m on its way along a wall at y = 4 m:
// the odds of each in closed form.
class ExplainedTest : public ::testing::Test {
 protected:
  struct Place {
    Eigen::Vector3d in_map_m;
    double evidence = 0.0;
    Eigen::Vector3f surface_normal = Eigen::Vector3f::Zero();
  };

  void Drive(const std::vector<Place>& places, const std::vector<double>& stops_x_m,
             std::optional<ArrayPlane> plane = std::nullopt, bool array_known = true) {
    std::vector<SoundSource> found;
    for (std::size_t i = 0; i < places.size(); ++i) {
      SoundSource& source =
          found.emplace_back(Found(1 + i, 0.0, 0.6, 100 - static_cast<frames::TimeNs>(i)));
      source.position_in_map_m = places[i].in_map_m;
      source.evidence = places[i].evidence;
    }
    sources_.Update(found);
    for (const double x_m : stops_x_m) {
      EvidenceScan evidence;
      evidence.stamp_ns = 200 + scans_++ * kScan_ns;
      std::vector<HeardPeak> peaks;
      for (const Place& place : places) {
        const auto key = *geometry::KeyFromPoint(place.in_map_m, kVoxel_m);
        evidence.end_points.push_back({key, 0.9f});
        evidence.maxima.push_back(key);
        peaks.push_back({place.in_map_m, {}, place.surface_normal});
      }
      SourceRegister::Observation scan{"r1", {x_m, 2.0}, &evidence, &peaks, plane};
      if (array_known) scan.array_in_map_m = {x_m, 2.0, 1.0};
      sources_.Observe(scan);
    }
    sources_.Update(found);
    probability_.resize(places.size());
    explained_by_.resize(places.size());
    for (const RegisteredSource& source : sources_.Sources()) {
      probability_[source.found.id - 1] = source.found.probability;
      explained_by_[source.found.id - 1] = source.explained_by_id;
    }
  }
  static double Probability(double evidence, double views, double direct, double mirrored) {
    const double odds = std::exp(-6.82 - 5.48 * direct - 2.02 * mirrored) *
                        std::pow(evidence, 1.37) * std::pow(views + 1.0, 1.28);
    return odds / (1.0 + odds);
  }

  SourceRegister sources_{DefaultConfig()};
  std::vector<double> probability_;          // of each place
  std::vector<std::uint64_t> explained_by_;  // ids count from 1
  int scans_ = 0;
};

TEST_F(ExplainedTest, WhatLiesBeforeAStrongerPlaceIsTheLessProbable) {
  const Place hidden{{4.0, 4.5, 1.0}, 150.0};
  const Place before{{4.0, 3.5, 1.0}, 60.0};
  const std::vector<double> stops = {1.0, 2.5, 4.0, 5.5};
  Drive({hidden, before}, stops);
  EXPECT_NEAR(probability_[0], Probability(150.0, 4.0, 0.0, 0.0), 1e-9);
  // At an angle of 0 degrees from x = 4 m, of 13 and 14 from the others.
  EXPECT_NEAR(probability_[1], Probability(60.0, 4.0, 0.25, 0.0), 1e-9);
  EXPECT_EQ(explained_by_, std::vector<std::uint64_t>({0, 0}));  // not from half of them
  // The weaker of the two, wherever it stands.
  Drive({{hidden.in_map_m, 60.0}, {before.in_map_m, 150.0}}, {});
  EXPECT_NEAR(probability_[0], Probability(60.0, 4.0, 0.25, 0.0), 1e-9);
  EXPECT_NEAR(probability_[1], Probability(150.0, 4.0, 0.0, 0.0), 1e-9);
}

TEST_F(ExplainedTest, WhoDoesNotSayWhereTheArrayIsExplainsNothing) {
  Drive({{{4.0, 4.5, 1.0}, 150.0}, {{4.0, 3.5, 1.0}, 60.0}}, {1.0, 2.5, 4.0, 5.5}, std::nullopt,
        /*array_known=*/false);
  EXPECT_NEAR(probability_[1], Probability(60.0, 4.0, 0.0, 0.0), 1e-9);
}

TEST_F(ExplainedTest, WhatTheWallMirrorsIsTheLessProbable) {
  const Place source{{9.0, 2.0, 1.0}, 150.0};
  const Place mirror{{5.0, 4.0, 1.0}, 60.0, -Eigen::Vector3f::UnitY()};
  // The wall mirrors in the middle between robot and source: exactly there from 1 m, 4 degrees
  // beside it from 2 m, and far from it from 4 and 6 m.
  const std::vector<double> stops = {1.0, 2.0, 4.0, 6.0};
  Drive({source, mirror}, stops);
  EXPECT_NEAR(probability_[0], Probability(150.0, 4.0, 0.0, 0.0), 1e-9);
  EXPECT_NEAR(probability_[1], Probability(60.0, 4.0, 0.0, 0.5), 1e-9);
  EXPECT_EQ(explained_by_, std::vector<std::uint64_t>({0, 1}));
}

// From far away three places stand in one row. The strongest explains the second, which then
// explains nothing: the third is beside the strongest, and beside the second it would not be.
TEST_F(ExplainedTest, WhatIsExplainedItselfExplainsNothing) {
  const double distance_m = 10.0;
  const auto at_deg = [&](double angle_deg) -> Eigen::Vector3d {
    const double angle_rad = geometry::RadFromDeg(angle_deg);
    return {distance_m * std::cos(angle_rad), 2.0 + distance_m * std::sin(angle_rad), 1.0};
  };
  Drive({{at_deg(0.0), 150.0}, {at_deg(8.0), 100.0}, {at_deg(16.0), 50.0}}, {0.0});
  EXPECT_NEAR(probability_[1], Probability(100.0, 1.0, 1.0, 0.0), 1e-9);
  EXPECT_NEAR(probability_[2], Probability(50.0, 1.0, 0.0, 0.0), 1e-9);
  EXPECT_EQ(explained_by_, std::vector<std::uint64_t>({0, 1, 0}));
}

TEST_F(ExplainedTest, FollowsTheNameOfTheStrongerOne) {
  const Place stronger{{4.0, 2.0, 1.0}, 150.0};
  const Place beside{{4.6, 2.0, 1.0}, 100.0};
  const Place ghost{{2.0, 2.0, 1.0}, 50.0};
  Drive({stronger, beside, ghost}, {0.0});
  EXPECT_EQ(explained_by_, std::vector<std::uint64_t>({0, 1, 1}));
  // The first two become one, which keeps the name of the one that was heard first.
  std::vector<SoundSource> found = {Found(1, 0.0, 0.6, 100), Found(3, 0.0, 0.6, 100)};
  found[0].position_in_map_m = {4.2, 2.0, 1.0};
  found[0].evidence = 150.0;
  found[1].position_in_map_m = ghost.in_map_m;
  found[1].evidence = ghost.evidence;
  sources_.Update(found);
  const std::vector<RegisteredSource> left = sources_.Sources();
  ASSERT_EQ(left.size(), 2u);
  const bool ghost_first = left[0].explained_by_id != 0;
  EXPECT_EQ(left[ghost_first ? 0 : 1].explained_by_id, left[ghost_first ? 1 : 0].found.id);
}

TEST_F(ExplainedTest, AnArrayInAPlaneHearsAboveAndBelowInOneDirection) {
  const std::vector<Place> column = {{{4.0, 4.0, 0.2}, 150.0}, {{4.0, 4.0, 2.2}, 60.0}};
  const std::vector<double> stops = {1.0, 2.5, 4.0, 5.5};
  Drive(column, stops);
  EXPECT_NEAR(probability_[1], Probability(60.0, 4.0, 0.0, 0.0), 1e-9);
  sources_ = SourceRegister(DefaultConfig());
  Drive(column, stops, ArrayPlane{{0.0, 0.0, 1.0}, Eigen::Vector3d::UnitZ()});
  const double odds = std::exp(-7.55 - 3.01) * std::pow(60.0, 1.26) * std::pow(5.0, 0.8);
  EXPECT_NEAR(probability_[1], odds / (1.0 + odds), 1e-9);
}

// One that stands still has one view, and two that drive apart have each their own.
TEST(SourceRegister, ARobotThatStandsStillHasOneView) {
  const auto key = *geometry::KeyFromPoint(Eigen::Vector3d(4.0, 1.0, 2.7), kVoxel_m);
  const auto after = [&](int scans, const std::vector<std::string>& robots) {
    SourceRegister sources(DefaultConfig());
    std::vector<SoundSource> found = {Found(1, 4.0, 0.6, 100)};
    found[0].evidence = 150.0;
    sources.Update(found);
    for (int scan = 0; scan < scans; ++scan) {
      EvidenceScan evidence{200 + scan * kScan_ns, {{key, 0.4f}}, {key}};
      sources.Observe({robots[scan % robots.size()], Eigen::Vector2d(1.0, 2.0), &evidence});
    }
    sources.Update(found);
    return sources.Sources()[0].found.probability;
  };
  EXPECT_EQ(after(1, {"r1"}), after(1000, {"r1"}));
  EXPECT_GT(after(8, {"r1", "r2"}), after(8, {"r1"}));
  EXPECT_LT(after(1000, {"r1"}), 0.75);
}

// A wall that an array 1.2 m above the floor drives past. In a horizontal plane it hears what is at
// kLower_m from everywhere at kUpper_m, too; a third place is heard by itself.
constexpr double kLower_m = 0.5;
constexpr double kUpper_m = 1.9;
constexpr double kThird_m = 2.6;

SoundSource OnWall(std::uint64_t id, double z_m, double evidence, double probability = 0.9) {
  SoundSource source = Found(id, 3.0, probability, 100);
  source.position_in_map_m = {3.0, 4.0, z_m};
  source.evidence = evidence;
  return source;
}

// With a floor that reflects everything.
frames::EchoRipple FloorRipple(const Eigen::Vector3d& array, const Eigen::Vector3d& source) {
  const double across_m = (source - array).head<2>().norm();
  const double detour_m =
      std::hypot(across_m, source.z() + array.z()) - std::hypot(across_m, source.z() - array.z());
  frames::EchoRipple ripple{40.0 / 343.0, 3, {}};
  for (int bin = 3; bin <= 50; ++bin) {
    const double waves = bin * ripple.waves_per_m * detour_m;
    ripple.values.push_back(
        static_cast<std::int8_t>(std::lround(30.0 * std::cos(2.0 * geometry::kPi * waves))));
  }
  return ripple;
}

class WallDrive {
 public:
  explicit WallDrive(std::vector<SoundSource> found) : found_(std::move(found)) {
    register_.Update(found_);
  }

  // All places are seen; those at these heights are heard, with the echo of a source at
  // `source_m`.
  void Drive(int scans, std::optional<ArrayPlane> plane, const std::vector<double>& heard_m,
             double array_m = 1.2, std::optional<double> source_m = std::nullopt,
             bool array_known = false) {
    for (int scan = 0; scan < scans; ++scan) {
      EvidenceScan evidence;
      evidence.stamp_ns = 200 + scans_ * kScan_ns;
      for (const double z_m : {kLower_m, kUpper_m, kThird_m}) {
        const auto key = *geometry::KeyFromPoint(Eigen::Vector3d(3.0, 4.0, z_m), kVoxel_m);
        const bool heard = std::count(heard_m.begin(), heard_m.end(), z_m) > 0;
        evidence.end_points.push_back({key, heard ? 0.9f : 0.4f});
        if (heard) evidence.maxima.push_back(key);
      }
      const Eigen::Vector2d robot(0.0625 * (scans_++ % 80), 1.0);
      if (plane) plane->origin_in_map_m << robot, array_m;
      std::vector<HeardPeak> peaks;
      if (source_m) {
        peaks.emplace_back().place_in_map_m = {3.0, 4.0, *source_m};
        peaks[0].ripple =
            FloorRipple(Eigen::Vector3d(robot.x(), robot.y(), array_m), peaks[0].place_in_map_m);
      }
      SourceRegister::Observation observed{"r1", robot, &evidence, &peaks, plane};
      if (array_known) observed.array_in_map_m = {robot.x(), robot.y(), array_m};
      register_.Observe(observed);
    }
    events_ = register_.Update(found_);
  }
  void Find(std::vector<SoundSource> found) {
    found_ = std::move(found);
    events_ = register_.Update(found_);
  }

  std::set<std::uint64_t> Reported() const {
    std::set<std::uint64_t> ids;
    for (const RegisteredSource& source : register_.Sources()) {
      if (source.found.probability >= 0.5) ids.insert(source.found.id);
    }
    return ids;
  }
  double Height_m(std::uint64_t id) const {
    for (const RegisteredSource& source : register_.Sources()) {
      if (source.found.id == id) return source.found.position_in_map_m.z();
    }
    return -1.0;
  }
  // Height of the place where this source may be instead.
  std::optional<double> Instead_m(std::uint64_t id) const {
    for (const RegisteredSource& source : register_.Sources()) {
      if (source.found.id != id || !source.mirror_in_map_m) continue;
      EXPECT_EQ(source.mirror_in_map_m->head<2>(), Eigen::Vector2d(3.0, 4.0));
      return source.mirror_in_map_m->z();
    }
    return std::nullopt;
  }
  std::size_t candidates() const { return register_.Sources().size(); }
  const std::vector<SourceEvent>& events() const { return events_; }  // of the last update
  SourceRegister& sources() { return register_; }

 private:
  std::vector<SoundSource> found_;
  SourceRegister register_{DefaultConfig()};
  std::vector<SourceEvent> events_;
  int scans_ = 0;
};

using Ids = std::set<std::uint64_t>;

TEST(SourceRegister, OfTwoMirroredPlacesTheStrongerIsTheSourceAndMayBeAtTheOther) {
  const auto drive = [](std::optional<ArrayPlane> plane, double lower, double upper) {
    WallDrive drive(
        {OnWall(1, kLower_m, lower), OnWall(2, kUpper_m, upper), OnWall(3, kThird_m, 300.0)});
    drive.Drive(80, plane, {kLower_m, kUpper_m, kThird_m});
    EXPECT_EQ(drive.candidates(), 3u);
    EXPECT_EQ(drive.Instead_m(3), std::nullopt);
    return drive;
  };
  const WallDrive lower = drive(ArrayPlane(), 400.0, 100.0);
  EXPECT_EQ(lower.Reported(), Ids({1, 3}));
  EXPECT_EQ(lower.Instead_m(1), kUpper_m);
  EXPECT_EQ(lower.Instead_m(2), std::nullopt);
  const WallDrive upper = drive(ArrayPlane(), 100.0, 400.0);
  EXPECT_EQ(upper.Reported(), Ids({2, 3}));
  EXPECT_EQ(upper.Instead_m(2), kLower_m);
  EXPECT_EQ(upper.Instead_m(1), std::nullopt);
  ArrayPlane upright;  // mirrors elsewhere
  upright.normal_in_map = Eigen::Vector3d::UnitX();
  for (const std::optional<ArrayPlane>& plane : {std::optional<ArrayPlane>(), {upright}}) {
    const WallDrive both = drive(plane, 400.0, 100.0);
    EXPECT_EQ(both.Reported(), Ids({1, 2, 3}));
    EXPECT_EQ(both.Instead_m(1), std::nullopt);
    EXPECT_EQ(both.Instead_m(2), std::nullopt);
  }
}

TEST(SourceRegister, OfTwoMirroredPlacesTheEchoOfTheFloorTellsTheSource) {
  for (const double source_m : {kLower_m, kUpper_m}) {
    const bool low = source_m == kLower_m;
    WallDrive drive({OnWall(1, kLower_m, low ? 100.0 : 400.0),
                     OnWall(2, kUpper_m, low ? 400.0 : 100.0), OnWall(3, kThird_m, 300.0)});
    drive.Drive(12, ArrayPlane(), {kLower_m, kUpper_m, kThird_m}, 1.2, source_m);
    drive.Drive(80, ArrayPlane(), {kLower_m, kUpper_m, kThird_m}, 1.2, source_m);
    const std::uint64_t source = low ? 1 : 2, image = low ? 2 : 1;
    EXPECT_EQ(drive.Reported(), Ids({source, 3}));
    EXPECT_EQ(drive.Instead_m(source), std::nullopt);
    EXPECT_EQ(drive.Height_m(source), source_m);
    // It is no stronger one's ghost: the image explains nothing.
    for (const RegisteredSource& found : drive.sources().Sources()) {
      EXPECT_NE(found.explained_by_id, image);
    }
  }
}

// The LIDAR hardly saw the foot of the wall, so that little was heard there: the image was heard by
// the same sound.
TEST(SourceRegister, WhatWasHeardAtTheImageWasHeardFromTheSource) {
  const auto drive = [](const std::vector<SoundSource>& found) {
    WallDrive drive(found);
    drive.Drive(40, ArrayPlane(), {kLower_m, kUpper_m}, 1.2, kLower_m, /*array_known=*/true);
    return drive;
  };
  const SoundSource faint = OnWall(1, kLower_m, 10.0);
  EXPECT_EQ(drive({faint}).Reported(), Ids());
  // Its own echo counts: by the image's it would be improbable.
  EXPECT_EQ(drive({faint, OnWall(2, kUpper_m, 30.0)}).Reported(), Ids({1}));
}

// A machine before a wall, and on the wall, twice as far away, what is heard in the mirrored
// direction. Its own image would be below the floor.
TEST(SourceRegister, TheEchoOfTheFloorTellsWhatStandsNearerThanItsImage) {
  for (const bool with_echo : {true, false}) {
    SourceRegister sources(DefaultConfig());
    std::vector<SoundSource> found = {OnWall(1, 0.5, 150.0), OnWall(2, 2.6, 400.0)};
    found[0].position_in_map_m.y() = 2.0;
    sources.Update(found);
    const auto key_of = [](const SoundSource& source) {
      return *geometry::KeyFromPoint(source.position_in_map_m, kVoxel_m);
    };
    for (int scan = 0; scan < 80; ++scan) {
      const Eigen::Vector3d array(2.9 + 0.0025 * scan, 0.0, 1.2);
      EvidenceScan evidence{200 + scan * kScan_ns, {}, {key_of(found[0]), key_of(found[1])}};
      for (const SoundSource& source : found) evidence.end_points.push_back({key_of(source), 0.9f});
      std::vector<HeardPeak> peaks(1);
      peaks[0].place_in_map_m = found[0].position_in_map_m;
      if (with_echo) peaks[0].ripple = FloorRipple(array, found[0].position_in_map_m);
      sources.Observe({"r1", array.head<2>(), &evidence, &peaks,
                       ArrayPlane{array, Eigen::Vector3d::UnitZ()}, std::nullopt, array});
    }
    sources.Update(found);
    const std::vector<RegisteredSource> told = sources.Sources();
    ASSERT_EQ(told.size(), 2u);
    EXPECT_EQ(told[0].found.id, with_echo ? 1u : 2u);
    EXPECT_GE(told[0].found.probability, with_echo ? 0.5 : 0.4);  // by one view
    EXPECT_EQ(told[0].explained_by_id, 0u);
    EXPECT_LE(told[1].found.probability, 0.3);
  }
}

// Nothing was found where the sound comes from: the LIDAR does not see the foot of the wall, say.
TEST(SourceRegister, APlaceWhoseImageFitsTheEchoIsReportedThere) {
  WallDrive drive({OnWall(2, kUpper_m, 400.0)});
  drive.Drive(400, ArrayPlane(), {kUpper_m}, 1.2, kLower_m);
  EXPECT_EQ(drive.Reported(), Ids({2}));
  EXPECT_NEAR(drive.Height_m(2), kLower_m, 1e-9);
  {
    // Found there after all: it is the source, and the place is its image.
    WallDrive both = drive;
    both.Find({OnWall(1, kLower_m, 100.0), OnWall(2, kUpper_m, 400.0)});
    both.Drive(80, ArrayPlane(), {kLower_m, kUpper_m}, 1.2, kLower_m);
    EXPECT_EQ(both.Reported(), Ids({1}));
    EXPECT_NEAR(both.Height_m(1), kLower_m, 1e-9);
  }
  {
    WallDrive in_space = drive;  // knows better
    in_space.Drive(401, std::nullopt, {kUpper_m});
    EXPECT_EQ(in_space.Height_m(2), kUpper_m);
  }
  WallDrive above({OnWall(2, kUpper_m, 400.0)});
  above.Drive(80, ArrayPlane(), {kUpper_m}, 1.2, kUpper_m);
  EXPECT_EQ(above.Height_m(2), kUpper_m);
}

// What was ambiguous, until something tells the two places apart.
TEST(SourceRegister, AnAmbiguityGoesWhenThePlacesAreToldApart) {
  const SoundSource lower = OnWall(1, kLower_m, 400.0);
  const SoundSource upper = OnWall(2, kUpper_m, 100.0, 0.4);
  WallDrive ambiguous({lower, upper});
  ambiguous.Drive(80, ArrayPlane(), {kLower_m, kUpper_m});
  ASSERT_EQ(ambiguous.Instead_m(1), kUpper_m);
  {
    WallDrive in_space = ambiguous;
    in_space.Drive(79, std::nullopt, {kLower_m});
    EXPECT_EQ(in_space.Instead_m(1), kUpper_m);
    in_space.Drive(2, std::nullopt, {kLower_m});
    EXPECT_EQ(in_space.Instead_m(1), std::nullopt);
    EXPECT_EQ(in_space.Reported(), Ids({1}));
  }
  {
    // From another height the image is elsewhere.
    WallDrive higher = ambiguous;
    higher.Drive(81, ArrayPlane(), {kLower_m}, /*array_m=*/1.8);
    EXPECT_EQ(higher.Instead_m(1), std::nullopt);
    EXPECT_EQ(higher.Reported(), Ids({1}));
  }
  {
    WallDrive both = ambiguous;  // are sources
    both.Drive(81, std::nullopt, {kLower_m, kUpper_m});
    EXPECT_EQ(both.Instead_m(1), std::nullopt);
    EXPECT_EQ(both.Reported(), Ids({1, 2}));
  }
  {
    WallDrive vanished = ambiguous;
    vanished.Find({lower});
    EXPECT_EQ(vanished.candidates(), 1u);
    EXPECT_EQ(vanished.Instead_m(1), std::nullopt);
  }
  {
    // The array in space came first.
    WallDrive known({lower, upper});
    known.Drive(81, std::nullopt, {kLower_m});
    known.Drive(80, ArrayPlane(), {kLower_m, kUpper_m});
    EXPECT_EQ(known.Instead_m(1), std::nullopt);
    EXPECT_EQ(known.Reported(), Ids({1}));
  }
}

TEST(SourceRegister, AnAmbiguityOutlivesSilenceAndRestarts) {
  const SoundSource lower = OnWall(1, kLower_m, 400.0);
  WallDrive drive({lower, OnWall(2, kUpper_m, 100.0, 0.4)});
  for (int i = 0; i < 4; ++i) drive.Drive(80, ArrayPlane(), {kLower_m, kUpper_m});
  drive.Drive(240, ArrayPlane(), {});
  ASSERT_EQ(drive.events().size(), 1u);
  EXPECT_EQ(drive.events()[0].kind, Kind::kFellSilent);
  ASSERT_TRUE(drive.events()[0].source.mirror_in_map_m);
  EXPECT_EQ(drive.events()[0].source.mirror_in_map_m->z(), kUpper_m);
  drive.Find({});  // the voxels have been unlearnt
  EXPECT_EQ(drive.Reported(), Ids({1}));
  EXPECT_EQ(drive.Instead_m(1), kUpper_m);

  SourceRegister restored(DefaultConfig());
  restored.Restore(drive.sources().state());
  EXPECT_EQ(restored.Sources(), drive.sources().Sources());

  // It sounds again, and this time the other place is not heard.
  drive.Find({lower});
  drive.Drive(80, ArrayPlane(), {kLower_m});
  drive.Find({lower});
  EXPECT_EQ(drive.Reported(), Ids({1}));
  EXPECT_EQ(drive.Instead_m(1), std::nullopt);
  EXPECT_EQ(drive.candidates(), 1u);
}

// One was heard first and is silent, what sounds now is heard where its image was.
TEST(SourceRegister, WhatIsReportedItselfIsNotToldAsAnImage) {
  const SoundSource lower = OnWall(1, kLower_m, 400.0);
  WallDrive drive({lower, OnWall(2, kUpper_m, 100.0, 0.4)});
  for (int i = 0; i < 4; ++i) drive.Drive(80, ArrayPlane(), {kLower_m, kUpper_m});
  drive.Drive(240, ArrayPlane(), {});
  drive.Find({lower, OnWall(2, kUpper_m, 1000.0)});
  drive.Drive(80, ArrayPlane(), {kUpper_m});
  EXPECT_EQ(drive.Reported(), Ids({1, 2}));
  EXPECT_EQ(drive.Instead_m(2), std::nullopt);
}

// The image is not a second source while the source that rules it out becomes part of another one.
TEST(SourceRegister, AnImageStaysOneWhenItsSourceIsMerged) {
  const SoundSource upper = OnWall(2, kUpper_m, 100.0, 0.4);
  WallDrive drive({OnWall(1, kLower_m, 400.0), upper});
  drive.Drive(80, ArrayPlane(), {kLower_m, kUpper_m});
  SoundSource beside = OnWall(5, kLower_m - 0.3, 500.0);
  beside.first_heard_ns = 50;  // so that its name stays
  drive.Find({OnWall(1, kLower_m, 400.0), upper, beside});
  drive.Find({upper, beside});
  EXPECT_EQ(drive.Reported(), Ids({5}));
  EXPECT_EQ(drive.candidates(), 2u);
}

// A share of the views that stays the same does not become certainty.
TEST(SourceRegister, AGhostDoesNotBecomeSureWithTime) {
  const auto key = *geometry::KeyFromPoint(Eigen::Vector3d(4.0, 1.0, 2.7), kVoxel_m);
  const auto elsewhere = *geometry::KeyFromPoint(Eigen::Vector3d(9.0, 1.0, 2.7), kVoxel_m);
  SourceRegister sources(DefaultConfig());
  std::vector<SoundSource> found = {Found(1, 4.0, 0.6, 100)};
  for (int view = 0; view < 3000; ++view) {
    // What a place can gather that a twentieth of the scans support, against a background of 2 %.
    found[0].evidence = 1.0 + 0.15 * view;
    EvidenceScan evidence{200 + view * kScan_ns, {{key, 0.4f}}, {view % 20 == 0 ? key : elsewhere}};
    sources.Observe({"r1", Eigen::Vector2d(view % 2 == 0 ? 1.0 : 3.0, 2.0), &evidence});
    sources.Update(found);
  }
  EXPECT_LT(sources.Sources()[0].found.probability, 0.1);
}

TEST(SourceRegister, TwoThatBecomeOneKeepTheOlderNameAndASplitGivesANewOne) {
  SourceRegister sources(DefaultConfig());
  EXPECT_EQ(sources.Update({Found(1, 1.0, 0.9, 100), Found(2, 1.6, 0.95, 50)}).size(), 2u);
  // Only one is found any more, nearer to the younger.
  auto events = sources.Update({Found(9, 1.2, 0.95, 100)});
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, Kind::kMerged);
  EXPECT_EQ(events[0].source.found.id, 1u);
  EXPECT_EQ(events[0].other_id, 2u);
  ASSERT_EQ(sources.Sources().size(), 1u);
  EXPECT_EQ(sources.Sources()[0].found.id, 2u);
  // A second one beside it: the nearer keeps the name, the other is new, though its voxel was
  // known.
  events = sources.Update({Found(2, 1.7, 0.9, 50), Found(8, 1.15, 0.9, 50)});
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, Kind::kAppeared);
  EXPECT_NE(events[0].source.found.id, 2u);
  EXPECT_NEAR(events[0].source.found.position_in_map_m.x(), 1.7, 1e-12);
}

TEST(SourceRegister, WhatWasNeverSureIsForgotten) {
  SourceRegister sources(DefaultConfig());
  EXPECT_TRUE(sources.Update({Found(1, 1.0, 0.3, 100)}).empty());
  EXPECT_EQ(sources.Sources().size(), 1u);
  EXPECT_TRUE(sources.Update({}).empty());
  EXPECT_TRUE(sources.Sources().empty());
  EXPECT_EQ(sources.Update({Found(1, 1.0, 0.6, 100)}).size(), 1u);
  const auto events = sources.Update({});
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, Kind::kVanished);
}

}  // namespace
}  // namespace soundmap::sound_map
