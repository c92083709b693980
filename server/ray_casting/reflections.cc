#include "ray_casting/reflections.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <optional>

#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

// The normal of a surface is known to some 2 degrees, and a mirror turns by twice that.
const double kNearImage = std::cos(geometry::RadFromDeg(6.0));
// As far as the LIDAR's points are apart.
const double kNearRay = std::cos(geometry::RadFromDeg(3.0));
constexpr double kPatch_m = 0.3;         // of a surface, around the end of a ray,
constexpr double kPatchPerRange = 0.08;  // wider far away
constexpr int kMostPoints = 48;          // of a patch that planes are laid through
constexpr int kLeastPoints = 6;          // of a plane
constexpr double kLeastShare = 0.4;      // of the patch: at an edge two planes share it
constexpr float kThickness_m = 0.03;     // of a plane: noise of the LIDAR and of the odometry
constexpr double kOnSurface_m = 0.3;     // such a source is its own image

struct Surface {
  Eigen::Vector3d point;                  // where the ray ends
  std::optional<Eigen::Vector3d> normal;  // none: not flat
};

// Of the planes through `points[0]` and two others the one that most points lie in, smoothed.
std::optional<Eigen::Vector3d> NormalOf(const std::vector<Eigen::Vector3f>& points) {
  const int count = static_cast<int>(points.size());
  const int step = std::max(1, count / kMostPoints);
  int most = 0;
  Eigen::Vector3f best = Eigen::Vector3f::Zero();
  for (int a = step; a < count; a += step) {
    // Not all pairs: each point with one about a quarter turn of the list away.
    for (const int b : {(a + count / 4) % count, (a + count / 3) % count}) {
      const Eigen::Vector3f across = (points[a] - points[0]).cross(points[b] - points[0]);
      const float area = across.norm();
      if (area < 0.005f) continue;
      const Eigen::Vector3f normal = across / area;
      int in_plane = 0;
      for (int i = 0; i < count; i += step) {
        in_plane += std::abs(normal.dot(points[i] - points[0])) < kThickness_m;
      }
      if (in_plane > most) {
        most = in_plane;
        best = normal;
      }
    }
  }
  if (most == 0) return std::nullopt;
  int in_plane = 0;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3f& point : points) {
    const Eigen::Vector3f offset = point - points[0];
    if (std::abs(best.dot(offset)) >= 1.5f * kThickness_m) continue;
    const Eigen::Vector3d in = offset.cast<double>();
    sum += in;
    squares += in * in.transpose();
    ++in_plane;
  }
  if (in_plane < kLeastPoints || in_plane < kLeastShare * count) return std::nullopt;
  const Eigen::Vector3d mean = sum / in_plane;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(squares / in_plane -
                                                            mean * mean.transpose());
  return axes.eigenvectors().col(0);
}

// On the axes of base_link at the LIDAR's reference time.
std::optional<Surface> SurfaceAlong(std::span<const Eigen::Vector3f> points,
                                    const Eigen::Vector3d& origin,
                                    const Eigen::Vector3d& direction) {
  const Eigen::Vector3f from = origin.cast<float>();
  const Eigen::Vector3f along = direction.cast<float>();
  // Of all points near the ray the one nearest to it.
  auto best = static_cast<float>(kNearRay);
  const Eigen::Vector3f* end = nullptr;
  for (const Eigen::Vector3f& point : points) {
    const Eigen::Vector3f way = point - from;
    const float ahead = way.dot(along);
    if (ahead <= 0.0f) continue;
    const float squared = way.squaredNorm();
    if (ahead * ahead <= best * best * squared) continue;
    best = ahead / std::sqrt(squared);
    end = &point;
  }
  if (end == nullptr) return std::nullopt;
  const double range_m = (*end - from).norm();
  const double patch_m = std::max(kPatch_m, kPatchPerRange * range_m);
  const auto reach2 = static_cast<float>(patch_m * patch_m);
  std::vector<Eigen::Vector3f> patch = {*end};
  for (const Eigen::Vector3f& point : points) {
    if ((point - *end).squaredNorm() <= reach2 && &point != end) patch.push_back(point);
  }
  return Surface{origin + range_m * direction, NormalOf(patch)};
}

}  // namespace

void MarkReflections(const LidarView& lidar, const Eigen::Isometry3d& base_from_array,
                     const std::optional<Eigen::Vector3d>& array_normal,
                     std::vector<acoustics::Peak>& peaks) {
  if (peaks.size() < 2) return;
  const Eigen::Isometry3d reference_from_array =
      lidar.reference_base_from_audio_base * base_from_array;
  const Eigen::Vector3d origin = reference_from_array.translation();
  std::vector<Eigen::Vector3d> emitters;  // what stronger peaks hear, or their images
  for (acoustics::Peak& peak : peaks) {
    std::vector<Eigen::Vector3d> directions = {peak.direction_in_array};
    if (array_normal) {
      directions.push_back(peak.direction_in_array -
                           2.0 * array_normal->dot(peak.direction_in_array) * *array_normal);
    }
    const std::size_t stronger = emitters.size();
    for (const Eigen::Vector3d& in_array : directions) {
      const Eigen::Vector3d direction = reference_from_array.linear() * in_array;
      const auto surface = SurfaceAlong(lidar.point_in_base, origin, direction);
      if (!surface) continue;
      Eigen::Vector3d emitter = surface->point;
      for (std::size_t i = 0; surface->normal && i < stronger; ++i) {
        const double height_m = (emitters[i] - surface->point).dot(*surface->normal);
        if (std::abs(height_m) < kOnSurface_m) continue;
        const Eigen::Vector3d image = emitters[i] - 2.0 * height_m * *surface->normal;
        if ((image - origin).normalized().dot(direction) < kNearImage) continue;
        peak.reflection = true;
        emitter = image;
        break;
      }
      emitters.push_back(emitter);
    }
  }
}

}  // namespace soundmap::ray_casting
