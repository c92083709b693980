#include <iostream>
#include <memory>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "cli/command_line.h"
#include "cli/drive_truth.h"
#include "cli/json_output.h"
#include "cli/progress.h"
#include "cli/table.h"
#include "cli/tune.h"
#include "cli/visibility.h"

namespace soundmap::cli {
namespace {

struct TuneArguments {
  std::vector<std::tuple<std::string, std::string, std::string>> cases;  // site, truth, drive
  std::vector<std::string> profiles{"default", "paper"};
  std::vector<std::string> variations;
  std::string plot;
  std::string format;
};

// A site that has heard a drive, and what is true of it.
struct Case {
  std::string site;
  SceneTruth scene;
  std::vector<bool> in_view;
};

absl::StatusOr<Case> ReadCase(Client& client, const std::string& site_id, const std::string& truth,
                              const std::string& recording) {
  auto scene = ReadTruthFile(truth);
  if (!scene.ok()) return scene.status();
  const auto drive = ReadDriveTruth(recording);
  if (!drive.ok()) return drive.status();
  const auto site = client.GetSite(site_id);
  if (!site.ok()) return site.status();
  auto in_view = SourcesInView(*scene, *drive, site->max_range_m, recording);
  if (!in_view.ok()) return in_view.status();
  return Case{site_id, *std::move(scene), *std::move(in_view)};
}

// The sources that each set of parameters led to, by the report of the operation.
absl::StatusOr<std::vector<std::vector<SoundSource>>> ReadTrials(const std::string& report,
                                                                 std::size_t sets) {
  const auto document = nlohmann::json::parse(report, nullptr, /*allow_exceptions=*/false);
  std::vector<std::vector<SoundSource>> trials;
  try {
    for (const auto& trial : document.at("trials")) {
      std::vector<SoundSource>& sources = trials.emplace_back();
      for (const auto& item : trial.at("sources")) {
        SoundSource& source = sources.emplace_back();
        const auto& position = item.at("position_m");
        source.position_in_map_m = {position.at(0), position.at(1), position.at(2)};
        source.probability = item.at("probability");
      }
    }
  } catch (const nlohmann::json::exception& error) {
    return absl::InternalError(
        absl::StrCat("the server's report of the trials is not understood: ", error.what()));
  }
  if (trials.size() != sets) {
    return absl::InternalError(
        absl::StrCat("the server reports ", trials.size(), " trials instead of ", sets));
  }
  return trials;
}

void PrintScores(const std::vector<SetScore>& scores) {
  using Align = Table::Align;
  Table table({{"PARAMETERS"},
               {"IN VIEW", Align::kRight},
               {"DETECTED", Align::kRight},
               {"FALSE", Align::kRight},
               {"DOUBLE", Align::kRight},
               {"ERROR [m]", Align::kRight},
               {"CANDIDATES", Align::kRight},
               {"CALIBRATION ERROR", Align::kRight},
               {"BRIER", Align::kRight}});
  const auto number = [](const std::optional<double>& value) {
    return value ? Fixed(*value, 3) : "-";
  };
  for (const SetScore& score : scores) {
    table.Add({Describe(score.set), absl::StrCat(score.sources.true_count),
               absl::StrCat(score.sources.detected), absl::StrCat(score.sources.false_count),
               absl::StrCat(score.sources.double_count), number(score.sources.error_mean_m),
               absl::StrCat(score.calibration.candidates), number(score.calibration.expected_error),
               number(score.calibration.brier)});
  }
  table.Print(std::cout);
}

absl::Status Tune(Client& client, const TuneArguments& arguments) {
  std::vector<Variation> variations;
  for (const std::string& text : arguments.variations) {
    auto variation = ParseVariation(text);
    if (!variation.ok()) return variation.status();
    variations.push_back(*std::move(variation));
  }
  const auto grid = ParameterGrid(arguments.profiles, variations);
  if (!grid.ok()) return grid.status();
  std::vector<Case> cases;
  for (const auto& [site, truth, drive] : arguments.cases) {
    auto one = ReadCase(client, site, truth, drive);
    if (!one.ok()) return one.status();
    cases.push_back(*std::move(one));
  }

  std::vector<SetScore> scores(grid->size());
  std::vector<std::vector<Candidate>> candidates(grid->size());
  std::vector<std::string> sites;
  for (const Case& one : cases) {
    TryParametersRequest request{one.site, {}, {}};
    for (const ParameterSet& set : *grid) request.parameters_toml.push_back(ToToml(set));
    Progress progress;
    const auto operation = client.TryParameters(request, progress.ForOperation());
    if (!operation.ok()) return operation.status();
    const auto trials = ReadTrials(operation->report_json, grid->size());
    if (!trials.ok()) return trials.status();
    for (std::size_t i = 0; i < trials->size(); ++i) {
      const std::vector<SoundSource>& found = (*trials)[i];
      scores[i].of_site.push_back(ScoreSources(found, one.scene.sources, one.in_view));
      for (const Candidate& candidate : JudgeCandidates(found, one.scene.sources, one.in_view)) {
        candidates[i].push_back(candidate);
      }
    }
    sites.push_back(one.site);
  }
  for (std::size_t i = 0; i < scores.size(); ++i) {
    scores[i].set = (*grid)[i];
    scores[i].sources = Sum(scores[i].of_site);
    scores[i].calibration = Calibrate(std::move(candidates[i]));
  }
  if (arguments.format == "json") {
    std::cout << ToJson(sites, scores) << '\n';
  } else {
    PrintScores(scores);
  }
  return arguments.plot.empty() ? absl::OkStatus() : PlotScores(scores, arguments.plot);
}

}  // namespace

void AddTuneCommand(CLI::App& app, CommandLine& line) {
  auto arguments = std::make_shared<TuneArguments>();
  CLI::App* command = AddCommand(
      app, "tune", "try parameters on drives that sites have heard, and compare with what is true");
  command
      ->add_option("--case", arguments->cases,
                   "a site, the true sources of its scene (NAME.truth.json) and the recording of "
                   "its drive; may be repeated")
      ->type_name("SITE TRUTH DRIVE")
      ->required();
  command->add_option("--profiles", arguments->profiles, "profiles to try")
      ->delimiter(',')
      ->check(CLI::IsMember({"default", "paper"}));
  command->add_option("--vary", arguments->variations,
                      "PROFILE.STAGE.PARAMETER=VALUE,VALUE,...; may be repeated, all combinations "
                      "are tried");
  command->add_option("--plot", arguments->plot, "also draw the result: an .svg or .png file");
  AddFormat(*command, arguments->format, {"table", "json"});
  RunWithClient(*command, line, [arguments](Client& client) { return Tune(client, *arguments); });
}

}  // namespace soundmap::cli
