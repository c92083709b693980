#include "run_config.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <set>
#include <type_traits>

#define TOML_EXCEPTIONS 0
// toml++'s assertions do not hold for every text, "[=]" for one, and an error stands behind each.
#define TOML_ASSERT(condition) static_cast<void>(0)
#include <toml++/toml.h>

#include "absl/strings/str_cat.h"

namespace soundmap {
namespace {

// Takes keys out of a file; what nobody took is unknown.
class Keys {
 public:
  Keys(std::string path, toml::table table) : path_(std::move(path)), table_(std::move(table)) {}

  void Text(const char* section, const char* key, std::string& out) {
    if (auto value = Take<std::string>(section, key, "a text")) out = *std::move(value);
  }
  void Number(const char* section, const char* key, double low, double high, double& out) {
    const auto value = Take<double>(section, key, "a number");
    if (!value) return;
    if (!(*value >= low && *value <= high)) {
      Fail(section, key, absl::StrCat("must lie in ", low, " .. ", high));
    }
    out = *value;
  }
  void Flag(const char* section, const char* key, bool& out) {
    if (const auto value = Take<bool>(section, key, "true or false")) out = *value;
  }
  void OneOf(const char* section, const char* key, const std::set<std::string>& allowed,
             std::string& out) {
    Text(section, key, out);
    if (!allowed.contains(out)) Fail(section, key, absl::StrCat("cannot be '", out, "'"));
  }
  void Require(const char* section, const char* key, const std::string& value) {
    if (value.empty()) Fail(section, key, "is missing");
  }

  // The first that is said is the one that is told.
  void Fail(const char* section, const char* key, const std::string& what) {
    if (!status_.ok()) return;
    status_ = absl::InvalidArgumentError(
        absl::StrCat(path_, ": ", section, *section == '\0' ? "" : ".", key, " ", what));
  }

  absl::Status Finish() {
    for (auto&& [section, node] : table_) {
      if (!node.is_table()) {
        Fail("", std::string(section.str()).c_str(), "is not known");
        continue;
      }
      for (auto&& [key, value] : *node.as_table()) {
        Fail(std::string(section.str()).c_str(), std::string(key.str()).c_str(), "is not known");
      }
    }
    return status_;
  }

 private:
  template <typename Value>
  std::optional<Value> Take(const char* section, const char* key, const char* what) {
    const toml::node_view<toml::node> node = table_[section][key];
    if (!node) return std::nullopt;
    // A number is no flag, nor a flag a number, although toml++ would take one for the other.
    const bool converts = node.is_boolean() != std::is_same_v<Value, bool>;
    const std::optional<Value> value = converts ? std::nullopt : node.value<Value>();
    if (!value) Fail(section, key, absl::StrCat("is not ", what));
    table_[section].as_table()->erase(key);
    return value;
  }

  const std::string path_;
  toml::table table_;
  absl::Status status_;
};

}  // namespace

absl::StatusOr<RunConfig> RunConfig::Read(const std::string& path) {
  toml::parse_result parsed = toml::parse_file(path);
  if (!parsed) {
    return absl::InvalidArgumentError(absl::StrCat(path, ":", parsed.error().source().begin.line,
                                                   ": ",
                                                   std::string(parsed.error().description())));
  }
  Keys keys(path, std::move(parsed).table());
  RunConfig config;
  keys.Text("server", "address", config.server.address);
  keys.Text("server", "token_file", config.server.token_file);
  keys.Text("server", "tls_ca", config.server.tls_ca);
  keys.Text("server", "tls_cert", config.server.tls_cert);
  keys.Text("server", "tls_key", config.server.tls_key);

  keys.Text("robot", "name", config.session.robot);
  keys.Require("robot", "name", config.session.robot);
  keys.Text("robot", "site", config.session.site);
  keys.Require("robot", "site", config.session.site);
  keys.OneOf("robot", "purpose", {"listening", "mapping"}, config.session.purpose);
  keys.Number("robot", "laser_time_increment_s", 0.0, 1.0, config.session.laser_time_increment_s);
  const double nan = std::nan("");
  double full_scale_spl_db = nan;
  keys.Number("robot", "full_scale_spl_db", 60.0, 200.0, full_scale_spl_db);
  if (!std::isnan(full_scale_spl_db)) config.session.full_scale_spl_db = full_scale_spl_db;
  double pose[3] = {nan, nan, nan};
  keys.Number("robot", "initial_x_m", -1e6, 1e6, pose[0]);
  keys.Number("robot", "initial_y_m", -1e6, 1e6, pose[1]);
  keys.Number("robot", "initial_yaw_deg", -360.0, 360.0, pose[2]);
  const int given = static_cast<int>(!std::isnan(pose[0])) +
                    static_cast<int>(!std::isnan(pose[1])) + static_cast<int>(!std::isnan(pose[2]));
  if (given == 3) {
    config.session.initial_pose = {pose[0], pose[1], pose[2] * std::numbers::pi / 180.0};
  } else if (given > 0) {
    keys.Fail("robot", "initial_x_m", "is given together with initial_y_m and initial_yaw_deg");
  }

  std::string source_type = "recording";
  keys.OneOf("source", "type", {"recording"}, source_type);
  keys.Text("source", "drive", config.drive);
  keys.Require("source", "drive", config.drive);
  keys.Number("source", "speed", 0.0, 1e6, config.speed);
  keys.Number("source", "lidar_resolution_m", 0.0, 0.1, config.lidar_resolution_m);

  keys.Text("spool", "dir", config.spool_folder);
  keys.Require("spool", "dir", config.spool_folder);
  double max_gb = static_cast<double>(config.spool.max_bytes) * 1e-9;
  keys.Number("spool", "max_gb", 0.0, 1e6, max_gb);
  config.spool.max_bytes = static_cast<std::int64_t>(max_gb * 1e9);
  // A small spool has small segments: the oldest goes whole.
  config.spool.segment_bytes =
      std::clamp<std::int64_t>(config.spool.max_bytes / 16, 1, config.spool.segment_bytes);
  std::string when_full = "pause";
  keys.OneOf("spool", "when_full", {"pause", "drop_oldest"}, when_full);
  config.spool.pause_when_full = when_full == "pause";
  keys.Number("spool", "max_hours", 0.01, 1e5, config.spool.max_hours);
  keys.Flag("uplink", "coded", config.coded);
  keys.Flag("uplink", "live", config.live);
  if (absl::Status finished = keys.Finish(); !finished.ok()) return finished;
  if (absl::Status valid = config.spool.Validate(); !valid.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", valid.message()));
  }
  return config;
}

}  // namespace soundmap
