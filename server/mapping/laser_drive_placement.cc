#include "mapping/laser_drive_placement.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/angles.h"
#include "mapping/laser_lines.h"
#include "mapping/laser_matching.h"
#include "mapping/laser_points.h"
#include "mapping/laser_search.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

// Pieces of the drive that speak for it, of this length, and how many of them must agree.
constexpr int kProbes = 12;
constexpr double kProbe_m = 10.0;
constexpr std::size_t kMinVerified = 3;
constexpr float kProbePoints_m = 0.15f;

constexpr double kSearchCell_m = 0.2;
constexpr double kSearchReach_m = 12.0;
// How far a starting pose that was given may be off.
constexpr double kNearStart_m = 1.5;
constexpr double kNearStart_rad = 0.4;

constexpr double kMinScore = 0.6;
constexpr double kMinOverlap = 0.6;
constexpr double kMinFit = 0.7;
constexpr int kMinInliers = 60;
// Of what holds a piece across its walls, so much must hold it along them: one corridor is like
// another.
constexpr double kMinHeldAlong = 0.05;

// Walls of the map that a scan of the drive should see and sees through speak against a place. A
// beam passes a wall that it goes so much beyond, and is that wall's up to this angle from it.
constexpr int kScansOfProbe = 5;
constexpr float kMapPoints_m = 0.1f;
constexpr float kBeyond_m = 0.4f;
constexpr float kBeyondOfRange = 0.03f;
constexpr float kBeamApart_rad = 0.04f;
constexpr double kMaxSeenThrough = 0.2;

// A drive's own map is bent: a piece is found this near to where the others have it, and more by
// this part of its distance from the one that the place comes from.
constexpr double kBent_m = 0.5;
constexpr double kBentOfWay = 0.02;
constexpr double kBent_rad = 0.1;

// Places further apart than this are different ones, of which one must hold so much less.
constexpr double kApart_m = 1.0;
constexpr double kApart_rad = geometry::RadFromDeg(10.0);
constexpr double kRival = 0.8;

// What a scan saw, in the base_link of its probe: the bearings (increasing) and ranges of its
// beams.
struct View {
  Eigen::Vector2f laser_in_base;
  std::vector<std::pair<float, float>> beams;
};

struct Probe {
  Pose2 drive_from_base;
  std::vector<Eigen::Vector2f> point_in_base;
  std::vector<View> views;
};

struct Found {
  Pose2 map_from_drive;
  std::size_t verified = 0;
  int inliers = 0;
};

double Distance(const Pose2& a, const Pose2& b) { return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m); }

View ViewOf(const LaserPoints& points, const Eigen::Isometry2f& base_from_scan) {
  View view{base_from_scan * points.LaserInBase(points.point_in_base.size() / 2), {}};
  for (const Eigen::Vector2f& point : points.point_in_base) {
    const Eigen::Vector2f ray = base_from_scan * point - view.laser_in_base;
    view.beams.emplace_back(std::atan2(ray.y(), ray.x()), ray.norm());
  }
  std::sort(view.beams.begin(), view.beams.end());
  return view;
}

std::vector<Probe> MakeProbes(const std::vector<LaserKeyScan>& drive) {
  std::vector<Probe> probes;
  const std::size_t count = std::min<std::size_t>(kProbes, drive.size());
  for (std::size_t i = 0; i < count; ++i) {
    const LaserKeyScan& middle = drive[(2 * i + 1) * drive.size() / (2 * count)];
    Probe probe{middle.map_from_base, {}, {}};
    double seen_until_m = -1.0;
    for (const LaserKeyScan& scan : drive) {
      if (std::abs(scan.way_m - middle.way_m) > 0.5 * kProbe_m) continue;
      const Pose2 off = middle.map_from_base.Inverse() * scan.map_from_base;
      const Eigen::Isometry2f base_from_scan =
          Eigen::Translation2f(static_cast<float>(off.x_m), static_cast<float>(off.y_m)) *
          Eigen::Rotation2Df(static_cast<float>(off.yaw_rad));
      for (const Eigen::Vector2f& point : scan.point_to_match) {
        probe.point_in_base.push_back(base_from_scan * point);
      }
      if (scan.way_m >= seen_until_m) {
        probe.views.push_back(ViewOf(scan.points, base_from_scan));
        seen_until_m = scan.way_m + kProbe_m / kScansOfProbe;
      }
    }
    probe.point_in_base = FirstPointPerSquare(probe.point_in_base, kProbePoints_m);
    probes.push_back(std::move(probe));
  }
  return probes;
}

// Of the walls in view from the probe at a pose, the share that its beams pass.
double SeenThrough(const Probe& probe, std::span<const Eigen::Vector2f> point_in_map,
                   const Pose2& map_from_base) {
  const Eigen::Isometry2f base_from_map =
      (Eigen::Translation2f(static_cast<float>(map_from_base.x_m),
                            static_cast<float>(map_from_base.y_m)) *
       Eigen::Rotation2Df(static_cast<float>(map_from_base.yaw_rad)))
          .inverse();
  int seen = 0, through = 0;
  for (const Eigen::Vector2f& point : point_in_map) {
    const Eigen::Vector2f in_base = base_from_map * point;
    if (in_base.cwiseAbs().maxCoeff() > kSearchReach_m) continue;
    for (const View& view : probe.views) {
      const Eigen::Vector2f ray = in_base - view.laser_in_base;
      const float range_m = ray.norm();
      const float bearing_rad = std::atan2(ray.y(), ray.x());
      const auto after =
          std::lower_bound(view.beams.begin(), view.beams.end(), std::pair(bearing_rad, 0.0f));
      if (after == view.beams.begin() || after == view.beams.end()) continue;
      const auto before = std::prev(after);
      if (after->first - before->first > kBeamApart_rad) continue;
      // Along an edge one beam passes and the other does not.
      const auto [near_m, far_m] = std::minmax(before->second, after->second);
      const float tolerance_m = kBeyond_m + kBeyondOfRange * range_m;
      if (near_m > range_m + tolerance_m) {
        ++through;
      } else if (far_m >= range_m - tolerance_m) {
        ++seen;
      }
    }
  }
  return seen + through > 0 ? static_cast<double>(through) / (seen + through) : 1.0;
}

bool IsHeld(const LaserMatch& match) {
  const Eigen::Vector2d held = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(
                                   match.information.topLeftCorner<2, 2>(), Eigen::EigenvaluesOnly)
                                   .eigenvalues();
  return match.fit() >= kMinFit && match.overlap() >= kMinOverlap && match.inliers >= kMinInliers &&
         held[0] >= kMinHeldAlong * held[1];
}

LaserMatch MatchFrom(const Probe& probe, const LineMap& lines, const Pose2& map_from_base) {
  return MatchToLines(probe.point_in_base, lines, map_from_base,
                      {.start_distance_m = kBent_m, .prior_std_m = kBent_m, .prior_std_rad = 0.05});
}

// What speaks for the place that puts probe `origin` at this pose.
Found Try(const std::vector<Probe>& probes, const LineMap& lines,
          std::span<const Eigen::Vector2f> point_in_map, const Probe& origin,
          const Pose2& map_from_base) {
  Found found{map_from_base * origin.drive_from_base.Inverse()};
  for (const Probe& probe : probes) {
    const Pose2 expected = found.map_from_drive * probe.drive_from_base;
    const LaserMatch match = MatchFrom(probe, lines, expected);
    const Pose2 off = expected.Inverse() * match.map_from_base;
    const double way_m = Distance(probe.drive_from_base, origin.drive_from_base);
    if (!IsHeld(match) || std::hypot(off.x_m, off.y_m) > kBent_m + kBentOfWay * way_m ||
        std::abs(off.yaw_rad) > kBent_rad ||
        SeenThrough(probe, point_in_map, match.map_from_base) > kMaxSeenThrough) {
      continue;
    }
    ++found.verified;
    found.inliers += match.inliers;
  }
  return found;
}

// The place that most of the drive speaks for; none where another does nearly as well.
std::optional<Pose2> Best(std::vector<Found> places, const Probe& anywhere, std::size_t needed) {
  std::stable_sort(places.begin(), places.end(),
                   [](const Found& a, const Found& b) { return a.inliers > b.inliers; });
  if (places.empty() || places.front().verified < needed) return std::nullopt;
  const Pose2 best = places.front().map_from_drive * anywhere.drive_from_base;
  for (const Found& other : places) {
    const Pose2 off = best.Inverse() * (other.map_from_drive * anywhere.drive_from_base);
    const bool is_same =
        std::hypot(off.x_m, off.y_m) <= kApart_m && std::abs(off.yaw_rad) <= kApart_rad;
    if (!is_same && other.inliers > kRival * places.front().inliers) return std::nullopt;
  }
  return places.front().map_from_drive;
}

}  // namespace

std::optional<Pose2> PlaceLaserDrive(const std::vector<LaserKeyScan>& drive,
                                     std::span<const Eigen::Vector2f> point_in_map,
                                     double wall_piece_m, bool near_start) {
  if (drive.empty() || point_in_map.empty()) return std::nullopt;
  const std::vector<Probe> probes = MakeProbes(drive);
  const std::size_t needed = std::min(kMinVerified, probes.size());
  LineMap lines(wall_piece_m);
  lines.Insert(point_in_map);
  lines.FitLines();
  const LaserSearch search(point_in_map, kSearchCell_m);
  const std::vector<Eigen::Vector2f> thinned =
      FirstPointPerSquare({point_in_map.begin(), point_in_map.end()}, kMapPoints_m);
  Eigen::AlignedBox2f box;
  for (const Eigen::Vector2f& point : point_in_map) box.extend(point);
  for (const bool near : {true, false}) {
    if (near && !near_start) continue;
    std::vector<Found> places;
    for (const Probe& probe : probes) {
      const Pose2 start = near ? probe.drive_from_base : Pose2{box.center().x(), box.center().y()};
      LaserWindow window{.distance_m = kNearStart_m,
                         .angle_rad = kNearStart_rad,
                         .max_point_distance_m = kSearchReach_m};
      if (!near) {
        window.distance_m = 0.5 * box.sizes().maxCoeff();
        window.angle_rad = geometry::kPi;
      }
      const auto found = search.Find(probe.point_in_base, start, window, kMinScore);
      if (!found) continue;
      const LaserMatch match = MatchFrom(probe, lines, found->map_from_base);
      if (IsHeld(match)) places.push_back(Try(probes, lines, thinned, probe, match.map_from_base));
    }
    if (const auto place = Best(std::move(places), probes.front(), needed)) return place;
  }
  return std::nullopt;
}

}  // namespace soundmap::mapping
