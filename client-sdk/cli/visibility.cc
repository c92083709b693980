#include "cli/visibility.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace soundmap::cli {
namespace {

constexpr double kSurfaceToleranceM = 0.02;
constexpr std::int64_t kMinTimeInViewNs = 5'000'000'000;
constexpr std::int64_t kMaxGapNs = 1'000'000'000;
constexpr double kMinBaselineM = 1.0;
constexpr double kSamePositionM = 0.001;

using Axes = std::array<double, 3>;

Axes AxesOf(const Vector3& v) { return {v.x, v.y, v.z}; }

double Distance(const Vector3& a, const Vector3& b) {
  return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z);
}

bool Contains(const Box& box, const Vector3& point) {
  const Axes min = AxesOf(box.min_m), max = AxesOf(box.max_m), p = AxesOf(point);
  for (int i = 0; i < 3; ++i) {
    if (p[i] < min[i] || p[i] > max[i]) return false;
  }
  return true;
}

// The box without its surface: a thin one keeps its middle half.
Box Interior(const Box& box) {
  Axes min = AxesOf(box.min_m), max = AxesOf(box.max_m);
  for (int i = 0; i < 3; ++i) {
    const double margin = std::min(kSurfaceToleranceM, 0.25 * (max[i] - min[i]));
    min[i] += margin;
    max[i] -= margin;
  }
  return {{min[0], min[1], min[2]}, {max[0], max[1], max[2]}};
}

// Slab test: the parameters s in [0, 1] at which begin + s (end - begin) lies between each pair of
// planes must have one in common.
bool SegmentMeetsBox(const Vector3& begin, const Vector3& end, const Box& box) {
  const Axes a = AxesOf(begin), b = AxesOf(end), min = AxesOf(box.min_m), max = AxesOf(box.max_m);
  double enter = 0.0, leave = 1.0;
  for (int i = 0; i < 3; ++i) {
    const double step = b[i] - a[i];
    if (step == 0.0) {
      if (a[i] < min[i] || a[i] > max[i]) return false;
      continue;
    }
    const double s0 = (min[i] - a[i]) / step, s1 = (max[i] - a[i]) / step;
    enter = std::max(enter, std::min(s0, s1));
    leave = std::min(leave, std::max(s0, s1));
  }
  return enter <= leave;
}

// Whether two of the positions seen so far lie kMinBaselineM apart.
class Baseline {
 public:
  void Add(const Vector3& position) {
    if (long_enough_) return;
    if (!positions_.empty() && Distance(positions_.back(), position) < kSamePositionM) return;
    for (const Vector3& earlier : positions_) {
      // Positions 1 m apart on paper differ by rounding.
      long_enough_ = long_enough_ || Distance(earlier, position) >= kMinBaselineM - 1e-9;
    }
    positions_.push_back(position);
  }
  bool long_enough() const { return long_enough_; }

 private:
  std::vector<Vector3> positions_;
  bool long_enough_ = false;
};

bool InView(const TrueSource& source, const SceneTruth& scene,
            const std::vector<ArrayPosition>& path, std::int64_t drive_start_ns,
            double max_range_m) {
  Baseline baseline;
  std::int64_t time_in_view_ns = 0;
  bool was_visible = false;
  for (std::size_t i = 0; i < path.size(); ++i) {
    const auto time_ns = static_cast<double>(path[i].time_ns - drive_start_ns);
    const bool visible = (!source.on_s || time_ns >= *source.on_s * 1e9) &&
                         (!source.off_s || time_ns <= *source.off_s * 1e9) &&
                         Distance(path[i].in_map_m, source.position_in_map_m) <= max_range_m &&
                         IsUnobstructed(path[i].in_map_m, source.position_in_map_m, scene);
    if (visible) {
      baseline.Add(path[i].in_map_m);
      if (was_visible && path[i].time_ns - path[i - 1].time_ns <= kMaxGapNs) {
        time_in_view_ns += path[i].time_ns - path[i - 1].time_ns;
      }
      if (baseline.long_enough() && time_in_view_ns >= kMinTimeInViewNs) return true;
    }
    was_visible = visible;
  }
  return false;
}

}  // namespace

std::vector<ArrayPosition> ArrayPath(const std::vector<StampedPose>& map_from_base,
                                     const Vector3& array_in_base_m) {
  std::vector<ArrayPosition> path;
  path.reserve(map_from_base.size());
  for (const StampedPose& stamped : map_from_base) {
    const Pose2& pose = stamped.map_from_base;
    const double c = std::cos(pose.yaw_rad), s = std::sin(pose.yaw_rad);
    path.push_back({stamped.time_ns,
                    {pose.x_m + c * array_in_base_m.x - s * array_in_base_m.y,
                     pose.y_m + s * array_in_base_m.x + c * array_in_base_m.y, array_in_base_m.z}});
  }
  return path;
}

bool IsUnobstructed(const Vector3& array_in_map_m, const Vector3& source_in_map_m,
                    const SceneTruth& scene) {
  if (scene.room_size_m) {
    const double t = kSurfaceToleranceM;
    const Vector3& size = *scene.room_size_m;
    const Box room{{-t, -t, -t}, {size.x + t, size.y + t, size.z + t}};
    if (!Contains(room, array_in_map_m) || !Contains(room, source_in_map_m)) return false;
  }
  return std::none_of(scene.obstacles.begin(), scene.obstacles.end(), [&](const Box& obstacle) {
    const Box interior = Interior(obstacle);
    return !Contains(interior, source_in_map_m) &&
           SegmentMeetsBox(array_in_map_m, source_in_map_m, interior);
  });
}

std::vector<bool> SourcesInView(const SceneTruth& scene, const std::vector<ArrayPosition>& path,
                                std::int64_t drive_start_ns, double max_range_m) {
  std::vector<bool> in_view;
  for (const TrueSource& source : scene.sources) {
    in_view.push_back(InView(source, scene, path, drive_start_ns, max_range_m));
  }
  return in_view;
}

absl::StatusOr<std::vector<bool>> SourcesInView(const SceneTruth& scene, const DriveTruth& drive,
                                                double max_range_m, const std::string& recording) {
  if (drive.map_from_base.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat(recording, " has no /ground_truth/pose to compare with"));
  }
  if (!drive.array_in_base_m) {
    return absl::FailedPreconditionError(
        absl::StrCat(recording, " does not say in /tf_static where mic_array is mounted"));
  }
  if (!(max_range_m > 0.0)) {
    return absl::FailedPreconditionError("the server does not say the range of the site");
  }
  return SourcesInView(scene, ArrayPath(drive.map_from_base, *drive.array_in_base_m),
                       drive.start_ns, max_range_m);
}

}  // namespace soundmap::cli
