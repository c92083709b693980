#include "pipeline/prepared_building.h"

#include <utility>

namespace soundmap::pipeline {

absl::StatusOr<std::shared_ptr<const PreparedBuilding>> PreparedBuilding::Create(
    const Profile& profile, const building::Building& mapped) {
  auto plan = localization::PreparedPlan::Create(profile.localization, mapped.floor_plan);
  if (!plan.ok()) return plan.status();
  auto prepared = std::make_shared<PreparedBuilding>();
  prepared->plan = *std::move(plan);
  if (mapped.octree != nullptr) {
    prepared->surroundings = {mapped.octree,
                              std::make_shared<const building::FreeSpace>(mapped.octree)};
  }
  return prepared;
}

}  // namespace soundmap::pipeline
