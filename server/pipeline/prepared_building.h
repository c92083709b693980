#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "building/building.h"
#include "localization/prepared_plan.h"
#include "pipeline/profile.h"
#include "ray_casting/ray_caster.h"

namespace soundmap::pipeline {

// What listening needs of a building, made once for all robots.
struct PreparedBuilding {
  std::shared_ptr<const localization::PreparedPlan> plan;
  ray_casting::Surroundings surroundings;

  // Errors: those of PreparedPlan::Create().
  static absl::StatusOr<std::shared_ptr<const PreparedBuilding>> Create(
      const Profile& profile, const building::Building& mapped);
};

}  // namespace soundmap::pipeline
