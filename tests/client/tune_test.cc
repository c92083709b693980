#include "cli/tune.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

namespace soundmap::cli {
namespace {

TEST(ParseVariation, TakesNumbersBooleansAndWords) {
  const auto variation = ParseVariation("default.ray_casting.shared_voxel=once,1.5,true,-2e3");
  ASSERT_TRUE(variation.ok()) << variation.status();
  EXPECT_EQ(variation->profile, "default");
  EXPECT_EQ(variation->parameter, "ray_casting.shared_voxel");
  EXPECT_EQ(variation->values, (std::vector<std::string>{"'once'", "1.5", "true", "-2e3"}));
}

TEST(ParseVariation, RefusesOtherForms) {
  for (const char* text :
       {"", "=", "default", "default.acoustics=1", "acoustics.t1=", "default.acoustics.t1",
        "default.acoustics.t1=", "default.acoustics.t1=1,,2", "default.acoustics.t1='1'",
        "default.acoustics.t1=1\nprofile=2", "default.acoustics.t 1=1", "default..=1\n"}) {
    EXPECT_EQ(ParseVariation(text).status().code(), absl::StatusCode::kInvalidArgument) << text;
  }
}

TEST(ParameterGrid, IsEveryCombinationOfAProfile) {
  const auto grid = ParameterGrid(
      {"default", "paper"}, {{"paper", "a.b", {"1", "2"}}, {"paper", "a.c", {"3", "4", "5"}}});
  ASSERT_TRUE(grid.ok()) << grid.status();
  ASSERT_EQ(grid->size(), 7u);
  EXPECT_EQ(ToToml((*grid)[0]), "profile = 'default'\n");
  EXPECT_EQ(ToToml((*grid)[1]), "profile = 'paper'\na.b = 1\na.c = 3\n");
  EXPECT_EQ(Describe((*grid)[6]), "paper, a.b = 2, a.c = 5");
}

TEST(ParameterGrid, RefusesWhatWouldNotBeTriedAndTooMany) {
  EXPECT_FALSE(ParameterGrid({"default"}, {{"paper", "a.b", {"1"}}}).ok());
  const std::vector<std::string> values(40, "1");
  EXPECT_FALSE(
      ParameterGrid({"default"}, {{"default", "a.b", values}, {"default", "a.c", values}}).ok());
}

TEST(Sum, IsTheScoreOfAllDetections) {
  // Errors 0.1, 0.3 and 0.5 m.
  const SourceScore sum = Sum(
      {{.true_count = 3, .detected = 2, .false_count = 1, .error_mean_m = 0.2, .error_std_m = 0.1},
       {.true_count = 1,
        .detected = 1,
        .out_of_view = 2,
        .double_count = 4,
        .error_mean_m = 0.5,
        .error_std_m = 0.0},
       {.true_count = 1}});
  EXPECT_EQ(sum.true_count, 5);
  EXPECT_EQ(sum.detected, 3);
  EXPECT_EQ(sum.out_of_view, 2);
  EXPECT_EQ(sum.false_count, 1);
  EXPECT_EQ(sum.double_count, 4);
  EXPECT_NEAR(*sum.error_mean_m, 0.3, 1e-12);
  EXPECT_NEAR(*sum.error_std_m, std::sqrt(0.08 / 3.0), 1e-12);
  EXPECT_FALSE(Sum({}).error_mean_m.has_value());
}

TEST(JudgeCandidates, TheNearestIsTheSourceAndOutOfViewCountsNowhere) {
  const auto source = [](double x, double probability) {
    return SoundSource{.position_in_map_m = {x, 0, 0}, .probability = probability};
  };
  const std::vector<TrueSource> truth{{.position_in_map_m = {0, 0, 0}},
                                      {.position_in_map_m = {10, 0, 0}}};
  const auto candidates = JudgeCandidates(
      {source(0.5, 0.9), source(0.1, 0.3), source(10.0, 0.8), source(5, 0.4), source(0, 0.1)},
      truth, {true, false});
  std::vector<std::pair<double, bool>> pairs;
  for (const Candidate& candidate : candidates) {
    pairs.emplace_back(candidate.probability, candidate.is_source);
  }
  EXPECT_THAT(pairs, ::testing::UnorderedElementsAre(std::pair(0.9, false), std::pair(0.3, true),
                                                     std::pair(0.4, false)));
}

// Ten candidates of one probability, of which so many are sources.
std::vector<Candidate> Ten(double probability, int sources) {
  std::vector<Candidate> candidates;
  for (int i = 0; i < 10; ++i) candidates.push_back({probability, i < sources});
  return candidates;
}

TEST(Calibrate, ByClosedForm) {
  std::vector<Candidate> candidates;
  for (const auto& bin : {Ten(0.5, 5), Ten(0.9, 7)}) {
    candidates.insert(candidates.end(), bin.begin(), bin.end());
  }
  const Calibration calibration = Calibrate(candidates);
  EXPECT_EQ(calibration.candidates, 20);
  // Bins of two, all of one probability; in order of arrival: five bins of 0.5 hold 2, 2, 1, 0, 0
  // sources and five of 0.9 hold 2, 2, 2, 1, 0.
  EXPECT_NEAR(*calibration.expected_error,
              0.1 * (0.5 + 0.5 + 0.0 + 0.5 + 0.5 + 3 * 0.1 + 0.4 + 0.9), 1e-12);
  EXPECT_NEAR(*calibration.brier, (10 * 0.25 + 7 * 0.01 + 3 * 0.81) / 20, 1e-12);
}

TEST(Calibrate, CertaintyThatIsRightHasNoError) {
  const Calibration calibration = Calibrate({{1.0, true}, {1.0, true}, {0.0, false}});
  EXPECT_EQ(*calibration.expected_error, 0.0);
  EXPECT_EQ(*calibration.brier, 0.0);
  EXPECT_FALSE(Calibrate({}).expected_error.has_value());
}

TEST(PlotScores, NamesWhatItCannotWrite) {
  EXPECT_FALSE(PlotScores({}, ::testing::TempDir() + "/plot.pdf").ok());
  EXPECT_FALSE(PlotScores({}, "it's.svg").ok());
}

TEST(PlotScores, DrawsSetsWithAndWithoutCandidates) {
  if (std::system("command -v gnuplot >/dev/null") != 0) GTEST_SKIP() << "there is no gnuplot";
  const std::string path = ::testing::TempDir() + "/plot.svg";
  SetScore empty{.set = {"paper", {}}};
  SetScore full{.set = {"default", {{"a.b_c", "1"}}},
                .sources = {.true_count = 2, .detected = 1, .error_mean_m = 0.1},
                .calibration = Calibrate(Ten(0.5, 5))};
  ASSERT_TRUE(PlotScores({empty, full}, path).ok());
  std::ifstream file(path);
  const std::string svg(std::istreambuf_iterator<char>(file), {});
  EXPECT_NE(svg.find("2: default, a.b_c = 1"), std::string::npos);
}

}  // namespace
}  // namespace soundmap::cli
