#include "mapping/drive_placement.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/angles.h"
#include "mapping/loop_closing.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;

// Scans that speak for a drive, and how many of them must agree.
constexpr int kProbes = 12;
constexpr int kMinVerified = 3;

// Surfaces around a probe.
constexpr double kAround_m = 3.0;
constexpr int kMaxScansAround = 6;
constexpr double kSpacing_voxels = 1.5;

// How far a starting pose that was given may be off.
constexpr double kNearStart_m = 1.5;
constexpr double kNearStart_rad = 0.4;

// A drive's own map is bent: a probe is found this near to where the others have it, and more by
// this part of its distance from the probe that the place comes from.
constexpr double kBent_m = 0.5;
constexpr double kBentOfWay = 0.05;
constexpr double kBent_rad = 0.1;

// Places further apart than this are different ones, of which one must hold so much less.
constexpr double kApart_m = 1.0;
constexpr double kApart_rad = geometry::RadFromDeg(10.0);
constexpr double kRival = 0.8;
// ... or leave so many more of the points without any surface near them.
constexpr double kUnexplained = 0.03;

struct Probe {
  int scan = 0;
  std::vector<Eigen::Vector3f> point_in_base;
};

Isometry3d OnFloor(const Isometry3d& pose) { return geometry::ProjectToFloor(pose).ToIsometry(); }

std::vector<Probe> MakeProbes(const KeyScanGraph& drive, double spacing_m) {
  std::vector<Probe> probes;
  const int scans = static_cast<int>(drive.scans.size());
  const int count = std::min(kProbes, scans);
  for (int i = 0; i < count; ++i) {
    const int scan = static_cast<int>((static_cast<std::int64_t>(i) * scans) / count);
    probes.push_back({scan, PointsAround(drive, scan, kAround_m, kMaxScansAround, spacing_m)});
  }
  return probes;
}

class Trial {
 public:
  Trial(const KeyScanGraph& drive, const std::vector<Probe>& probes, const PlaceVerifier& verifier)
      : drive_(drive), probes_(probes), verifier_(verifier) {}

  // What speaks for the place that puts probe `origin` at this pose.
  Placement Of(const Probe& origin, const Isometry3d& map_from_base) const {
    Placement placement;
    placement.map_from_drive = OnFloor(map_from_base * PoseOf(origin).inverse());
    for (const Probe& probe : probes_) {
      const Isometry3d expected = placement.map_from_drive * PoseOf(probe);
      const auto found = verifier_.FindNear(probe.point_in_base, expected);
      if (!found) continue;
      const Isometry3d off = expected.inverse() * found->map_from_base;
      const double way_m = (PoseOf(probe).translation() - PoseOf(origin).translation()).norm();
      if (off.translation().norm() > kBent_m + kBentOfWay * way_m ||
          Eigen::AngleAxisd(off.linear()).angle() > kBent_rad) {
        continue;
      }
      placement.verified.push_back({probe.scan, *found});
    }
    return placement;
  }

  bool Verified(const Placement& placement) const {
    return placement.verified.size() >=
           std::min<std::size_t>(kMinVerified, std::max<std::size_t>(probes_.size(), 1));
  }

 private:
  const Isometry3d& PoseOf(const Probe& probe) const {
    return drive_.scans[probe.scan].map_from_base;
  }

  const KeyScanGraph& drive_;
  const std::vector<Probe>& probes_;
  const PlaceVerifier& verifier_;
};

int Inliers(const Placement& placement) {
  int sum = 0;
  for (const Placement::Scan& scan : placement.verified) sum += scan.registration.inliers;
  return sum;
}

// Mean of the scans.
double Overlap(const Placement& placement) {
  double sum = 0.0;
  for (const Placement::Scan& scan : placement.verified) sum += scan.registration.overlap;
  return sum / static_cast<double>(placement.verified.size());
}

// At the places of the scans that were found with the first.
bool Same(const KeyScanGraph& drive, const Placement& a, const Placement& b) {
  const Isometry3d& base =
      drive.scans[a.verified.empty() ? 0 : a.verified.front().scan].map_from_base;
  const Isometry3d between = (a.map_from_drive * base).inverse() * (b.map_from_drive * base);
  return between.translation().norm() <= kApart_m &&
         Eigen::AngleAxisd(between.linear()).angle() <= kApart_rad;
}

}  // namespace

std::optional<Placement> PlaceDrive(const KeyScanGraph& drive, const SurfacePyramid& map,
                                    bool near_start) {
  if (drive.scans.empty() || map.levels().front().size() == 0) return std::nullopt;
  const std::vector<Probe> probes =
      MakeProbes(drive, kSpacing_voxels * map.levels().front().voxel_size_m());
  const PlaceVerifier verifier(map);
  const Trial trial(drive, probes, verifier);
  for (const bool near : {true, false}) {
    if (near && !near_start) continue;
    std::vector<Placement> placements;  // different ones
    for (const Probe& probe : probes) {
      const Isometry3d& start = drive.scans[probe.scan].map_from_base;
      const SearchWindow window = near ? SearchWindow{geometry::ProjectToFloor(start), kNearStart_m,
                                                      kNearStart_m, kNearStart_rad}
                                       : verifier.Everywhere();
      for (const Registration& place : verifier.FindAll(probe.point_in_base, window)) {
        Placement guess;
        guess.map_from_drive = OnFloor(place.map_from_base * start.inverse());
        guess.verified.push_back({probe.scan, place});
        const bool known =
            std::any_of(placements.begin(), placements.end(), [&](const Placement& other) {
              return Same(drive, guess, other) &&
                     std::any_of(other.verified.begin(), other.verified.end(),
                                 [&](const auto& scan) { return scan.scan == probe.scan; });
            });
        if (known) continue;
        Placement placement = trial.Of(probe, place.map_from_base);
        if (!placement.verified.empty()) placements.push_back(std::move(placement));
      }
      // A place at which nearly all are found needs no further proof.
      const bool sure =
          std::any_of(placements.begin(), placements.end(), [&](const Placement& placement) {
            return placement.verified.size() > 0.7 * probes.size() && trial.Verified(placement);
          });
      if (sure) break;
    }
    std::stable_sort(
        placements.begin(), placements.end(),
        [](const Placement& a, const Placement& b) { return Inliers(a) > Inliers(b); });
    if (placements.empty() || !trial.Verified(placements.front())) continue;
    const bool doubtful =
        std::any_of(placements.begin(), placements.end(), [&](const Placement& other) {
          return !Same(drive, placements.front(), other) &&
                 Inliers(other) > kRival * Inliers(placements.front()) &&
                 Overlap(other) > Overlap(placements.front()) - kUnexplained;
        });
    if (!doubtful) return placements.front();
  }
  return std::nullopt;
}

}  // namespace soundmap::mapping
