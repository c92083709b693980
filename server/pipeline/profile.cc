#include "pipeline/profile.h"

#include <algorithm>
#include <array>
#include <optional>
#include <set>
#include <sstream>
#include <type_traits>
#include <variant>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "geometry/angles.h"
#include "pipeline/toml.h"

namespace soundmap::pipeline {
namespace {

// Names of an enumeration's values, in order from 0.
template <typename Enum>
struct EnumNames;
template <>
struct EnumNames<ray_casting::RangeSource> {
  static constexpr const char* kNames[] = {"lidar", "map"};
};
template <>
struct EnumNames<ray_casting::SharedVoxel> {
  static constexpr const char* kNames[] = {"each", "once"};
};
template <>
struct EnumNames<sound_map::StopRule> {
  static constexpr const char* kNames[] = {"freeze", "clamp"};
};
template <>
struct EnumNames<sound_map::SourceMethod> {
  static constexpr const char* kNames[] = {"k_means", "smooth_peak"};
};

// Writes each parameter that it visits into a table.
class TomlWriter {
 public:
  void Section(const char* name) {
    section_ = table.insert_or_assign(name, toml::table{}).first->second.as_table();
  }
  template <typename Value>
  void operator()(const char* key, const Value& value) {
    if constexpr (std::is_enum_v<Value>) {
      section_->insert(key, EnumNames<Value>::kNames[static_cast<int>(value)]);
    } else if constexpr (std::is_integral_v<Value> && !std::is_same_v<Value, bool>) {
      section_->insert(key, static_cast<std::int64_t>(value));
    } else {
      section_->insert(key, value);
    }
  }
  template <typename Value>
  void operator()(const char* key, const std::optional<Value>& value) {
    if (value) (*this)(key, *value);
  }
  void Angle(const char* key, double& angle_rad) { (*this)(key, geometry::DegFromRad(angle_rad)); }
  // Which alternative a variant holds, by name.
  template <typename... Alternatives>
  void Choice(const char* key, std::variant<Alternatives...>& value,
              const std::array<const char*, sizeof...(Alternatives)>& names) {
    (*this)(key, std::string(names[value.index()]));
  }

  toml::table table;

 private:
  toml::table* section_ = nullptr;
};

// Takes the parameters that a table has, and remembers what is wrong with it.
class TomlReader {
 public:
  explicit TomlReader(const toml::table& table) : table_(table) {}

  void Section(const char* name) { section_ = name; }
  template <typename Value>
  void operator()(const char* key, Value& value) {
    const toml::node* node = Find(key);
    if (node == nullptr) return;
    if constexpr (std::is_enum_v<Value>) {
      int index = 0;
      for (const char* name : EnumNames<Value>::kNames) {
        if (node->value<std::string>() == name) {
          value = static_cast<Value>(index);
          return;
        }
        ++index;
      }
      Refuse(key);
    } else if constexpr (std::is_same_v<Value, bool>) {
      Take(key, node->value_exact<bool>(), value);
    } else if constexpr (std::is_integral_v<Value>) {
      const std::optional<std::int64_t> number = node->value_exact<std::int64_t>();
      if (!number || !std::in_range<Value>(*number)) {
        Refuse(key);
      } else {
        value = static_cast<Value>(*number);
      }
    } else {
      // value() would take true for 1.
      Take(key, node->is_boolean() ? std::nullopt : node->value<Value>(), value);
    }
  }
  template <typename Value>
  void operator()(const char* key, std::optional<Value>& value) {
    if (Find(key) == nullptr) return;
    Value present{};
    (*this)(key, present);
    value = present;
  }
  void Angle(const char* key, double& angle_rad) {
    if (Find(key) == nullptr) return;
    double angle_deg = 0.0;
    (*this)(key, angle_deg);
    angle_rad = geometry::RadFromDeg(angle_deg);
  }
  template <typename... Alternatives>
  void Choice(const char* key, std::variant<Alternatives...>& value,
              const std::array<const char*, sizeof...(Alternatives)>& names) {
    const toml::node* node = Find(key);
    if (node == nullptr) return;
    const auto named = std::find(names.begin(), names.end(), node->value<std::string>());
    if (named == names.end()) {
      Refuse(key);
      return;
    }
    const auto chosen = static_cast<std::size_t>(named - names.begin());
    if (chosen == value.index()) return;
    std::size_t index = 0;
    (void)((index++ == chosen && (value = Alternatives{}, true)) || ...);
  }

  // After every parameter was visited: what the table has beyond them is an error.
  absl::Status status() const {
    if (!status_.ok()) return status_;
    for (const auto& [section, node] : table_) {
      if (!node.is_table()) continue;
      for (const auto& [key, value] : *node.as_table()) {
        const std::string path =
            absl::StrCat(std::string(section.str()), ".", std::string(key.str()));
        if (!visited_.contains(path)) {
          return absl::InvalidArgumentError(absl::StrCat("the parameter ", path, " is not known"));
        }
      }
    }
    return absl::OkStatus();
  }

 private:
  const toml::node* Find(const char* key) {
    visited_.insert(absl::StrCat(section_, ".", key));
    const toml::table* section = table_[section_].as_table();
    return section == nullptr ? nullptr : section->get(key);
  }
  template <typename Value>
  void Take(const char* key, const std::optional<Value>& found, Value& value) {
    if (found) {
      value = *found;
    } else {
      Refuse(key);
    }
  }
  void Refuse(const char* key) {
    if (!status_.ok()) return;
    status_ = absl::InvalidArgumentError(
        absl::StrCat("the parameter ", section_, ".", key, " has a value of the wrong kind"));
  }

  const toml::table& table_;
  const char* section_ = "";
  std::set<std::string> visited_;
  absl::Status status_;
};

// Every parameter of the profile, once: its place in the file and in the code.
template <typename Visitor>
void VisitAcoustics(Visitor& v, acoustics::AcousticsConfig& c) {
  v.Section("acoustics");
  v("window_s", c.window_s);
  v("window_samples", c.window_samples);
  v("frames_per_scan", c.frames_per_scan);
  v("f_min_hz", c.f_min_hz);
  v("f_max_hz", c.f_max_hz);
  v("speed_of_sound_mps", c.speed_of_sound_mps);
  v.Choice("grid", c.grid, {"equal_area", "sector"});
  if (auto* grid = std::get_if<acoustics::EqualAreaGrid>(&c.grid)) {
    v.Angle("grid_spacing_deg", grid->spacing_rad);
  } else if (auto* sector = std::get_if<acoustics::SectorGrid>(&c.grid)) {
    v.Angle("grid_azimuth_min_deg", sector->azimuth_min_rad);
    v.Angle("grid_azimuth_max_deg", sector->azimuth_max_rad);
    v.Angle("grid_elevation_min_deg", sector->elevation_min_rad);
    v.Angle("grid_elevation_max_deg", sector->elevation_max_rad);
    v.Angle("grid_step_deg", sector->step_rad);
  }
  v.Choice("evidence", c.evidence, {"peaks", "double_threshold", "scaled_power"});
  if (auto* peaks = std::get_if<acoustics::PeakEvidence>(&c.evidence)) {
    v("threshold_spreads", peaks->threshold_spreads);
    v("threshold_incoherent_spreads", peaks->threshold_incoherent_spreads);
    v("faint_spreads", peaks->faint_spreads);
    v("faint_incoherent_spreads", peaks->faint_incoherent_spreads);
    v("max_peaks", peaks->max_peaks);
    v.Angle("peak_radius_deg", peaks->peak_radius_rad);
    v.Angle("undecided_radius_deg", peaks->undecided_radius_rad);
    v("p_peak", peaks->p_peak);
    v("p_undecided", peaks->p_undecided);
    v("p_rest", peaks->p_rest);
  } else if (auto* thresholds = std::get_if<acoustics::DoubleThreshold>(&c.evidence)) {
    v("t1", thresholds->t1);
    v("t2", thresholds->t2);
    v("p_min", thresholds->p_min);
    v("p_med", thresholds->p_med);
    v("p_max", thresholds->p_max);
  } else if (auto* scaled = std::get_if<acoustics::ScaledPower>(&c.evidence)) {
    v("p_min", scaled->p_min);
    v("p_max", scaled->p_max);
  }
}

template <typename Visitor>
void VisitLocalization(Visitor& v, localization::Config& c) {
  v.Section("localization");
  v("particles", c.particles);
  v("correction_distance_m", c.correction_distance_m);
  v.Angle("correction_turn_deg", c.correction_turn_rad);
  v("beams", c.beams);
  v("min_beams", c.min_beams);
  v("tempering", c.tempering);
  v("resample_below", c.resample_below);
  v("min_range_m", c.min_range_m);
  v("laser_lag_s", c.laser_lag_s);
  v("unknown_gap_m", c.unknown_gap_m);
  v("max_speed_mps", c.max_speed_mps);
  v("max_turn_rate_radps", c.max_turn_rate_radps);
  v("jump_position_std_m", c.jump_position_std_m);
  v.Angle("jump_yaw_std_deg", c.jump_yaw_std_rad);
  v("max_waiting_scans", c.max_waiting_scans);
  v.Section("motion_noise");
  v("rotation_from_rotation", c.motion.rotation_from_rotation);
  v("rotation_from_translation_rad2_per_m2", c.motion.rotation_from_translation);
  v("translation_from_translation", c.motion.translation_from_translation);
  v("translation_from_rotation_m2_per_rad2", c.motion.translation_from_rotation);
  v("floor_position_m", c.motion.floor_position_m);
  v.Angle("floor_yaw_deg", c.motion.floor_yaw_rad);
  v.Section("beam_model");
  v("hit_weight", c.beam_model.hit_weight);
  v("short_weight", c.beam_model.short_weight);
  v("max_weight", c.beam_model.max_weight);
  v("random_weight", c.beam_model.random_weight);
  v("hit_std_m", c.beam_model.hit_std_m);
  v("short_rate_per_m", c.beam_model.short_rate_per_m);
  v("max_range_m", c.beam_model.max_range_m);
  v("resolution_m", c.beam_model.resolution_m);
  v.Section("refinement");
  v("enabled", c.refinement.enabled);
  v("line_radius_m", c.refinement.line_radius_m);
  v("gate_m", c.refinement.gate_m);
  v("range_std_m", c.refinement.range_std_m);
  v("beam_correlation", c.refinement.beam_correlation);
  v("prior_scale", c.refinement.prior_scale);
  v("max_shift_m", c.refinement.max_shift_m);
  v.Angle("max_turn_deg", c.refinement.max_turn_rad);
  v("max_iterations", c.refinement.max_iterations);
  v.Section("health");
  v("fit_tolerance_m", c.health.fit_tolerance_m);
  v("fit_tolerance_share", c.health.fit_tolerance_share);
  v("fit_memory", c.health.fit_memory);
  v("tracking_fit", c.health.tracking_fit);
  v("lost_fit", c.health.lost_fit);
  v("tracking_position_std_m", c.health.tracking_position_std_m);
  v.Angle("tracking_yaw_std_deg", c.health.tracking_yaw_std_rad);
  v("slow_memory", c.health.slow_memory);
  v("usual_share", c.health.usual_share);
  v("sudden_share", c.health.sudden_share);
  v("lost_misfit_m", c.health.lost_misfit_m);
  v("chance_fit", c.health.chance_fit);
  v("lost_chance_m", c.health.lost_chance_m);
  v("lost_position_std_m", c.health.lost_position_std_m);
  v("tracking_travel_m", c.health.tracking_travel_m);
  v("lost_travel_m", c.health.lost_travel_m);
  v.Section("search");
  v("enabled", c.search.enabled);
  v("cell_m", c.search.cell_m);
  v("field_std_m", c.search.field_std_m);
  v.Angle("yaw_step_deg", c.search.yaw_step_rad);
  v("max_range_m", c.search.max_range_m);
  v("sectors", c.search.sectors);
  v("max_points", c.search.max_points);
  v("max_evaluations", c.search.max_evaluations);
  v("max_candidates", c.search.max_candidates);
  v("min_score", c.search.min_score);
  v("window_m", c.search.window_m);
  v("window_step_m", c.search.window_step_m);
  v("apart_m", c.search.apart_m);
  v.Angle("apart_deg", c.search.apart_rad);
  v("scatter_m", c.search.scatter_m);
  v.Angle("scatter_deg", c.search.scatter_rad);
  v("hypothesis_particles", c.search.hypothesis_particles);
  v("max_hypotheses", c.search.max_hypotheses);
  v("evidence_travel_m", c.search.evidence_travel_m);
  v("recent_travel_m", c.search.recent_travel_m);
  v("min_lead", c.search.min_lead);
  v("min_lead_m", c.search.min_lead_m);
  v("carried_lead_m", c.search.carried_lead_m);
  v("give_up_margin", c.search.give_up_margin);
  v("min_fit", c.search.min_fit);
  v("min_travel_m", c.search.min_travel_m);
  v("max_kept_scans", c.search.max_kept_scans);
  v("look_back_scans", c.search.look_back_scans);
  v.Section("adaptive_particles");
  v("enabled", c.adaptive.enabled);
  v("min_particles", c.adaptive.min_particles);
  v("max_particles", c.adaptive.max_particles);
  v("bin_m", c.adaptive.bin_m);
  v.Angle("bin_deg", c.adaptive.bin_rad);
  v("max_divergence", c.adaptive.max_divergence);
  v("quantile", c.adaptive.quantile);
}

template <typename Visitor>
void VisitSoundMap(Visitor& v, sound_map::SoundMapConfig& c) {
  v.Section("sound_map");
  v("voxel_size_m", c.voxel_size_m);
  v("stop_rule", c.stop_rule);
  v("min_log_odds", c.min_log_odds);
  v("max_log_odds", c.max_log_odds);
  v.Section("sound_sources");
  v("method", c.sources.method);
  v("min_updates", c.sources.min_updates);
  v("max_sources", c.sources.max_sources);
  v("max_voxels", c.sources.max_voxels);
  v("max_seeds", c.sources.max_seeds);
  v("max_iterations", c.sources.max_iterations);
  v("smoothing_sigma_m", c.sources.smoothing_sigma_m);
  v("background_share", c.sources.background_share);
  v("even_evidence", c.sources.even_evidence);
  v("evidence_power", c.sources.evidence_power);
  v("judge_by_views", c.sources.judge_by_views);
  v("separation_m", c.sources.separation_m);
  v("masking_radius_m", c.sources.masking_radius_m);
  v("masking_share", c.sources.masking_share);
  v("core_radius_m", c.sources.core_radius_m);
  v("min_evidence", c.sources.min_evidence);
  v("view_point_spacing_m", c.sources.view_point_spacing_m);
  v("gone_after_s", c.sources.gone_after_s);
  v("history_days", c.sources.history_days);
}

template <typename Visitor>
void VisitOccupancy(Visitor& v, mapping::OccupancyConfig& c) {
  v("hit_log_odds", c.hit_log_odds);
  v("miss_log_odds", c.miss_log_odds);
  v("min_log_odds", c.min_log_odds);
  v("max_log_odds", c.max_log_odds);
  v("max_blocks", c.max_blocks);
}

template <typename Visitor>
void VisitFloorPlanMapping(Visitor& v, mapping::FloorPlanMapperConfig& c) {
  v.Section("floor_plan_mapping");
  v("cell_size_m", c.cell_size_m);
  v("min_range_m", c.min_range_m);
  v("max_range_m", c.max_range_m);
  v("laser_lag_s", c.laser_lag_s);
  v("key_scan_distance_m", c.key_scan_distance_m);
  v.Angle("key_scan_angle_deg", c.key_scan_angle_rad);
  v("key_scans_per_place", c.key_scans_per_place);
  v("wall_piece_m", c.wall_piece_m);
  v("local_map_m", c.local_map_m);
  v("stretch_m", c.stretch_m);
  v("loop_search_m", c.loop_search_m);
  v("loop_search_per_m", c.loop_search_per_m);
  v("max_loop_search_m", c.max_loop_search_m);
  v("relaxation_passes", c.relaxation_passes);
  v("max_speed_mps", c.max_speed_mps);
  v("max_turn_rate_radps", c.max_turn_rate_radps);
  v.Section("floor_plan_occupancy");
  VisitOccupancy(v, c.occupancy);
}

template <typename Visitor>
void VisitMapping(Visitor& v, mapping::MapperConfig& c, building::PointCloudConfig& import) {
  v.Section("mapping");
  v("voxel_size_m", c.voxel_size_m);
  v("min_range_m", c.min_range_m);
  v("max_range_m", c.max_range_m);
  v("slice_half_thickness_m", c.slice_half_thickness_m);
  v("slice_height_m", c.slice_height_m);
  v("slice_height_without_lrf_m", c.slice_height_without_lrf_m);
  v("surface_voxel_size_m", c.surface_voxel_size_m);
  v("key_scan_distance_m", c.key_scan_distance_m);
  v.Angle("key_scan_angle_deg", c.key_scan_angle_rad);
  v("key_scans_per_place", c.key_scans_per_place);
  v("relaxation_passes", c.relaxation_passes);
  v("max_speed_mps", c.max_speed_mps);
  v("max_turn_rate_radps", c.max_turn_rate_radps);
  v.Section("occupancy");
  VisitOccupancy(v, c.occupancy);
  v.Section("import");
  v("voxel_size_m", import.voxel_size_m);
  v("floor_height_m", import.floor_height_m);
  v("floor_tolerance_m", import.floor_tolerance_m);
  v("air_height_m", import.air_height_m);
  v("floor_gap_m", import.floor_gap_m);
  v("slice_min_height_m", import.slice_min_height_m);
  v("slice_max_height_m", import.slice_max_height_m);
}

template <typename Visitor>
void Visit(Visitor& v, Profile& profile) {
  VisitAcoustics(v, profile.acoustics);
  VisitLocalization(v, profile.localization);
  v.Section("ray_casting");
  v("range", profile.ray_casting.range);
  v("voxel_size_m", profile.ray_casting.voxel_size_m);
  v("max_range_m", profile.ray_casting.max_range_m);
  v("max_angle_deg", profile.ray_casting.max_angle_deg);
  v("shared_voxel", profile.ray_casting.shared_voxel);
  v("evidence_in_free_space", profile.ray_casting.evidence_in_free_space);
  v("max_lidar_age_s", profile.ray_casting.max_lidar_age_s);
  VisitSoundMap(v, profile.sound_map);
  v.Section("fusion");
  v("pose_wait_s", profile.fusion.pose_wait_s);
  v("lidar_wait_s", profile.fusion.lidar_wait_s);
  v("doubt_wait_s", profile.fusion.doubt_wait_s);
  VisitMapping(v, profile.mapping, profile.import);
  VisitFloorPlanMapping(v, profile.floor_plan_mapping);
}

}  // namespace

absl::Status Profile::Validate() const {
  for (const absl::Status& status :
       {acoustics.Validate(), localization.Validate(), ray_casting.Validate(), sound_map.Validate(),
        mapping.Validate(), floor_plan_mapping.Validate(), import.Validate()}) {
    if (!status.ok()) return status;
  }
  if (ray_casting.voxel_size_m != sound_map.voxel_size_m) {
    return absl::InvalidArgumentError(
        "ray_casting.voxel_size_m and sound_map.voxel_size_m must be equal");
  }
  if (!(fusion.pose_wait_s >= 0.0 && fusion.pose_wait_s <= 10.0) ||
      !(fusion.lidar_wait_s >= 0.0 && fusion.lidar_wait_s <= 10.0)) {
    return absl::InvalidArgumentError(
        "fusion.pose_wait_s and fusion.lidar_wait_s must be from 0 to 10 seconds");
  }
  if (!(fusion.doubt_wait_s >= 0.0 && fusion.doubt_wait_s <= 600.0)) {
    return absl::InvalidArgumentError("fusion.doubt_wait_s must be from 0 to 600 seconds");
  }
  return absl::OkStatus();
}

absl::StatusOr<Profile> ProfileByName(const std::string& name) {
  Profile profile;
  profile.name = name;
  if (name == "default") {
    profile.acoustics = acoustics::AcousticsConfig::Default();
    profile.localization = localization::DefaultConfig();
    profile.ray_casting = ray_casting::DefaultConfig();
    profile.sound_map = sound_map::DefaultConfig();
    return profile;
  }
  if (name == "paper") {
    profile.acoustics = acoustics::AcousticsConfig::Paper();
    profile.localization = localization::PaperConfig();
    profile.ray_casting = ray_casting::PaperConfig();
    profile.sound_map = sound_map::PaperConfig();
    return profile;
  }
  return absl::InvalidArgumentError(
      absl::StrCat("the profile '", name, "' is not known; there are 'default' and 'paper'"));
}

std::string ToToml(const Profile& profile) {
  TomlWriter writer;
  writer.table.insert("profile", profile.name);
  Profile visited = profile;
  Visit(writer, visited);
  std::ostringstream text;
  text << writer.table << '\n';
  return std::move(text).str();
}

absl::StatusOr<Profile> ProfileFromToml(const std::string& text) {
  const toml::parse_result parsed = toml::parse(text);
  if (!parsed) {
    std::ostringstream where;
    where << parsed.error();
    return absl::InvalidArgumentError(absl::StrCat("the parameters are not TOML: ", where.str()));
  }
  const toml::table& table = parsed.table();
  auto profile = ProfileByName(table["profile"].value_or(std::string("default")));
  if (!profile.ok()) return profile.status();
  TomlReader reader(table);
  Visit(reader, *profile);
  const absl::Status read = reader.status();
  if (!read.ok()) return read;
  const absl::Status valid = profile->Validate();
  if (!valid.ok()) return valid;
  return profile;
}

}  // namespace soundmap::pipeline
