#include "localization/scan_matcher.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

// A LIDAR's wall is up to this many noisy layers of cells; its line runs between them. A wall of
// more layers is solid, as in a drawn plan: its line is the face of the first layer.
constexpr int kMaxLayers = 3;

constexpr int kMinCellsOfPiece = 4;
// Of the variances across and along a piece; two layers of nine cells have 0.04, a right corner
// about 0.4.
constexpr double kMaxFlatness = 0.12;
constexpr int kMinBeams = 20;
constexpr double kMinShareOfBeams = 0.3;
constexpr double kConverged_m = 1e-5;

// Layer of each wall cell: 1 where a beam can reach it, ... up to kMaxLayers + 1 for all behind; 0:
// not a wall.
std::vector<std::uint8_t> WallLayers(const building::FloorPlan& plan, const BeamCaster& caster) {
  std::vector<std::uint8_t> layers(plan.cells().size(), 0);
  for (int y = 0; y < plan.height(); ++y) {
    for (int x = 0; x < plan.width(); ++x) {
      if (caster.block(x, y) != BeamCaster::Block::kWall) continue;
      int layer = kMaxLayers + 1;
      for (int v = -kMaxLayers; v <= kMaxLayers; ++v) {
        for (int u = -kMaxLayers; u <= kMaxLayers; ++u) {
          if (plan.Contains(x + u, y + v) &&
              caster.block(x + u, y + v) == BeamCaster::Block::kNone) {
            layer = std::min(layer, std::max(std::abs(u), std::abs(v)));
          }
        }
      }
      layers[static_cast<std::size_t>(y) * plan.width() + x] = static_cast<std::uint8_t>(layer);
    }
  }
  return layers;
}

struct Line {
  Eigen::Vector2d point;
  Eigen::Vector2d normal;
};

// Through the points, by their principal axes; none when they do not lie along a line.
std::optional<Line> FitLine(const std::vector<Eigen::Vector2d>& points) {
  if (points.size() < kMinCellsOfPiece) return std::nullopt;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& point : points) mean += point;
  mean /= static_cast<double>(points.size());
  Eigen::Matrix2d squares = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& point : points) {
    squares += (point - mean) * (point - mean).transpose();
  }
  const double half_trace = 0.5 * squares.trace();
  const double spread = std::hypot(0.5 * (squares(0, 0) - squares(1, 1)), squares(0, 1));
  if (half_trace - spread > kMaxFlatness * (half_trace + spread)) return std::nullopt;
  const double along_rad = 0.5 * std::atan2(2.0 * squares(0, 1), squares(0, 0) - squares(1, 1));
  return Line{mean, {-std::sin(along_rad), std::cos(along_rad)}};
}

}  // namespace

ScanMatcher::ScanMatcher(const RefinementConfig& config, const building::FloorPlan& plan,
                         const BeamCaster& caster)
    : config_(config),
      width_(plan.width()),
      height_(plan.height()),
      cell_size_m_(plan.cell_size_m()),
      cells_per_m_(1.0 / plan.cell_size_m()),
      origin_in_map_m_(plan.origin_in_map_m()),
      nearest_piece_(static_cast<std::size_t>(plan.width()) * plan.height(), -1) {
  const auto index = [this](int x, int y) { return static_cast<std::size_t>(y) * width_ + x; };
  const std::vector<std::uint8_t> layers = WallLayers(plan, caster);

  const int radius_cells =
      std::max(1, static_cast<int>(std::lround(config.line_radius_m / cell_size_m_)));
  const int gate_cells = static_cast<int>(std::ceil(config.gate_m / cell_size_m_));
  std::vector<int> nearest_distance2(nearest_piece_.size(), std::numeric_limits<int>::max());
  std::vector<Eigen::Vector2d> wall;
  std::vector<Eigen::Vector2d> face;
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const int layer = layers[index(x, y)];
      if (layer == 0 || layer > kMaxLayers) continue;
      wall.clear();
      face.clear();
      Eigen::Vector2d behind_sum = Eigen::Vector2d::Zero();
      int behind = 0;
      for (int v = -radius_cells; v <= radius_cells; ++v) {
        for (int u = -radius_cells; u <= radius_cells; ++u) {
          if (u * u + v * v > radius_cells * radius_cells || !plan.Contains(x + u, y + v)) continue;
          const Eigen::Vector2d offset(u, v);
          switch (layers[index(x + u, y + v)]) {
            case 0:
              break;
            case 1:
              face.push_back(offset);
              [[fallthrough]];
            default:
              wall.push_back(offset);
              break;
            case kMaxLayers + 1:
              behind_sum += offset;
              ++behind;
              break;
          }
        }
      }
      const bool solid = behind > 0;
      if (solid && layer != 1) continue;
      const auto line = FitLine(solid ? face : wall);
      if (!line) continue;
      Eigen::Vector2d point = line->point;
      if (solid) {
        const double side = line->normal.dot(behind_sum / behind - point) > 0.0 ? 1.0 : -1.0;
        point -= 0.5 * side * line->normal;
      }
      const auto piece = static_cast<std::int32_t>(pieces_.size());
      pieces_.push_back(
          {origin_in_map_m_ + (Eigen::Vector2d(x + 0.5, y + 0.5) + point) * cell_size_m_,
           line->normal});
      for (int v = -gate_cells; v <= gate_cells; ++v) {
        for (int u = -gate_cells; u <= gate_cells; ++u) {
          if (!plan.Contains(x + u, y + v)) continue;
          const int distance2 = u * u + v * v;
          const std::size_t i = index(x + u, y + v);
          if (distance2 <= gate_cells * gate_cells && distance2 < nearest_distance2[i]) {
            nearest_distance2[i] = distance2;
            nearest_piece_[i] = piece;
          }
        }
      }
    }
  }
}

const ScanMatcher::WallPiece* ScanMatcher::Nearest(const Eigen::Vector2d& point_in_map_m) const {
  const Eigen::Vector2d cell = (point_in_map_m - origin_in_map_m_) * cells_per_m_;
  if (!(cell.x() >= 0.0 && cell.y() >= 0.0 && cell.x() < width_ && cell.y() < height_)) {
    return nullptr;
  }
  const std::int32_t piece = nearest_piece_[static_cast<std::size_t>(cell.y()) * width_ +
                                            static_cast<std::size_t>(cell.x())];
  return piece < 0 ? nullptr : &pieces_[piece];
}

std::optional<Distribution> ScanMatcher::Match(const std::vector<Beam>& beams,
                                               const Distribution& prior) const {
  // A floor keeps a prior that has collapsed from holding the pose in a wrong place.
  const Eigen::Matrix3d floor = Eigen::Vector3d(4e-4, 4e-4, 1e-4).asDiagonal();
  const Eigen::Matrix3d prior_information =
      (config_.prior_scale * config_.prior_scale * prior.covariance + floor).inverse();
  const double beam_information =
      1.0 / (config_.beam_correlation * config_.range_std_m * config_.range_std_m);

  std::vector<Eigen::Vector2d> ends_in_base_m;
  ends_in_base_m.reserve(beams.size());
  for (const Beam& beam : beams) {
    ends_in_base_m.push_back(beam.origin_in_base_m + beam.range_m * beam.direction_in_base);
  }
  geometry::Pose2 pose = prior.mean;
  Eigen::Matrix3d information = prior_information;
  for (int iteration = 0; iteration < config_.max_iterations; ++iteration) {
    const double c = std::cos(pose.yaw_rad);
    const double s = std::sin(pose.yaw_rad);
    // Tukey's weights vanish at this distance; it shrinks while the pose settles.
    const double reach_m =
        std::max(0.4 * config_.gate_m, config_.gate_m * std::pow(0.8, iteration));
    const Eigen::Vector3d from_prior(pose.x_m - prior.mean.x_m, pose.y_m - prior.mean.y_m,
                                     geometry::NormalizeAngle(pose.yaw_rad - prior.mean.yaw_rad));
    // The upper triangle and the gradient, number by number: they stay in registers.
    double xx = 0.0, xy = 0.0, xt = 0.0, yy = 0.0, yt = 0.0, tt = 0.0;
    double gx = 0.0, gy = 0.0, gt = 0.0;
    int used = 0;
    for (const Eigen::Vector2d& end_in_base : ends_in_base_m) {
      const Eigen::Vector2d arm(c * end_in_base.x() - s * end_in_base.y(),
                                s * end_in_base.x() + c * end_in_base.y());
      const Eigen::Vector2d end_in_map(pose.x_m + arm.x(), pose.y_m + arm.y());
      const WallPiece* piece = Nearest(end_in_map);
      if (piece == nullptr) continue;
      const double distance_m = piece->normal.dot(end_in_map - piece->point_in_map_m);
      const double share = distance_m / reach_m;
      if (std::abs(share) >= 1.0) continue;
      const double root = 1.0 - share * share;
      const double weight = root * root;
      const double nx = piece->normal.x();
      const double ny = piece->normal.y();
      const double nt = ny * arm.x() - nx * arm.y();  // by the turn
      const double wx = weight * nx;
      const double wy = weight * ny;
      const double wt = weight * nt;
      xx += wx * nx;
      xy += wx * ny;
      xt += wx * nt;
      yy += wy * ny;
      yt += wy * nt;
      tt += wt * nt;
      gx += wx * distance_m;
      gy += wy * distance_m;
      gt += wt * distance_m;
      ++used;
    }
    Eigen::Matrix3d of_beams;
    of_beams << xx, xy, xt, xy, yy, yt, xt, yt, tt;
    information = prior_information + beam_information * of_beams;
    const Eigen::Vector3d gradient =
        prior_information * from_prior + beam_information * Eigen::Vector3d(gx, gy, gt);
    if (used < kMinBeams || used < kMinShareOfBeams * static_cast<double>(beams.size())) {
      return std::nullopt;
    }
    const Eigen::Vector3d step = -information.ldlt().solve(gradient);
    if (!step.allFinite()) return std::nullopt;
    pose = {pose.x_m + step.x(), pose.y_m + step.y(),
            geometry::NormalizeAngle(pose.yaw_rad + step.z())};
    if (step.norm() < kConverged_m) break;
  }
  if (std::hypot(pose.x_m - prior.mean.x_m, pose.y_m - prior.mean.y_m) > config_.max_shift_m ||
      std::abs(geometry::NormalizeAngle(pose.yaw_rad - prior.mean.yaw_rad)) >
          config_.max_turn_rad) {
    return std::nullopt;
  }
  return Distribution{pose, information.inverse()};
}

}  // namespace soundmap::localization
