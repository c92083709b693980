#include <google/protobuf/stubs/logging.h>

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

#include "cli/command_line.h"

namespace {

constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;

int Fail(std::string sentence, int exit_status) {
  std::replace(sentence.begin(), sentence.end(), '\n', ' ');
  std::cerr << "soundmap: " << sentence << '\n';
  return exit_status;
}

}  // namespace

int main(int argc, char** argv) {
  // Standard error is for sentences; gRPC's own log comes if asked for.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  google::protobuf::SetLogHandler(nullptr);
  CLI::App app("Asks and administrates a sound map server.", "soundmap");
  soundmap::cli::CommandLine line;
  soundmap::cli::AddGlobalOptions(app, line);
  soundmap::cli::AddSiteCommands(app, line);
  soundmap::cli::AddMapCommands(app, line);
  soundmap::cli::AddSoundCommands(app, line);
  soundmap::cli::AddWatchCommand(app, line);
  soundmap::cli::AddRobotCommands(app, line);
  soundmap::cli::AddOperationCommands(app, line);
  soundmap::cli::AddEvaluateCommand(app, line);
  soundmap::cli::AddTuneCommand(app, line);
  app.set_version_flag("--version", SOUNDMAP_VERSION);
  app.require_subcommand(1);

  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& help) {
    return app.exit(help);
  } catch (const CLI::RequiredError& error) {
    const std::vector<std::string> unknown = app.remaining(/*recurse=*/true);
    return Fail(unknown.empty() ? error.what() : unknown.front() + " is not a command or option",
                kWrongUsage);
  } catch (const CLI::Error& error) {
    return Fail(error.what(), kWrongUsage);
  }

  const absl::Status status = line.run();
  if (!status.ok()) return Fail(std::string(status.message()), kFailed);
  if (!std::cout.flush()) return Fail("cannot write to standard output", kFailed);
  return 0;
}
