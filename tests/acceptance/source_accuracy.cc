// How well the sound sources of rooms drawn at random are found: ./run evaluate.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "tests/acceptance/room_trial.h"

namespace soundmap::acceptance {
namespace {

using nlohmann::ordered_json;

struct Arguments {
  std::string cache = "/tmp/soundmap-rooms";
  int first = 1;
  int rooms = 30;
  std::string profile = "default";
  std::vector<std::string> parameters;
  Fault fault = Fault::kNone;
  RoomVariant variant;
  std::string drive, mapping;
  std::string out;
  bool details = false;
};

// A profile with some of its parameters replaced, each given as section.key=value.
absl::StatusOr<pipeline::Profile> ProfileOf(const Arguments& arguments) {
  std::string text = absl::StrCat("profile = \"", arguments.profile, "\"\n");
  for (const std::string& parameter : arguments.parameters) absl::StrAppend(&text, parameter, "\n");
  return pipeline::ProfileFromToml(text);
}

void Print(const Trial& trial, const TrialResult& result, bool details) {
  double worst_m = 0.0;
  for (const SourceResult& source : result.sources) {
    if (source.in_view && source.error_m) worst_m = std::max(worst_m, *source.error_m);
  }
  std::printf(
      "%-22s %2zu mics %-6s  found %d of %d  false %d double %d  worst %.3f m  pose %.3f m  "
      "%.2f peaks a scan\n",
      trial.name.c_str(), trial.calibration.mic_in_array_m.size(), trial.planar() ? "planar" : "3D",
      result.detected(), result.in_view(), result.false_count, result.doubles(), worst_m,
      result.pose_error_m, result.peaks_per_scan);
  for (const std::string& warning : result.warnings) std::printf("    %s\n", warning.c_str());
  if (details) {
    for (std::size_t i = 0; i < result.sources.size(); ++i) {
      const SourceResult& source = result.sources[i];
      const auto& p = trial.scene.sources[i].position_in_map_m;
      std::printf("    true  (%5.2f %5.2f %5.2f) %-8s level %.2f %s %s\n", p.x, p.y, p.z,
                  source.kind.c_str(), source.level, source.in_view ? "" : "out of view",
                  source.error_m ? absl::StrCat(*source.error_m).c_str() : "missed");
    }
    for (const sound_map::RegisteredSource& registered : result.found) {
      const sound_map::SoundSource& source = registered.found;
      if (source.probability < 0.05) continue;
      const Eigen::Vector3d& p = source.position_in_map_m;
      double nearest_m = 1e9;
      for (const auto& t : trial.scene.sources) {
        nearest_m =
            std::min(nearest_m, (p - Eigen::Vector3d(t.position_in_map_m.x, t.position_in_map_m.y,
                                                     t.position_in_map_m.z))
                                    .norm());
      }
      std::printf("    found (%5.2f %5.2f %5.2f) p %.3f  heard %4d  extent %.2f  nearest %.2f\n",
                  p.x(), p.y(), p.z(), source.probability, static_cast<int>(source.evidence_count),
                  source.extent_m, nearest_m);
    }
  }
  std::fflush(stdout);
}

ordered_json ToJson(const Summary& s) {
  const cli::Calibration calibration = cli::Calibrate(s.candidates);
  return {{"sources", s.in_view},
          {"detected", s.detected},
          {"false", s.false_count},
          {"double", s.doubles},
          {"recall", s.recall()},
          {"precision", s.precision()},
          {"error_median_m", s.ErrorQuantile(0.5)},
          {"error_p90_m", s.ErrorQuantile(0.9)},
          {"candidates", s.candidates.size()},
          {"calibration_error", calibration.expected_error.value_or(0.0)},
          {"brier_score", calibration.brier.value_or(0.0)}};
}

void Print(const char* name, const Summary& s) {
  const cli::Calibration calibration = cli::Calibrate(s.candidates);
  std::printf(
      "%-8s recall %.3f (%d of %d)  precision %.3f (%d false, %d double)  error median %.3f "
      "p90 %.3f m  candidates %zu  calibration error %.3f  Brier %.3f\n",
      name, s.recall(), s.detected, s.in_view, s.precision(), s.false_count, s.doubles,
      s.ErrorQuantile(0.5), s.ErrorQuantile(0.9), s.candidates.size(),
      calibration.expected_error.value_or(0.0), calibration.brier.value_or(0.0));
}

absl::Status Main(const Arguments& arguments) {
  const auto profile = ProfileOf(arguments);
  if (!profile.ok()) return profile.status();
  Summary space, plane, all;
  ordered_json rooms = ordered_json::array();
  const int count = arguments.drive.empty() ? arguments.rooms : 1;
  for (int i = 0; i < count; ++i) {
    const int seed = arguments.first + i;
    auto trial = arguments.drive.empty() ? RandomTrial(seed, arguments.variant, arguments.cache)
                                         : ReadTrial(arguments.drive, arguments.mapping);
    if (!trial.ok()) return trial.status();
    Inject(arguments.fault, *trial);
    const auto result = Run(*trial, *profile);
    if (!result.ok()) return result.status();
    Print(*trial, *result, arguments.details);
    (trial->planar() ? plane : space).Add(*result);
    all.Add(*result);
    rooms.push_back({{"name", trial->name},
                     {"microphones", trial->calibration.mic_in_array_m.size()},
                     {"planar", trial->planar()},
                     {"in_view", result->in_view()},
                     {"detected", result->detected()},
                     {"false", result->false_count},
                     {"double", result->doubles()}});
  }
  Print("3D", space);
  Print("planar", plane);
  Print("all", all);
  if (!arguments.out.empty()) {
    ordered_json document = {
        {"3D", ToJson(space)}, {"planar", ToJson(plane)}, {"all", ToJson(all)}, {"rooms", rooms}};
    if (!(std::ofstream(arguments.out) << document.dump(1) << std::endl)) {
      return absl::UnavailableError(absl::StrCat(arguments.out, ": cannot be written"));
    }
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace soundmap::acceptance

int main(int argc, char** argv) {
  using soundmap::acceptance::Fault;
  soundmap::acceptance::Arguments arguments;
  CLI::App app("Finds the sound sources of rooms drawn at random and compares them with the truth");
  app.add_option("--cache", arguments.cache, "Folder that keeps the drives")->capture_default_str();
  app.add_option("--first", arguments.first, "The first room's seed")->capture_default_str();
  app.add_option("--rooms", arguments.rooms, "How many")->capture_default_str();
  app.add_option("--profile", arguments.profile)->capture_default_str();
  app.add_option("--set", arguments.parameters, "section.key=value in place of the profile's");
  app.add_option("--fault", arguments.fault, "What is wrong with the robot")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, Fault>{{"none", Fault::kNone},
                                       {"dead", Fault::kDeadMicrophone},
                                       {"inverted", Fault::kInvertedMicrophone},
                                       {"gains", Fault::kGains},
                                       {"offset", Fault::kArrayOffset},
                                       {"lost", Fault::kLostAudio}}));
  app.add_flag("--silent", arguments.variant.silent, "Rooms without a source");
  app.add_option("--seconds", arguments.variant.seconds, "Let each drive last so long");
  app.add_option("--drive", arguments.drive, "A recording with truth, in place of random rooms");
  app.add_option("--mapping", arguments.mapping, "The mapping drive of its building");
  app.add_option("--out", arguments.out, "A JSON file for the results");
  app.add_flag("--details", arguments.details, "Every source, true and found");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = soundmap::acceptance::Main(arguments);
  if (status.ok()) return 0;
  std::fprintf(stderr, "source_accuracy: %s\n", std::string(status.message()).c_str());
  return 1;
}
