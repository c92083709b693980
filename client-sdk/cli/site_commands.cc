#include <iostream>
#include <memory>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "cli/command_line.h"
#include "cli/json_output.h"
#include "cli/progress.h"
#include "cli/table.h"
#include "cli/time_text.h"

namespace soundmap::cli {
namespace {

struct SiteArguments {
  std::string site;
  std::string map;
  std::string profile;
  std::vector<Band> bands;
  std::int64_t keep_frames_s = 0;
  std::string format;
};

// In the largest unit that divides it.
std::string KeepText(std::int64_t seconds) {
  const std::pair<std::int64_t, const char*> units[] = {{86400, " d"}, {3600, " h"}, {60, " min"}};
  for (const auto& [unit_s, name] : units) {
    if (seconds % unit_s == 0) return absl::StrCat(seconds / unit_s, name);
  }
  return absl::StrCat(seconds, " s");
}

void PrintSites(const std::vector<Site>& sites) {
  Table table({{"SITE"},
               {"PROFILE"},
               {"MAP VERSION", Table::Align::kRight},
               {"CREATED"},
               {"FRAMES ARE KEPT"}});
  for (const Site& site : sites) {
    table.Add({site.id, site.profile, absl::StrCat(site.building_version),
               FormatTime(site.create_time_ns),
               site.keep_frames_s == 0 ? "for ever" : KeepText(site.keep_frames_s)});
  }
  table.Print(std::cout);
}

void PrintSite(const Site& site, const std::string& format) {
  if (format == "json") {
    std::cout << ToJson(site).dump() << '\n';
    return;
  }
  PrintSites({site});
  for (const Band& band : site.bands) {
    std::cout << "band " << band.name << ": " << absl::StrCat(band.min_frequency_hz) << " to "
              << absl::StrCat(band.max_frequency_hz) << " Hz\n";
  }
}

// NAME=MIN-MAX; which names and frequencies there can be, says the server.
Band ParseBand(const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, absl::MaxSplits('=', 1));
  const std::vector<std::string> edges = absl::StrSplit(parts.back(), absl::MaxSplits('-', 1));
  Band band{parts.front()};
  if (parts.size() != 2 || edges.size() != 2 ||
      !absl::SimpleAtod(edges[0], &band.min_frequency_hz) ||
      !absl::SimpleAtod(edges[1], &band.max_frequency_hz)) {
    throw CLI::ValidationError("--band: \"" + text +
                               "\" is not NAME=MIN-MAX, the frequencies in hertz");
  }
  return band;
}

// A site whose map cannot be taken over is not left behind.
absl::Status Create(Client& client, const SiteArguments& arguments) {
  auto site = client.CreateSite(arguments.site, arguments.profile, arguments.bands);
  if (!site.ok()) return site.status();
  if (!arguments.map.empty()) {
    absl::Status imported;
    {
      Progress progress;
      imported = client.ImportMap(arguments.site, arguments.map, progress.ForOperation()).status();
    }
    if (!imported.ok()) {
      const absl::Status deleted = client.DeleteSite(arguments.site);
      if (deleted.ok()) return imported;
      return absl::Status(imported.code(),
                          absl::StrCat(imported.message(), "; the site ", arguments.site,
                                       " stays behind without a map: ", deleted.message()));
    }
    site = client.GetSite(arguments.site);
    if (!site.ok()) return site.status();
  }
  PrintSite(*site, arguments.format);
  return absl::OkStatus();
}

absl::Status Show(Client& client, const SiteArguments& arguments) {
  const auto site = client.GetSite(arguments.site);
  if (!site.ok()) return site.status();
  PrintSite(*site, arguments.format);
  if (arguments.format != "json") std::cout << '\n' << site->parameters_toml;
  return absl::OkStatus();
}

absl::Status Set(Client& client, const SiteArguments& arguments) {
  const auto site = client.KeepFrames(arguments.site, arguments.keep_frames_s);
  if (!site.ok()) return site.status();
  PrintSite(*site, arguments.format);
  return absl::OkStatus();
}

absl::Status List(Client& client, const SiteArguments& arguments) {
  const auto sites = client.ListSites();
  if (!sites.ok()) return sites.status();
  if (arguments.format == "json") {
    std::cout << ListToJson("sites", *sites).dump() << '\n';
  } else {
    PrintSites(*sites);
  }
  return absl::OkStatus();
}

absl::Status Delete(Client& client, const SiteArguments& arguments) {
  const absl::Status status = client.DeleteSite(arguments.site);
  if (!status.ok()) return status;
  if (arguments.format == "json") {
    std::cout << Json{{"deleted", arguments.site}}.dump() << '\n';
  } else {
    std::cout << "deleted " << arguments.site << '\n';
  }
  return absl::OkStatus();
}

}  // namespace

void AddSiteCommands(CLI::App& app, CommandLine& line) {
  CLI::App* site = AddCommand(app, "site", "sites: one building with one map each");
  site->require_subcommand(1);
  const auto add = [&](const char* name, const char* description, auto action, bool takes_site) {
    auto arguments = std::make_shared<SiteArguments>();
    CLI::App* command = AddCommand(*site, name, description);
    if (takes_site) command->add_option("SITE", arguments->site, "id of the site")->required();
    AddFormat(*command, arguments->format, {"table", "json"});
    RunWithClient(*command, line,
                  [action, arguments](Client& client) { return action(client, *arguments); });
    return std::pair(command, arguments);
  };
  const auto [create, arguments] = add("create", "create a site", Create, true);
  create->add_option("--map", arguments->map,
                     "geometric map of the building: a .bt, .ot, .ply, .pcd or .yaml file");
  arguments->profile = "default";
  create->add_option("--profile", arguments->profile, "method and parameters")
      ->check(CLI::IsMember({"default", "paper"}))
      ->capture_default_str();
  create
      ->add_option_function<std::vector<std::string>>(
          "--band",
          [arguments = arguments](const std::vector<std::string>& texts) {
            for (const std::string& text : texts) arguments->bands.push_back(ParseBand(text));
          },
          "NAME=MIN-MAX in hertz: a sound map of this band, too, as in hiss=4000-8000; may be "
          "given again")
      ->allow_extra_args(false);
  add("list", "list the sites", List, false);
  add("show", "show a site and its parameters", Show, true);
  const auto [set, changed] = add("set", "change what a site does", Set, true);
  set->add_option("--keep-frames", changed->keep_frames_s,
                  "how long the frames of a listening drive are kept from when it was begun, once "
                  "they are in the map: 12h, 30d; 0s: for ever")
      ->required()
      ->transform(CLI::AsNumberWithUnit(
          std::map<std::string, std::int64_t>{{"s", 1}, {"min", 60}, {"h", 3600}, {"d", 86400}},
          CLI::AsNumberWithUnit::UNIT_REQUIRED));
  add("delete", "delete a site with its map, sessions and recordings", Delete, true);
}

}  // namespace soundmap::cli
