#include <algorithm>
#include <chrono>
#include <iostream>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <tuple>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "cli/command_line.h"
#include "cli/json_output.h"
#include "cli/table.h"
#include "cli/time_text.h"

namespace soundmap::cli {
namespace {

struct SourcesArguments {
  SoundSourceQuery query;
  std::string format;
};

struct VoxelsArguments {
  VoxelQuery query;
  std::string format;
};

std::int64_t NowNs() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

absl::Status Sources(Client& client, const SourcesArguments& arguments) {
  const auto list = client.ListSoundSources(arguments.query);
  if (!list.ok()) return list.status();
  if (arguments.format == "json") {
    std::cout << ToJson(*list, arguments.query.site).dump() << '\n';
    return absl::OkStatus();
  }
  using enum Table::Align;
  Table table({{"SOURCE"},
               {"X [m]", kRight},
               {"Y [m]", kRight},
               {"Z [m]", kRight},
               {"EXTENT [m]", kRight},
               {"PROBABILITY", kRight},
               {"STATE"},
               {"LEVEL [dB]", kRight},
               {"SPL [dB]", kRight},
               {"VIEWS", kRight},
               {"EVIDENCE", kRight},
               {"FIRST HEARD"},
               {"LAST HEARD"}});
  for (const SoundSource& source : list->sources) {
    const Vector3& p = source.position_in_map_m;
    table.Add({source.id, Fixed(p.x, 2), Fixed(p.y, 2), Fixed(p.z, 2), Fixed(source.extent_m, 2),
               Fixed(source.probability, 3), NameOf(source.state),
               source.level_db ? Fixed(*source.level_db, 1) : "-",
               source.spl_db ? Fixed(*source.spl_db, 1) : "-",
               absl::StrCat(source.view_point_count), absl::StrCat(source.evidence_count),
               FormatTime(source.first_heard_ns), FormatTime(source.last_heard_ns)});
  }
  table.Print(std::cout);
  for (const SoundSource& source : list->sources) {
    if (source.explained_by.empty()) continue;
    std::cout << source.id << " may be a ghost of " << source.explained_by
              << ", heard in its direction or mirrored.\n";
  }
  for (const SoundSource& source : list->sources) {
    if (!source.mirror_in_map_m) continue;
    const Vector3& p = *source.mirror_in_map_m;
    std::cout << source.id << " may be at " << Fixed(p.x, 2) << ' ' << Fixed(p.y, 2) << ' '
              << Fixed(p.z, 2) << " instead: the array cannot tell above from below.\n";
  }
  return absl::OkStatus();
}

void Append(VoxelColumns& all, const VoxelColumns& chunk) {
  const auto append = [](auto& to, const auto& from) {
    to.insert(to.end(), from.begin(), from.end());
  };
  append(all.x_key, chunk.x_key);
  append(all.y_key, chunk.y_key);
  append(all.z_key, chunk.z_key);
  append(all.log_odds, chunk.log_odds);
  append(all.update_count, chunk.update_count);
  append(all.last_update_ns, chunk.last_update_ns);
  all.revision = chunk.revision;
  all.as_of_ns = chunk.as_of_ns;
  all.voxel_size_m = chunk.voxel_size_m;
}

// By key, so that the same voxels give the same bytes in whatever order they came.
std::vector<std::size_t> OrderOf(const VoxelColumns& voxels) {
  std::vector<std::size_t> order(voxels.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&voxels](std::size_t a, std::size_t b) {
    return std::tuple(voxels.x_key[a], voxels.y_key[a], voxels.z_key[a]) <
           std::tuple(voxels.x_key[b], voxels.y_key[b], voxels.z_key[b]);
  });
  return order;
}

absl::Status Voxels(Client& client, const VoxelsArguments& arguments) {
  VoxelColumns voxels;
  const absl::Status status =
      client.QueryVoxels(arguments.query, [&voxels](const VoxelColumns& chunk) {
        Append(voxels, chunk);
        return true;
      });
  if (!status.ok()) return status;
  const bool csv = arguments.format == "csv";
  if (csv) {
    std::cout << "x_m,y_m,z_m,log_odds,update_count,last_update_ns\n";
  } else {
    std::cout << "{\"site\":" << Json(arguments.query.site).dump();
    if (!arguments.query.band.empty()) {
      std::cout << ",\"band\":" << Json(arguments.query.band).dump();
    }
    std::cout << ",\"revision\":" << voxels.revision << ",\"as_of_ns\":" << voxels.as_of_ns
              << ",\"voxel_size_m\":" << Json(voxels.voxel_size_m).dump() << ",\"voxels\":[";
  }
  const char* separator = "";
  for (const std::size_t i : OrderOf(voxels)) {
    const Json voxel = ToJson(voxels, i);
    if (csv) {
      separator = "";
      for (const Json& field : voxel) {
        std::cout << separator << field.dump();
        separator = ",";
      }
      std::cout << '\n';
    } else {
      std::cout << separator << voxel.dump();
      separator = ",";
    }
  }
  if (!csv) std::cout << "]}\n";
  return absl::OkStatus();
}

Box ParseBox(const std::string& text) {
  const std::vector<std::string> fields = absl::StrSplit(text, ',');
  std::vector<double> n;
  for (const std::string& field : fields) {
    double number = 0.0;
    if (absl::SimpleAtod(field, &number) && number >= -1e6 && number <= 1e6) n.push_back(number);
  }
  if (n.size() != 6 || fields.size() != 6 || n[0] > n[3] || n[1] > n[4] || n[2] > n[5]) {
    throw CLI::ValidationError("--box: \"" + text +
                               "\" is not x0,y0,z0,x1,y1,z1 in metres, the lower corner first");
  }
  return {{n[0], n[1], n[2]}, {n[3], n[4], n[5]}};
}

void AddTime(CLI::App& command, const std::string& option, std::int64_t& time_ns,
             const std::string& description) {
  command.add_option_function<std::string>(
      option,
      [option, &time_ns](const std::string& text) {
        const auto parsed_ns = ParseSince(text, NowNs());
        if (!parsed_ns.ok()) {
          throw CLI::ValidationError(option + ": " + std::string(parsed_ns.status().message()));
        }
        time_ns = *parsed_ns;
      },
      description);
}

}  // namespace

void AddSoundCommands(CLI::App& app, CommandLine& line) {
  auto sources = std::make_shared<SourcesArguments>();
  CLI::App* command = AddCommand(app, "sources", "the sound sources of a site");
  command->add_option("SITE", sources->query.site, "id of the site")->required();
  AddFormat(*command, sources->format, {"table", "json"});
  command
      ->add_option("--min-probability", sources->query.min_probability,
                   "only sources at least as sure")
      ->check(CLI::Range(0.0, 1.0));
  AddBand(*command, sources->query.band);
  AddTime(
      *command, "--since", sources->query.since_ns,
      "only sources heard since: ISO 8601, seconds since 1970, or an age such as 10m, 2h or 1d");
  AddTime(*command, "--until", sources->query.end_ns,
          "with --since: only sources heard between the two, those that are gone among them");
  command
      ->add_option("--state", sources->query.states,
                   "only sources in this state: active, silent, gone; may be given again")
      ->allow_extra_args(false)
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, SoundSourceState>{{"active", SoundSourceState::kActive},
                                                  {"silent", SoundSourceState::kSilent},
                                                  {"gone", SoundSourceState::kGone}}));
  RunWithClient(*command, line, [sources](Client& client) {
    SoundSourceQuery& query = sources->query;
    if (query.end_ns != 0) query.start_ns = std::exchange(query.since_ns, 0);
    return Sources(client, *sources);
  });

  auto voxels = std::make_shared<VoxelsArguments>();
  command = AddCommand(app, "voxels", "the voxels of a box of the sound map");
  command->add_option("SITE", voxels->query.site, "id of the site")->required();
  command
      ->add_option_function<std::string>(
          "--box", [voxels](const std::string& text) { voxels->query.box_in_map = ParseBox(text); },
          "x0,y0,z0,x1,y1,z1 in metres, in map")
      ->required();
  command
      ->add_option("--min-updates", voxels->query.min_updates,
                   "only voxels with more updates (the paper's epsilon_C)")
      ->check(CLI::Range(std::int64_t{0}, std::numeric_limits<std::int64_t>::max()));
  command
      ->add_option("--min-probability", voxels->query.min_probability,
                   "only voxels at least as sure")
      ->check(CLI::Range(0.0, 1.0));
  AddBand(*command, voxels->query.band);
  AddFormat(*command, voxels->format, {"json", "csv"});
  RunWithClient(*command, line, [voxels](Client& client) { return Voxels(client, *voxels); });
}

}  // namespace soundmap::cli
