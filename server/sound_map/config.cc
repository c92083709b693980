#include "sound_map/config.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "sound_map/support_field.h"

namespace soundmap::sound_map {
namespace {

absl::Status Wrong(const char* field, double value, absl::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("the sound map's ", field, " is ", value, ", but ", what));
}

bool IsIn(double value, double min, double max) { return value >= min && value <= max; }

}  // namespace

absl::Status SoundSourceConfig::Validate() const {
  if (!IsIn(max_sources, 1, 100'000)) {
    return Wrong("max_sources", max_sources, "must be 1 to 100000");
  }
  if (!IsIn(max_voxels, 1, 10'000'000)) {
    return Wrong("max_voxels", max_voxels, "must be 1 to 10000000");
  }
  if (!IsIn(max_seeds, 1, 100'000)) return Wrong("max_seeds", max_seeds, "must be 1 to 100000");
  if (!IsIn(max_iterations, 1, 10'000)) {
    return Wrong("max_iterations", max_iterations, "must be 1 to 10000");
  }
  if (!IsIn(smoothing_sigma_m, 1e-3, 1.0)) {
    return Wrong("smoothing_sigma_m", smoothing_sigma_m, "must be 0.001 to 1");
  }
  if (!IsIn(separation_m, 0.0, 100.0)) {
    return Wrong("separation_m", separation_m, "must be 0 to 100");
  }
  if (!IsIn(core_radius_m, 1e-3, 10.0)) {
    return Wrong("core_radius_m", core_radius_m, "must be 0.001 to 10");
  }
  if (!IsIn(background_share, 1e-6, 0.999)) {
    return Wrong("background_share", background_share, "must be 0.000001 to 0.999");
  }
  if (!IsIn(even_evidence, 1e-3, 1e6)) {
    return Wrong("even_evidence", even_evidence, "must be 0.001 to 1000000");
  }
  if (!IsIn(evidence_power, 0.1, 100.0)) {
    return Wrong("evidence_power", evidence_power, "must be 0.1 to 100");
  }
  if (!IsIn(masking_radius_m, 1e-3, 100.0)) {
    return Wrong("masking_radius_m", masking_radius_m, "must be 0.001 to 100");
  }
  if (!IsIn(masking_share, 0.0, 1.0))
    return Wrong("masking_share", masking_share, "must be 0 to 1");
  if (!IsIn(view_point_spacing_m, 1e-3, 100.0)) {
    return Wrong("view_point_spacing_m", view_point_spacing_m, "must be 0.001 to 100");
  }
  if (!IsIn(gone_after_s, 1.0, 1e9)) {
    return Wrong("gone_after_s", gone_after_s, "must be 1 to 1000000000");
  }
  if (!IsIn(history_days, 0.01, 36'500.0)) {
    return Wrong("history_days", history_days, "must be 0.01 to 36500");
  }
  return absl::OkStatus();
}

absl::Status SoundMapConfig::Validate() const {
  if (!IsIn(voxel_size_m, 1e-3, 10.0)) {
    return Wrong("voxel_size_m", voxel_size_m, "must be 0.001 to 10");
  }
  if (!IsIn(min_log_odds, -1e6, 0.0) || min_log_odds == 0.0) {
    return Wrong("min_log_odds", min_log_odds, "must be below 0 and finite");
  }
  if (!IsIn(max_log_odds, 0.0, 1e6) || max_log_odds == 0.0) {
    return Wrong("max_log_odds", max_log_odds, "must be above 0 and finite");
  }
  if (sources.smoothing_sigma_m > SupportField::kMaxSigma_voxels * voxel_size_m) {
    return Wrong("smoothing_sigma_m", sources.smoothing_sigma_m,
                 absl::StrCat("must be at most ", SupportField::kMaxSigma_voxels,
                              " times the voxels' size"));
  }
  return sources.Validate();
}

SoundMapConfig PaperConfig() {
  SoundMapConfig config;
  config.stop_rule = StopRule::kFreeze;
  config.min_log_odds = -40.0;
  config.max_log_odds = 40.0;
  config.sources.method = SourceMethod::kKMeans;
  config.sources.min_updates = 0;
  config.sources.judge_by_views = false;
  return config;
}

SoundMapConfig DefaultConfig() { return {}; }

}  // namespace soundmap::sound_map
