#include "localization/prepared_plan.h"

#include <utility>

namespace soundmap::localization {

absl::StatusOr<std::shared_ptr<const PreparedPlan>> PreparedPlan::Create(
    const Config& config, const building::FloorPlan& plan) {
  if (absl::Status status = config.Validate(); !status.ok()) return status;
  absl::StatusOr<BeamCaster> caster = BeamCaster::Create(plan, config.unknown_gap_m);
  if (!caster.ok()) return caster.status();
  const Eigen::Vector2d size_m = Eigen::Vector2d(plan.width(), plan.height()) * plan.cell_size_m();
  GlobalSearch search(config.search, plan);
  if (!search.has_free_cell()) {
    return absl::InvalidArgumentError("the floor plan has no free cell where a robot could be");
  }
  ScanMatcher matcher(config.refinement, plan, *caster);
  return std::make_shared<const PreparedPlan>(
      PreparedPlan{config,
                   {plan.origin_in_map_m(), plan.origin_in_map_m() + size_m},
                   *std::move(caster),
                   BeamModel(config.beam_model),
                   std::move(matcher),
                   std::move(search)});
}

}  // namespace soundmap::localization
