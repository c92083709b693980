#include <iostream>
#include <memory>

#include "absl/strings/str_cat.h"
#include "cli/command_line.h"
#include "cli/json_output.h"
#include "cli/progress.h"
#include "cli/table.h"
#include "cli/time_text.h"

namespace soundmap::cli {
namespace {

struct OperationArguments {
  std::string site;
  std::string cancel;
  std::string format;
};

absl::Status Operations(Client& client, const OperationArguments& arguments) {
  std::vector<Operation> operations;
  if (arguments.cancel.empty()) {
    auto list = client.ListOperations(arguments.site);
    if (!list.ok()) return list.status();
    operations = *std::move(list);
  } else {
    auto operation = client.CancelOperation(arguments.cancel);
    if (!operation.ok()) return operation.status();
    operations = {*std::move(operation)};
  }
  if (arguments.format == "json") {
    std::cout << ListToJson("operations", operations).dump() << '\n';
    return absl::OkStatus();
  }
  Table table({{"OPERATION"},
               {"SITE"},
               {"KIND"},
               {"STATE"},
               {"PROGRESS", Table::Align::kRight},
               {"STARTED"},
               {"REMARKS"}});
  for (const Operation& operation : operations) {
    const char* state = !operation.done ? "running" : operation.error_code == 0 ? "done" : "failed";
    table.Add({operation.id, operation.site, operation.kind, state,
               absl::StrCat(Fixed(100.0 * operation.progress, 0), " %"),
               FormatTime(operation.create_time_ns),
               operation.done ? operation.error_message : operation.progress_text});
  }
  table.Print(std::cout);
  return absl::OkStatus();
}

struct BackupArguments {
  std::string name;
  std::string format;
};

absl::Status CreateBackup(Client& client, const BackupArguments& arguments) {
  Progress progress;
  const auto operation = client.CreateBackup(arguments.name, progress.ForOperation());
  if (!operation.ok()) return operation.status();
  if (arguments.format == "json") {
    std::cout << ToJson(*operation).dump() << '\n';
  } else {
    std::cout << "the backup " << arguments.name << " is made\n" << operation->report_json << '\n';
  }
  return absl::OkStatus();
}

}  // namespace

void AddOperationCommands(CLI::App& app, CommandLine& line) {
  auto backup = std::make_shared<BackupArguments>();
  CLI::App* backup_command =
      AddCommand(app, "backup", "copy all that the server keeps into a folder of its --backup-dir");
  backup_command->add_option("NAME", backup->name, "name of the folder")->required();
  AddFormat(*backup_command, backup->format, {"table", "json"});
  RunWithClient(*backup_command, line,
                [backup](Client& client) { return CreateBackup(client, *backup); });

  auto arguments = std::make_shared<OperationArguments>();
  CLI::App* command = AddCommand(app, "operations", "long-running work of the server");
  command->add_option("SITE", arguments->site, "only of this site");
  command->add_option("--cancel", arguments->cancel, "cancel this operation");
  AddFormat(*command, arguments->format, {"table", "json"});
  RunWithClient(*command, line,
                [arguments](Client& client) { return Operations(client, *arguments); });
}

}  // namespace soundmap::cli
