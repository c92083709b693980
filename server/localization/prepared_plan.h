#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "building/floor_plan.h"
#include "localization/beam_caster.h"
#include "localization/beam_model.h"
#include "localization/config.h"
#include "localization/global_search.h"
#include "localization/scan_matcher.h"

namespace soundmap::localization {

// A floor plan made ready for localization. Immutable; all robots on the plan share it. Some 20
// bytes a cell, 7 a cell of the search, and, with the default beam model, 12 MB.
struct PreparedPlan {
  // InvalidArgument: a parameter out of range, a plan without walls or free cells, or too large.
  static absl::StatusOr<std::shared_ptr<const PreparedPlan>> Create(
      const Config& config, const building::FloorPlan& plan);

  Config config;
  Eigen::AlignedBox2d bounds_in_map_m;
  BeamCaster caster;
  BeamModel model;
  ScanMatcher matcher;
  GlobalSearch search;
};

}  // namespace soundmap::localization
