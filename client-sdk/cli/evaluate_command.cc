#include <iostream>
#include <memory>

#include "absl/strings/str_cat.h"
#include "cli/command_line.h"
#include "cli/drive_truth.h"
#include "cli/evaluate.h"
#include "cli/table.h"
#include "cli/visibility.h"

namespace soundmap::cli {
namespace {

struct EvaluateArguments {
  std::string site;
  std::string truth;
  std::string drive;
  std::string poses;
  std::string relations;
  std::string robot;
  std::string session;
  std::string format;
};

// What is read from files, before the server is asked.
struct Inputs {
  std::optional<SceneTruth> scene;
  std::optional<DriveTruth> drive;
  std::vector<StampedPose> poses;
  std::vector<Relation> relations;
};

absl::StatusOr<Inputs> ReadInputs(const EvaluateArguments& arguments) {
  Inputs inputs;
  if (!arguments.truth.empty()) {
    auto scene = ReadTruthFile(arguments.truth);
    if (!scene.ok()) return scene.status();
    inputs.scene = *std::move(scene);
  }
  if (!arguments.poses.empty()) {
    auto poses = ReadPoseFile(arguments.poses);
    if (!poses.ok()) return poses.status();
    inputs.poses = *std::move(poses);
  }
  if (!arguments.relations.empty()) {
    auto relations = ReadRelationFile(arguments.relations);
    if (!relations.ok()) return relations.status();
    inputs.relations = *std::move(relations);
  }
  if (!arguments.drive.empty()) {
    auto drive = ReadDriveTruth(arguments.drive);
    if (!drive.ok()) return drive.status();
    if (!drive->warning.empty()) std::cerr << "soundmap: " << drive->warning << '\n';
    if (drive->map_from_base.empty() && !inputs.scene && inputs.poses.empty()) {
      return absl::FailedPreconditionError(
          absl::StrCat(arguments.drive, " has no /ground_truth/pose to compare with"));
    }
    inputs.drive = *std::move(drive);
  }
  return inputs;
}

absl::StatusOr<SourceScore> ScoreSite(Client& client, const std::string& site_id,
                                      const Inputs& inputs, const std::string& drive_path) {
  const auto reported = client.ListSoundSources({.site = site_id});
  if (!reported.ok()) return reported.status();
  std::vector<bool> in_view;
  if (inputs.drive) {
    const auto site = client.GetSite(site_id);
    if (!site.ok()) return site.status();
    auto known = SourcesInView(*inputs.scene, *inputs.drive, site->max_range_m, drive_path);
    if (!known.ok()) return known.status();
    in_view = *std::move(known);
  }
  return ScoreSources(reported->sources, inputs.scene->sources, in_view);
}

absl::StatusOr<std::vector<PoseEstimate>> EstimatedPath(Client& client,
                                                        const EvaluateArguments& arguments) {
  std::string session_id = arguments.session;
  if (session_id.empty()) {
    const auto sessions = client.ListSessions(arguments.site, arguments.robot);
    if (!sessions.ok()) return sessions.status();
    const auto session = SessionToEvaluate(*sessions);
    if (!session) {
      return absl::NotFoundError(absl::StrCat(
          "the site ", arguments.site, " has no session",
          arguments.robot.empty() ? "" : absl::StrCat(" of the robot ", arguments.robot)));
    }
    session_id = session->id;
  }
  return client.GetTrajectory(arguments.site, session_id);
}

void PrintTable(const Evaluation& evaluation) {
  Table table({{"WHAT"}, {"VALUE", Table::Align::kRight}});
  const auto metres = [](const std::optional<double>& value) {
    return value ? absl::StrCat(Fixed(*value, 4), " m") : "-";
  };
  const auto degrees = [](double value) { return absl::StrCat(Fixed(value, 3), " deg"); };
  if (const auto& sources = evaluation.sources) {
    table.Add({"sources in view", absl::StrCat(sources->true_count)});
    table.Add({"sources detected", absl::StrCat(sources->detected)});
    table.Add({"sources out of view", absl::StrCat(sources->out_of_view)});
    table.Add({"sources false", absl::StrCat(sources->false_count)});
    table.Add({"sources double", absl::StrCat(sources->double_count)});
    table.Add({"source error, mean", metres(sources->error_mean_m)});
    table.Add({"source error, deviation", metres(sources->error_std_m)});
  }
  if (const auto& pose = evaluation.pose) {
    table.Add({"pose error, mean", metres(pose->error_mean_m)});
    table.Add({"pose error, 95 %", metres(pose->error_p95_m)});
    table.Add({"yaw error, mean", degrees(pose->yaw_error_mean_deg)});
    table.Add({"lost", absl::StrCat(Fixed(100.0 * pose->lost_fraction, 1), " %")});
  }
  if (const auto& relations = evaluation.relations) {
    table.Add({"relations, translation mean", metres(relations->trans_mean_m)});
    table.Add({"relations, translation deviation", metres(relations->trans_std_m)});
    table.Add({"relations, rotation mean", degrees(relations->rot_mean_deg)});
  }
  table.Print(std::cout);
}

absl::Status Evaluate(Client& client, const EvaluateArguments& arguments) {
  const auto inputs = ReadInputs(arguments);
  if (!inputs.ok()) return inputs.status();
  Evaluation evaluation;
  if (inputs->scene) {
    const auto score = ScoreSite(client, arguments.site, *inputs, arguments.drive);
    if (!score.ok()) return score.status();
    evaluation.sources = *score;
  }
  if (inputs->drive || !inputs->poses.empty() || !inputs->relations.empty()) {
    const auto path = EstimatedPath(client, arguments);
    if (!path.ok()) return path.status();
    if (inputs->drive || !inputs->poses.empty()) {
      const auto score = inputs->poses.empty()
                             ? ScoreAgainstDrive(*path, inputs->drive->map_from_base)
                             : ScoreAgainstSurvey(*path, inputs->poses);
      if (!score.ok()) return score.status();
      evaluation.pose = *score;
    }
    if (!inputs->relations.empty()) {
      const auto score = ScoreRelations(*path, inputs->relations);
      if (!score.ok()) return score.status();
      evaluation.relations = *score;
      if (score->outside_path > 0) {
        std::cerr << "soundmap: " << score->outside_path << " of " << inputs->relations.size()
                  << " relations lie outside the time of the estimated path\n";
      }
    }
  }
  if (arguments.format == "json") {
    std::cout << ToJson(evaluation) << '\n';
  } else {
    PrintTable(evaluation);
  }
  return absl::OkStatus();
}

}  // namespace

void AddEvaluateCommand(CLI::App& app, CommandLine& line) {
  auto arguments = std::make_shared<EvaluateArguments>();
  CLI::App* command =
      AddCommand(app, "evaluate", "compare the map and the estimated path with what is true");
  command->add_option("SITE", arguments->site, "id of the site")->required();
  command->add_option("--truth", arguments->truth, "true sources: NAME.truth.json");
  command->add_option("--drive", arguments->drive,
                      "recording with the true poses: which sources were in view, and pose errors");
  command->add_option("--poses", arguments->poses,
                      "true poses: timestamp_s,x,y,yaw or TUM; they go before the drive's");
  command->add_option("--relations", arguments->relations,
                      "SLAM benchmark: lines t1 t2 dx dy dz roll pitch yaw");
  command->add_option("--robot", arguments->robot,
                      "the path of its newest listening session; without it of the site's");
  command->add_option("--session", arguments->session, "the path of this session");
  AddFormat(*command, arguments->format, {"json", "table"});
  command->parse_complete_callback([arguments] {
    if (arguments->truth.empty() && arguments->drive.empty() && arguments->poses.empty() &&
        arguments->relations.empty()) {
      throw CLI::ValidationError("evaluate needs --truth, --drive, --poses or --relations");
    }
  });
  RunWithClient(*command, line,
                [arguments](Client& client) { return Evaluate(client, *arguments); });
}

}  // namespace soundmap::cli
