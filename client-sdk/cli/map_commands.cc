#include <iostream>
#include <limits>
#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "cli/command_line.h"
#include "cli/json_output.h"
#include "cli/pose_file.h"
#include "cli/progress.h"

namespace soundmap::cli {
namespace {

struct BuildArguments {
  BuildMapRequest request;
  std::string poses;
  std::string format;
};

struct ImportArguments {
  std::string site;
  std::string file;
  std::string format;
};

struct ExportArguments {
  ExportMapRequest request;
  std::string file;
};

void PrintDone(const Operation& operation, const std::string& sentence, const std::string& format) {
  if (format == "json") {
    std::cout << ToJson(operation).dump() << '\n';
    return;
  }
  std::cout << sentence << '\n';
  if (!operation.report_json.empty()) std::cout << operation.report_json << '\n';
}

absl::Status Build(Client& client, BuildArguments& arguments) {
  if (!arguments.poses.empty()) {
    auto poses = ReadPoseFile(arguments.poses);
    if (!poses.ok()) return poses.status();
    arguments.request.surveyed_poses = *std::move(poses);
  }
  Progress progress;
  const auto operation = client.BuildMap(arguments.request, progress.ForOperation());
  if (!operation.ok()) return operation.status();
  PrintDone(*operation, absl::StrCat("the map of ", arguments.request.site, " is built"),
            arguments.format);
  return absl::OkStatus();
}

absl::Status Import(Client& client, const ImportArguments& arguments) {
  Progress progress;
  const auto operation = client.ImportMap(arguments.site, arguments.file, progress.ForOperation());
  if (!operation.ok()) return operation.status();
  PrintDone(*operation, absl::StrCat(arguments.file, " is the map of ", arguments.site),
            arguments.format);
  return absl::OkStatus();
}

absl::Status Export(Client& client, const ExportArguments& arguments) {
  Progress progress;
  const auto exported = client.ExportMap(arguments.request, arguments.file, progress.ForBytes());
  if (!exported.ok()) return exported.status();
  std::cout << "wrote " << absl::StrJoin(exported->files, " and ") << " (" << exported->bytes
            << " bytes)\n";
  return absl::OkStatus();
}

}  // namespace

void AddMapCommands(CLI::App& app, CommandLine& line) {
  CLI::App* map = AddCommand(app, "map", "the maps of a site");
  map->require_subcommand(1);

  auto build = std::make_shared<BuildArguments>();
  CLI::App* command =
      AddCommand(*map, "build", "make the geometric map from mapping drives and put it to use");
  command->add_option("SITE", build->request.site, "id of the site")->required();
  command->add_option("--from-session", build->request.sessions,
                      "mapping session, may be repeated; without it all of the site");
  command->add_flag("--extend", build->request.extend,
                    "keep the present map and its frame, and add the drives that are not in it");
  command->add_option("--poses", build->poses,
                      "surveyed poses instead of registration: timestamp_s,x,y,yaw or TUM");
  AddFormat(*command, build->format, {"table", "json"});
  RunWithClient(*command, line, [build](Client& client) { return Build(client, *build); });

  auto import = std::make_shared<ImportArguments>();
  command = AddCommand(*map, "import", "take an existing building as the geometric map");
  command->add_option("SITE", import->site, "id of the site")->required();
  command->add_option("FILE", import->file, "a .bt, .ot, .ply, .pcd or .yaml file")->required();
  AddFormat(*command, import->format, {"table", "json"});
  RunWithClient(*command, line, [import](Client& client) { return Import(client, *import); });

  auto export_ = std::make_shared<ExportArguments>();
  command = AddCommand(*map, "export", "write a map to a file");
  command->add_option("SITE", export_->request.site, "id of the site")->required();
  command
      ->add_option_function<std::string>(
          "--what",
          [export_](const std::string& what) {
            export_->request.what = what == "sound"      ? ExportWhat::kSound
                                    : what == "geometry" ? ExportWhat::kGeometry
                                                         : ExportWhat::kFloorPlan;
          },
          "which map")
      ->required()
      ->check(CLI::IsMember({"sound", "geometry", "floor-plan"}));
  command->add_option("--format", export_->request.format, "form of the file")
      ->required()
      ->check(CLI::IsMember({"ot", "bt", "ply", "pcd", "mcap", "png", "yaml"}));
  command->add_flag("--full", export_->request.full,
                    "sound map as .ot: all three voxel fields instead of OctoMap's log-odds");
  command
      ->add_option("--min-updates", export_->request.min_updates,
                   "only voxels with more updates (the paper's epsilon_C)")
      ->check(CLI::Range(std::int64_t{0}, std::numeric_limits<std::int64_t>::max()));
  AddBand(*command, export_->request.band);
  command->add_option("-o,--output", export_->file, "file to write")->required();
  RunWithClient(*command, line, [export_](Client& client) { return Export(client, *export_); });
}

}  // namespace soundmap::cli
