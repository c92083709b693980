#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "soundmap/client.h"

// The commands of the program `soundmap`. Each function here declares some; the one that the
// command line names sets `run`.
namespace soundmap::cli {

struct CommandLine {
  std::string server;
  std::string token_file;
  std::string tls_ca;
  std::function<absl::Status()> run;

  // By the global options.
  absl::StatusOr<Client> Connect() const;
};

void AddGlobalOptions(CLI::App& app, CommandLine& line);
void AddSiteCommands(CLI::App& app, CommandLine& line);
void AddMapCommands(CLI::App& app, CommandLine& line);
void AddSoundCommands(CLI::App& app, CommandLine& line);
void AddWatchCommand(CLI::App& app, CommandLine& line);
void AddRobotCommands(CLI::App& app, CommandLine& line);
void AddOperationCommands(CLI::App& app, CommandLine& line);
void AddEvaluateCommand(CLI::App& app, CommandLine& line);
void AddTuneCommand(CLI::App& app, CommandLine& line);

// A subcommand that takes the global options too. `action(client)` -> absl::Status runs when it is
// named.
CLI::App* AddCommand(CLI::App& parent, const std::string& name, const std::string& description);
void RunWithClient(CLI::App& command, CommandLine& line,
                   std::function<absl::Status(Client&)> action);

// --format, one of `formats`, the first by default.
void AddFormat(CLI::App& command, std::string& format, const std::vector<std::string>& formats);

// --band, of the site's bands; empty by default: that of its profile.
void AddBand(CLI::App& command, std::string& band);

}  // namespace soundmap::cli
