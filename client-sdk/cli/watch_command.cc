#include <iostream>
#include <limits>
#include <memory>

#include "cli/command_line.h"
#include "cli/json_output.h"

namespace soundmap::cli {
namespace {

struct WatchArguments {
  WatchRequest request;
  int count = 0;
};

absl::Status Watch(Client& client, WatchArguments& arguments) {
  WatchRequest& request = arguments.request;
  if (!request.sound_sources && !request.robots && !request.audio_scans) {
    request.sound_sources = request.robots = true;
  }
  int printed = 0;
  const absl::Status status = client.Watch(request, [&](const WatchEvent& event) {
    const auto json = ToJson(event);
    if (!json) return true;
    std::cout << json->dump() << std::endl;
    ++printed;
    return std::cout.good() && printed != arguments.count;
  });
  return status;
}

}  // namespace

void AddWatchCommand(CLI::App& app, CommandLine& line) {
  auto arguments = std::make_shared<WatchArguments>();
  CLI::App* command =
      AddCommand(app, "watch", "tell what happens at a site, one JSON line an event");
  command->add_option("SITE", arguments->request.site, "id of the site")->required();
  command->add_flag("--sources", arguments->request.sound_sources, "sound sources");
  command->add_flag("--robots", arguments->request.robots, "robots");
  command->add_flag("--scans", arguments->request.audio_scans, "audio scans");
  AddBand(*command, arguments->request.band);
  command->add_option("--resume", arguments->request.resume_token,
                      "go on after the event with this resume_token");
  command->add_option("--count", arguments->count, "end after so many events")
      ->check(CLI::Range(1, std::numeric_limits<int>::max()));
  RunWithClient(*command, line, [arguments](Client& client) { return Watch(client, *arguments); });
}

}  // namespace soundmap::cli
