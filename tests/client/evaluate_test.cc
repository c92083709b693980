#include "cli/evaluate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "cli/pose_track.h"

namespace soundmap::cli {
namespace {

constexpr std::int64_t kS = 1'000'000'000;
constexpr double kPi = std::numbers::pi;

SoundSource Reported(double x, double y, double z, double probability = 0.9) {
  return {.position_in_map_m = {x, y, z}, .probability = probability};
}

TrueSource True(double x, double y, double z) { return {.position_in_map_m = {x, y, z}}; }

TEST(ScoreSources, CountsDetectionsDoublesAndFalse) {
  const std::vector<TrueSource> truth = {True(0, 0, 2), True(3, 0, 2), True(6, 0, 2)};
  const auto score = ScoreSources(
      {
          Reported(0.3, 0, 2),    // double: 0.3 m, a nearer one follows
          Reported(0, 0.1, 2),    // detection of the first, 0.1 m
          Reported(3, 0, 1.5),    // detection of the second, 0.5 m
          Reported(9, 0, 2),      // false
          Reported(6, 0, 3.01),   // false: 1.01 m
          Reported(6, 0, 2, 0.4)  // not sure enough to be reported
      },
      truth, {});
  EXPECT_EQ(score.true_count, 3);
  EXPECT_EQ(score.detected, 2);
  EXPECT_EQ(score.double_count, 1);
  EXPECT_EQ(score.false_count, 2);
  EXPECT_EQ(score.out_of_view, 0);
  EXPECT_NEAR(*score.error_mean_m, 0.3, 1e-12);  // (0.1 + 0.5) / 2
  EXPECT_NEAR(*score.error_std_m, 0.2, 1e-12);   // of the population
}

TEST(ScoreSources, OneMetreAndOneHalfAreIncluded) {
  const auto score = ScoreSources({Reported(1, 0, 0, 0.5)}, {True(0, 0, 0)}, {});
  EXPECT_EQ(score.detected, 1);
  EXPECT_EQ(score.false_count, 0);
  EXPECT_NEAR(*score.error_std_m, 0.0, 1e-12);
}

TEST(ScoreSources, WhatIsOutOfViewIsNeitherMissedNorFalse) {
  const std::vector<TrueSource> truth = {True(0, 0, 2), True(3, 0, 2), True(6, 0, 2)};
  const auto score = ScoreSources({Reported(0, 0, 2), Reported(0.5, 0, 2), Reported(3, 0.2, 2)},
                                  truth, {false, true, false});
  EXPECT_EQ(score.true_count, 1);
  EXPECT_EQ(score.detected, 1);
  EXPECT_EQ(score.out_of_view, 2);
  EXPECT_EQ(score.false_count, 0);
  EXPECT_EQ(score.double_count, 0);
  EXPECT_NEAR(*score.error_mean_m, 0.2, 1e-12);
}

TEST(ScoreSources, AReportGoesToTheNearestOfTwo) {
  // 0.9 m and 0.6 m away: the second has it, the first is missed.
  const auto score = ScoreSources({Reported(0.9, 0, 0)}, {True(0, 0, 0), True(1.5, 0, 0)}, {});
  EXPECT_EQ(score.detected, 1);
  EXPECT_NEAR(*score.error_mean_m, 0.6, 1e-12);
}

TEST(ScoreSources, NothingReportedNothingTrue) {
  const auto nothing = ScoreSources({}, {True(0, 0, 0)}, {});
  EXPECT_EQ(nothing.true_count, 1);
  EXPECT_EQ(nothing.detected, 0);
  EXPECT_FALSE(nothing.error_mean_m.has_value());
  EXPECT_EQ(ToJson({.sources = nothing}),
            R"({"sources":{"true":1,"detected":0,"out_of_view":0,"error_mean_m":null,)"
            R"("error_std_m":null,"false":0,"double":0}})");
  EXPECT_EQ(ScoreSources({Reported(0, 0, 0)}, {}, {}).false_count, 1);
  const double nan = std::nan("");
  EXPECT_EQ(ScoreSources({Reported(nan, 0, 0)}, {True(0, 0, 0)}, {}).false_count, 1);
  EXPECT_EQ(ScoreSources({Reported(0, 0, 0, nan)}, {True(0, 0, 0)}, {}).detected, 0);
}

TEST(PoseTrack, TurnsTheShortWay) {
  const PoseTrack track({{0, {0, 0, 3.0}}, {kS, {1, 2, -3.0}}});
  const auto pose = track.At(kS / 4);
  ASSERT_TRUE(pose.has_value());
  EXPECT_NEAR(pose->x_m, 0.25, 1e-12);
  EXPECT_NEAR(pose->y_m, 0.5, 1e-12);
  EXPECT_NEAR(pose->yaw_rad, 3.0 + 0.25 * (2 * kPi - 6.0), 1e-12);
  EXPECT_NEAR(track.At(3 * kS / 4)->yaw_rad, -3.0 - 0.25 * (2 * kPi - 6.0), 1e-12);
}

TEST(PoseTrack, KnowsNothingOutsideAndAcrossGaps) {
  const PoseTrack track({{10 * kS, {1, 0, 0}}, {0, {0, 0, 0}}});  // in any order
  EXPECT_TRUE(track.At(5 * kS).has_value());
  EXPECT_FALSE(track.At(5 * kS, 9 * kS).has_value());
  EXPECT_TRUE(track.At(10 * kS, 9 * kS).has_value());  // exactly there
  EXPECT_FALSE(track.At(-2'000'000).has_value());
  EXPECT_TRUE(track.At(-1'000'000).has_value());
  EXPECT_FALSE(track.At(10 * kS + 2'000'000).has_value());
  EXPECT_FALSE(PoseTrack({}).At(0).has_value());
}

TEST(WrapAngle, IsInHalfOpenInterval) {
  EXPECT_EQ(WrapAngle(kPi), kPi);
  EXPECT_EQ(WrapAngle(-kPi), kPi);
  EXPECT_NEAR(WrapAngle(7.0), 7.0 - 2 * kPi, 1e-15);
}

PoseEstimate Estimate(double time_s, double x, double y, double yaw,
                      LocalizationState state = LocalizationState::kTracking) {
  return {.time_ns = std::llround(time_s * 1e9), .map_from_base = {x, y, yaw}, .state = state};
}

// Truth: along x at 1 m/s, yaw constant.
std::vector<StampedPose> StraightTruth() {
  return {{0, {0, 0, 0.1}}, {kS, {1, 0, 0.1}}, {2 * kS, {2, 0, 0.1}}};
}

TEST(ScoreAgainstDrive, InterpolatesTheTruthAtTheEstimates) {
  const auto score = ScoreAgainstDrive(
      {Estimate(0.5, 0.5, 0.1, 0.1), Estimate(1.25, 1.25, -0.3, 0.1 + kPi / 180)}, StraightTruth());
  ASSERT_TRUE(score.ok()) << score.status();
  EXPECT_NEAR(score->error_mean_m, 0.2, 1e-12);
  EXPECT_NEAR(score->error_p95_m, 0.1 + 0.95 * 0.2, 1e-12);
  EXPECT_NEAR(score->yaw_error_mean_deg, 0.5, 1e-9);
  EXPECT_EQ(score->lost_fraction, 0.0);
}

TEST(ScoreAgainstDrive, LostEstimatesClaimNoPose) {
  const auto score =
      ScoreAgainstDrive({Estimate(0, 0, 0.1, 0.1), Estimate(1, 50, 50, 3, LocalizationState::kLost),
                         Estimate(1.5, 1.5, 0.1, 0.1, LocalizationState::kUncertain),
                         Estimate(7, 0, 0, 0)},  // after the truth's end
                        StraightTruth());
  ASSERT_TRUE(score.ok()) << score.status();
  EXPECT_NEAR(score->error_mean_m, 0.1, 1e-12);
  EXPECT_EQ(score->lost_fraction, 0.25);
}

TEST(ScoreAgainstDrive, NinetyFifthPercentile) {
  std::vector<PoseEstimate> path;
  std::vector<StampedPose> truth;
  for (int i = 0; i <= 100; ++i) {
    path.push_back(Estimate(0.1 * i, 0.01 * ((37 * i) % 101), 0, 0));  // each of 0 .. 1.00 m once
    truth.push_back({path.back().time_ns, {0, 0, 0}});
  }
  const auto score = ScoreAgainstDrive(path, truth);
  ASSERT_TRUE(score.ok());
  EXPECT_NEAR(score->error_p95_m, 0.95, 1e-12);
  EXPECT_NEAR(score->error_mean_m, 0.5, 1e-12);
}

TEST(ScoreAgainstDrive, RefusesWhatCannotBeCompared) {
  EXPECT_FALSE(ScoreAgainstDrive({}, StraightTruth()).ok());
  EXPECT_FALSE(ScoreAgainstDrive({Estimate(9, 0, 0, 0)}, StraightTruth()).ok());
  EXPECT_FALSE(ScoreAgainstDrive({Estimate(1, std::nan(""), 0, 0)}, StraightTruth()).ok());
  EXPECT_FALSE(
      ScoreAgainstDrive({Estimate(1, 0, 0, 0), Estimate(0, 0, 0, 0)}, StraightTruth()).ok());
  // The truth has a hole of 10 s.
  EXPECT_FALSE(ScoreAgainstDrive({Estimate(5, 0, 0, 0)}, {{0, {}}, {10 * kS, {}}}).ok());
}

TEST(ScoreAgainstSurvey, InterpolatesTheEstimatesAtTheSurvey) {
  // Surveyed poses 5 s apart; the estimates go round a curve between them that the survey does not
  // know.
  const std::vector<StampedPose> survey = {{kS / 2, {0.5, 0, 0}}, {11 * kS / 2, {5.5, 0, 0}}};
  const auto score =
      ScoreAgainstSurvey({Estimate(0, 0, 0.1, 0), Estimate(1, 1, 0.1, 0), Estimate(3, 3, 4, 1),
                          Estimate(5, 5, 0.3, 0), Estimate(6, 6, 0.3, 0)},
                         survey);
  ASSERT_TRUE(score.ok()) << score.status();
  EXPECT_NEAR(score->error_mean_m, 0.2, 1e-12);
}

TEST(ScoreAgainstSurvey, SkipsSurveyedPosesWhereTheRobotIsLost) {
  const auto score =
      ScoreAgainstSurvey({Estimate(0, 0, 0.1, 0), Estimate(1, 1, 0.1, 0),
                          Estimate(2, 9, 9, 0, LocalizationState::kLost), Estimate(3, 3, 0.1, 0)},
                         {{kS / 2, {0.5, 0, 0}},
                          {3 * kS / 2, {1.5, 0, 0}},
                          {2 * kS, {2, 0, 0}},
                          {5 * kS / 2, {2.5, 0, 0}},
                          {3 * kS, {3, 0, 0}}});
  ASSERT_TRUE(score.ok()) << score.status();
  EXPECT_NEAR(score->error_mean_m, 0.1, 1e-12);
  EXPECT_EQ(score->lost_fraction, 0.25);
}

// A path on a circle of 3 m at 0.5 rad/s, and by closed form its pose as seen from itself `dt`
// earlier: the chord, turned by half the angle.
std::vector<PoseEstimate> Circle(double x0, double y0, double turn_rad) {
  std::vector<PoseEstimate> path;
  for (int i = 0; i <= 200; ++i) {
    const double angle = 0.05 * i;
    path.push_back(Estimate(0.1 * i, x0 + 3 * std::cos(angle + turn_rad),
                            y0 + 3 * std::sin(angle + turn_rad), angle + turn_rad + kPi / 2));
  }
  return path;
}

Relation OnCircle(double t1, double t2) {
  const double angle = 0.5 * (t2 - t1), chord = 2 * 3 * std::sin(angle / 2);
  return {.time1_ns = std::llround(t1 * 1e9),
          .time2_ns = std::llround(t2 * 1e9),
          .translation_m = {chord * std::cos(angle / 2), chord * std::sin(angle / 2), 0},
          .yaw_rad = angle};
}

TEST(ScoreRelations, APerfectPathHasNoError) {
  const auto score = ScoreRelations(Circle(1, 2, 0.3), {OnCircle(0, 1), OnCircle(2, 12.3)});
  ASSERT_TRUE(score.ok()) << score.status();
  EXPECT_NEAR(score->trans_mean_m, 0, 1e-9);
  EXPECT_NEAR(score->trans_std_m, 0, 1e-9);
  EXPECT_NEAR(score->rot_mean_deg, 0, 1e-5);
  EXPECT_EQ(score->outside_path, 0);
}

TEST(ScoreRelations, DoesNotDependOnTheMapFrame) {
  std::vector<Relation> relations = {OnCircle(0, 1), OnCircle(2, 12.3), OnCircle(3, 4)};
  relations[0].translation_m.x += 0.2;
  relations[1].yaw_rad += 0.1;
  const auto a = ScoreRelations(Circle(0, 0, 0), relations);
  const auto b = ScoreRelations(Circle(-40, 25, 2.1), relations);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_NEAR(a->trans_mean_m, b->trans_mean_m, 1e-9);
  EXPECT_NEAR(a->rot_mean_deg, b->rot_mean_deg, 1e-5);
}

TEST(ScoreRelations, KnownOffsets) {
  Relation a = OnCircle(1, 2), b = OnCircle(3, 5);
  a.translation_m.x += 0.3;  // 0.5 m off in all
  a.translation_m.y -= 0.4;
  a.yaw_rad += 0.02;
  b.translation_m.z += 0.1;
  b.yaw_rad -= 0.04;
  const auto score = ScoreRelations(Circle(1, 2, 0.3), {a, b});
  ASSERT_TRUE(score.ok()) << score.status();
  EXPECT_NEAR(score->trans_mean_m, 0.3, 1e-9);
  EXPECT_NEAR(score->trans_std_m, 0.2, 1e-9);
  EXPECT_NEAR(score->rot_mean_deg, 0.03 * 180 / kPi, 1e-6);
}

TEST(ScoreRelations, RollAndPitchAreRotationToo) {
  Relation r = OnCircle(1, 2);
  r.roll_rad = 0.05;
  const auto score = ScoreRelations(Circle(0, 0, 0), {r});
  ASSERT_TRUE(score.ok());
  EXPECT_NEAR(score->rot_mean_deg, 0.05 * 180 / kPi, 1e-6);
  EXPECT_NEAR(score->trans_mean_m, 0, 1e-9);
}

TEST(ScoreRelations, InterpolatesBetweenPoses) {
  const std::vector<PoseEstimate> path = {Estimate(0, 0, 0, 0), Estimate(10, 10, 0, 0)};
  Relation r{.time1_ns = 2 * kS, .time2_ns = 5 * kS, .translation_m = {3, 0, 0}};
  EXPECT_NEAR(ScoreRelations(path, {r})->trans_mean_m, 0, 1e-12);
  r.translation_m.x = 2.5;
  EXPECT_NEAR(ScoreRelations(path, {r})->trans_mean_m, 0.5, 1e-12);
}

TEST(ScoreRelations, CountsWhatThePathDoesNotReach) {
  const auto score = ScoreRelations(Circle(0, 0, 0), {OnCircle(1, 2), OnCircle(19, 21)});
  ASSERT_TRUE(score.ok());
  EXPECT_EQ(score->outside_path, 1);
  EXPECT_FALSE(ScoreRelations(Circle(0, 0, 0), {OnCircle(30, 31)}).ok());
  EXPECT_FALSE(ScoreRelations({}, {OnCircle(1, 2)}).ok());
}

TEST(SessionToEvaluate, IsTheNewestListeningOne) {
  const auto session = [](const char* id, Purpose purpose, std::int64_t time_ns) {
    return Session{.id = id, .purpose = purpose, .create_time_ns = time_ns};
  };
  EXPECT_FALSE(SessionToEvaluate({}).has_value());
  EXPECT_EQ(
      SessionToEvaluate({session("a", Purpose::kListening, 1), session("b", Purpose::kListening, 3),
                         session("c", Purpose::kListening, 2), session("d", Purpose::kMapping, 9)})
          ->id,
      "b");
  EXPECT_EQ(
      SessionToEvaluate({session("a", Purpose::kMapping, 1), session("b", Purpose::kMapping, 3)})
          ->id,
      "b");
}

TEST(EvaluationToJson, HasTheFixedForm) {
  EXPECT_EQ(ToJson(Evaluation{}), "{}");
  const Evaluation evaluation{.sources = SourceScore{6, 5, 1, 2, 3, 0.25, 0.125},
                              .pose = PoseScore{0.5, 1.5, 2.5, 0.75},
                              .relations = RelationScore{0.5, 0.25, 1.5, 7}};
  EXPECT_EQ(ToJson(evaluation),
            R"({"sources":{"true":6,"detected":5,"out_of_view":1,"error_mean_m":0.25,)"
            R"("error_std_m":0.125,"false":2,"double":3},)"
            R"("pose":{"error_mean_m":0.5,"error_p95_m":1.5,"yaw_error_mean_deg":2.5,)"
            R"("lost_fraction":0.75},)"
            R"("relations":{"trans_mean_m":0.5,"trans_std_m":0.25,"rot_mean_deg":1.5}})");
}

}  // namespace
}  // namespace soundmap::cli
