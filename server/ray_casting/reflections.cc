#include "ray_casting/reflections.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <optional>

#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

// The normal of a surface is known to some 2 degrees, and a mirror turns by twice that.
constexpr double kNearImage_rad = geometry::RadFromDeg(6.0);
// As far as the LIDAR's points are apart.
constexpr double kNearRay_rad = geometry::RadFromDeg(3.0);
constexpr double kPatch_m = 0.3;         // of a surface, around the end of a ray,
constexpr double kPatchPerRange = 0.08;  // wider far away
constexpr int kPatches = 3;              // each twice as wide, until a plane shows
constexpr double kLeastWidth_m = 0.1;    // of a plane: the points of one ring lie in any
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
  if (axes.eigenvalues()[1] < kLeastWidth_m * kLeastWidth_m) return std::nullopt;
  return axes.eigenvectors().col(0);
}

// The LIDAR's points as seen from the array, on the axes of base_link at the LIDAR's reference
// time.
class View {
 public:
  View(std::span<const Eigen::Vector3f> points, const Eigen::Vector3d& origin)
      : points_(points),
        origin_(origin),
        unit_(points.size(), 3),
        cosine_(points.size()),
        largest_((static_cast<Eigen::Index>(points.size()) + kGroup - 1) / kGroup) {
    const Eigen::Map<const Eigen::Matrix3Xf> columns(points.data()->data(), 3, points.size());
    unit_ = (columns.colwise() - origin.cast<float>()).transpose();
    unit_.array().colwise() /= unit_.rowwise().norm().array().max(1e-6f);
  }

  // What the ray meets; none where no point is near it.
  std::optional<Surface> Along(const Eigen::Vector3d& direction) {
    const Eigen::Vector3f along = direction.cast<float>();
    cosine_.noalias() = unit_ * along;
    // The largest of each group tells where to look.
    float cosine = -2.0f;
    Eigen::Index nearest_group = 0;
    for (Eigen::Index g = 0; g < largest_.size(); ++g) {
      largest_[g] = cosine_.segment(g * kGroup, SizeOf(g)).maxCoeff();
      if (largest_[g] > cosine) {
        cosine = largest_[g];
        nearest_group = g;
      }
    }
    if (!(cosine > static_cast<float>(std::cos(kNearRay_rad)))) return std::nullopt;
    Eigen::Index nearest = nearest_group * kGroup;
    while (cosine_[nearest] != cosine) ++nearest;
    const Eigen::Vector3f& end = points_[nearest];
    const double range_m = (end.cast<double>() - origin_).norm();
    Surface surface{origin_ + range_m * direction, std::nullopt};
    double patch_m = std::max(kPatch_m, kPatchPerRange * range_m);
    for (int p = 0; p < kPatches && !surface.normal; ++p, patch_m *= 2.0) {
      surface.normal = NormalOf(Patch(nearest, range_m, patch_m));
    }
    return surface;
  }

 private:
  static constexpr Eigen::Index kGroup = 64;

  // A point and those around it, which are near the last ray.
  std::vector<Eigen::Vector3f> Patch(Eigen::Index centre, double range_m, double patch_m) const {
    const Eigen::Vector3f& end = points_[centre];
    // A point that far from the end of the ray is seen within this angle of it.
    const double widest_rad = std::asin(std::min(1.0, patch_m / range_m)) + kNearRay_rad;
    const auto least = static_cast<float>(std::cos(widest_rad));
    const auto reach2 = static_cast<float>(patch_m * patch_m);
    std::vector<Eigen::Vector3f> patch = {end};
    for (Eigen::Index g = 0; g < largest_.size(); ++g) {
      if (largest_[g] < least) continue;
      for (Eigen::Index i = g * kGroup; i < g * kGroup + SizeOf(g); ++i) {
        if (cosine_[i] < least || i == centre) continue;
        if ((points_[i] - end).squaredNorm() <= reach2) patch.push_back(points_[i]);
      }
    }
    return patch;
  }

  Eigen::Index SizeOf(Eigen::Index group) const {
    return std::min(kGroup, cosine_.size() - group * kGroup);
  }

  std::span<const Eigen::Vector3f> points_;
  Eigen::Vector3d origin_;
  Eigen::MatrixX3f unit_;
  Eigen::VectorXf cosine_;   // to the ray at hand
  Eigen::VectorXf largest_;  // of each group of points
};

}  // namespace

void MarkReflections(const LidarView& lidar, const Eigen::Isometry3d& base_from_array,
                     const std::optional<Eigen::Vector3d>& array_normal,
                     std::vector<acoustics::Peak>& peaks) {
  if (peaks.empty() || lidar.point_in_base.empty()) return;
  const Eigen::Isometry3d reference_from_array =
      lidar.reference_base_from_audio_base * base_from_array;
  const Eigen::Vector3d origin = reference_from_array.translation();
  std::optional<Eigen::Vector3d> normal;
  if (array_normal) normal = reference_from_array.linear() * *array_normal;
  View view(lidar.point_in_base, origin);
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
      const auto surface = view.Along(direction);
      if (!surface) continue;
      if (surface->normal && &in_array == &directions.front()) {
        const double towards = surface->normal->dot(direction) < 0.0 ? 1.0 : -1.0;
        peak.surface_normal_in_array =
            towards * (reference_from_array.linear().transpose() * *surface->normal);
      }
      Eigen::Vector3d emitter = surface->point;
      for (std::size_t i = 0; surface->normal && i < stronger; ++i) {
        const double height_m = (emitters[i] - surface->point).dot(*surface->normal);
        const double array_height_m = (origin - surface->point).dot(*surface->normal);
        // Both stand before the mirror.
        if (std::abs(height_m) < kOnSurface_m || height_m * array_height_m < 0.0) continue;
        const Eigen::Vector3d image = emitters[i] - 2.0 * height_m * *surface->normal;
        Eigen::Vector3d off = (image - origin).normalized() - direction;
        if (normal) off -= normal->dot(off) * *normal;
        if (off.norm() > kNearImage_rad) continue;
        peak.reflection = true;
        emitter = image;
        break;
      }
      emitters.push_back(emitter);
    }
  }
}

}  // namespace soundmap::ray_casting
