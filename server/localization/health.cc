#include "localization/health.h"

#include <algorithm>
#include <cmath>

namespace soundmap::localization {
namespace {

// The scan fit does not rest on fewer than this share of the valid beams.
constexpr double kMinKnownShare = 0.2;

}  // namespace

double ScanFit(const std::vector<Beam>& beams, const geometry::Pose2& map_from_base,
               const BeamCaster& caster, const HealthConfig& config) {
  if (beams.empty()) return 0.0;
  const Eigen::Rotation2Dd rotation(map_from_base.yaw_rad);
  std::vector<Ray> rays;
  rays.reserve(beams.size());
  for (const Beam& beam : beams) {
    const Eigen::Vector2f origin =
        (Eigen::Vector2d(map_from_base.x_m, map_from_base.y_m) + rotation * beam.origin_in_base_m)
            .cast<float>();
    const Eigen::Vector2f direction = (rotation * beam.direction_in_base).cast<float>();
    rays.push_back({origin.x(), origin.y(), direction.x(), direction.y()});
  }
  std::vector<Return> expected(rays.size());
  caster.Cast(rays, expected);
  int known = 0;
  int explained = 0;
  for (std::size_t i = 0; i < beams.size(); ++i) {
    if (expected[i].ending != Ending::kWall) continue;
    ++known;
    const double tolerance_m =
        config.fit_tolerance_m + config.fit_tolerance_share * expected[i].range_m;
    explained += std::abs(beams[i].range_m - expected[i].range_m) <= tolerance_m;
  }
  return explained / std::max<double>(known, kMinKnownShare * static_cast<double>(beams.size()));
}

void Health::Begin(double scan_fit) { *this = {scan_fit, scan_fit}; }

void Health::Take(double scan_fit, double driven_m, bool is_usual, const HealthConfig& config) {
  mean_fit += (scan_fit - mean_fit) / config.fit_memory;
  if (is_usual) slow_fit += (scan_fit - slow_fit) / (config.fit_memory * config.slow_memory);
  chance_m = mean_fit < config.chance_fit ? chance_m + driven_m : 0.0;
  misfit_m += driven_m;
  if (mean_fit >= config.tracking_fit) {
    misfit_m = 0.0;
    misfit = false;
  } else if (mean_fit < config.lost_fit || misfit_m > config.lost_misfit_m) {
    misfit = true;
  }
}

bool Health::IsDoubtful(double scan_fit, const HealthConfig& config) const {
  return misfit || mean_fit < config.tracking_fit || mean_fit < config.usual_share * slow_fit ||
         scan_fit < config.sudden_share * slow_fit;
}

State Health::Judge(double scan_fit, const HealthConfig& config) const {
  if (misfit) return State::kLost;
  return std::min(scan_fit, mean_fit) < config.tracking_fit ? State::kUncertain : State::kTracking;
}

}  // namespace soundmap::localization
