#include "mapping/laser_drive_placement.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/angles.h"
#include "mapping/laser_lines.h"
#include "mapping/laser_matching.h"
#include "mapping/laser_plan.h"
#include "mapping/laser_points.h"
#include "mapping/laser_search.h"
#include "mapping/planar_poses.h"

namespace soundmap::mapping {
namespace {

using building::Cell;
using geometry::Pose2;

// Places are looked for with so many stretches of the drive, several for each: in a building of
// rooms that resemble each other the right one is not always the best.
constexpr int kProbes = 12;
constexpr double kProbe_m = 10.0;
constexpr int kPlacesOfProbe = 6;
constexpr double kMinShare = 0.7;
constexpr double kMinScore = 0.6;
constexpr double kSearchCell_m = 0.2;
constexpr double kSearchReach_m = 12.0;
// How far a starting pose that was given may be off.
constexpr double kNearStart_m = 1.5;
constexpr double kNearStart_rad = 0.4;

// And they are weighed with pieces of the way, all or so many of them, spread evenly. Three must
// fit the walls.
constexpr int kMaxPieces = 60;
constexpr double kPiece_m = 3.0;
constexpr int kMinSupport = 3;
constexpr double kSureShare = 0.7;
constexpr float kPoints_m = 0.15f;
constexpr double kMinOverlap = 0.6;
constexpr double kMinFit = 0.7;
constexpr int kMinInliers = 60;
// Of what holds a piece across its walls, so much must hold it along them: one corridor is like
// another.
constexpr double kMinHeldAlong = 0.05;

// What beams from known free space speak: for a place where they end at a wall of the plan, against
// it where they pass one or end in what was free. Of a wall that they graze they say nothing.
constexpr int kScansOfPiece = 3;
constexpr std::size_t kBeamsOfScan = 90;
constexpr float kTolerance_m = 0.3f;
constexpr float kToleranceOfRange = 0.02f;
constexpr float kMinSteepness = 0.35f;
// Doors, people, furniture that was moved, and what is not where a bent drive has it.
constexpr double kMaxAgainst = 0.2;

// A drive's own map is bent: a piece is found this near to where the last one that was found has
// it, and more by this part of the way between them.
constexpr double kBent_m = 0.5;
constexpr double kBentOfWay = 0.03;
constexpr double kMaxBent_m = 2.0;
constexpr double kBent_rad = 0.1;

// Places further apart than this are different ones, of which one must be spoken for so much less.
constexpr double kApart_m = 2.0;
constexpr double kApart_rad = geometry::RadFromDeg(10.0);
constexpr double kRival = 0.5;

struct Beam {
  Eigen::Vector2f begin_in_base;
  Eigen::Vector2f end_in_base;
};

// A part of the drive's way, seen from its middle.
struct Stretch {
  double way_m = 0.0;
  Pose2 drive_from_base;
  std::vector<Eigen::Vector2f> point_in_base;
  std::vector<Beam> beams;
};

std::vector<Stretch> Stretches(const std::vector<LaserKeyScan>& drive, int max_count,
                               double length_m) {
  std::vector<Stretch> stretches;
  const double way_m = drive.back().way_m - drive.front().way_m;
  const int count = std::clamp(static_cast<int>(way_m / length_m), 1, max_count);
  auto middle = drive.begin();
  for (int i = 0; i < count; ++i) {
    const double middle_m = drive.front().way_m + (i + 0.5) * way_m / count;
    while (middle + 1 != drive.end() && middle->way_m < middle_m) ++middle;
    Stretch stretch{middle->way_m, middle->map_from_base, {}, {}};
    double beams_until_m = -1.0;
    for (const LaserKeyScan& scan : drive) {
      if (std::abs(scan.way_m - middle->way_m) > 0.5 * length_m) continue;
      const Eigen::Isometry2f base_from_scan =
          InPlane(middle->map_from_base.Inverse() * scan.map_from_base);
      for (const Eigen::Vector2f& point : scan.point_to_match) {
        stretch.point_in_base.push_back(base_from_scan * point);
      }
      if (scan.way_m < beams_until_m) continue;
      beams_until_m = scan.way_m + length_m / kScansOfPiece;
      const std::size_t beams = scan.points.point_in_base.size();
      for (std::size_t beam = 0; beam < beams; beam += 1 + beams / kBeamsOfScan) {
        stretch.beams.push_back({base_from_scan * scan.points.LaserInBase(beam),
                                 base_from_scan * scan.points.point_in_base[beam]});
      }
    }
    stretch.point_in_base = FirstPointPerSquare(stretch.point_in_base, kPoints_m);
    stretches.push_back(std::move(stretch));
  }
  return stretches;
}

// Of the piece nearest along the way.
std::size_t Nearest(const std::vector<Stretch>& pieces, const Stretch& stretch) {
  const auto nearest = std::min_element(
      pieces.begin(), pieces.end(), [&stretch](const Stretch& a, const Stretch& b) {
        return std::abs(a.way_m - stretch.way_m) < std::abs(b.way_m - stretch.way_m);
      });
  return static_cast<std::size_t>(nearest - pieces.begin());
}

// Where a drive may lie: bent, so one pose of it for each of its pieces.
struct Place {
  std::size_t origin = 0;  // the piece that it was found with
  std::vector<Pose2> map_from_drive;
  int support = 0;  // pieces
  int beams_for = 0;
  int beams_against = 0;

  bool IsPossible() const {
    return support >= kMinSupport && beams_against <= kMaxAgainst * (beams_for + beams_against);
  }
  // Whether it has a stretch at this pose.
  bool Has(std::size_t piece, const Stretch& stretch, const Pose2& map_from_base) const {
    const Pose2 off = map_from_base.Inverse() * (map_from_drive[piece] * stretch.drive_from_base);
    return std::hypot(off.x_m, off.y_m) <= kApart_m && std::abs(off.yaw_rad) <= kApart_rad;
  }
};

// What of a drive is compared with.
class Target {
 public:
  Target(const building::FloorPlan& plan, double wall_piece_m)
      : plan_(plan),
        walls_(WallPoints(plan)),
        lines_(wall_piece_m),
        search_(walls_, kSearchCell_m) {
    lines_.Insert(walls_);
    lines_.FitLines();
    for (const Eigen::Vector2f& point : walls_) box_.extend(point);
  }

  LaserWindow Everywhere(Pose2& centre) const {
    centre = {box_.center().x(), box_.center().y()};
    return {.distance_m = 0.5 * box_.sizes().maxCoeff(),
            .angle_rad = geometry::kPi,
            .max_point_distance_m = kSearchReach_m};
  }
  std::vector<LaserSearchResult> Find(const Stretch& probe, const Pose2& start,
                                      const LaserWindow& window) const {
    return search_.FindSeveral(probe.point_in_base, start, window, kMinScore, kMinShare,
                               kPlacesOfProbe);
  }
  LaserMatch Match(const Stretch& stretch, const Pose2& map_from_base) const {
    return MatchToLines(
        stretch.point_in_base, lines_, map_from_base,
        {.start_distance_m = kBent_m, .prior_std_m = kBent_m, .prior_std_rad = 0.05});
  }
  // The place that puts piece `origin` where this pose of the drive has it.
  Place Weigh(const std::vector<Stretch>& pieces, std::size_t origin,
              const Pose2& map_from_drive) const;

 private:
  enum class Says { kNothing, kFor, kAgainst };
  Says Ask(const Eigen::Vector2f& begin, const Eigen::Vector2f& end) const;
  // The pieces from `begin` on, `step` by `step`; each from where the last that was found has it.
  void Follow(const std::vector<Stretch>& pieces, std::size_t begin, int step, Pose2 map_from_drive,
              Place& place) const;
  bool Fits(const LaserMatch& match, const Pose2& expected, double bent_m) const;
  Cell At(const Pose2& pose) const {
    return At(Eigen::Vector2d(pose.x_m, pose.y_m).cast<float>().eval());
  }
  Cell At(const Eigen::Vector2f& point) const {
    const Eigen::Vector2d cell =
        (point.cast<double>() - plan_.origin_in_map_m()) / plan_.cell_size_m();
    const int column = static_cast<int>(std::floor(cell.x()));
    const int row = static_cast<int>(std::floor(cell.y()));
    return plan_.Contains(column, row) ? plan_.at(column, row) : Cell::kUnknown;
  }

  const building::FloorPlan& plan_;
  std::vector<Eigen::Vector2f> walls_;
  LineMap lines_;
  LaserSearch search_;
  Eigen::AlignedBox2f box_;
};

Target::Says Target::Ask(const Eigen::Vector2f& begin, const Eigen::Vector2f& end) const {
  const float range_m = (end - begin).norm();
  if (!(range_m > 0.0f) || At(begin) != Cell::kFree) return Says::kNothing;
  const Eigen::Vector2f direction = (end - begin) / range_m;
  const float tolerance_m = kTolerance_m + kToleranceOfRange * range_m;
  const auto step_m = static_cast<float>(plan_.cell_size_m());
  for (float way_m = step_m; way_m <= range_m + tolerance_m; way_m += step_m) {
    const Eigen::Vector2f point = begin + way_m * direction;
    const Cell cell = At(point);
    if (cell == Cell::kUnknown) return Says::kNothing;
    if (cell == Cell::kFree) continue;
    if (way_m >= range_m - tolerance_m) return Says::kFor;
    const LinePiece* wall = lines_.At(point);
    const bool grazed =
        !wall || !wall->has_line() || std::abs(wall->normal.dot(direction)) < kMinSteepness;
    return grazed ? Says::kNothing : Says::kAgainst;
  }
  return Says::kAgainst;
}

bool IsHeldAlong(const LaserMatch& match) {
  const Eigen::Vector2d held = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(
                                   match.information.topLeftCorner<2, 2>(), Eigen::EigenvaluesOnly)
                                   .eigenvalues();
  return held[0] >= kMinHeldAlong * held[1];
}

bool Target::Fits(const LaserMatch& match, const Pose2& expected, double bent_m) const {
  const Pose2 off = expected.Inverse() * match.map_from_base;
  return std::hypot(off.x_m, off.y_m) <= bent_m && std::abs(off.yaw_rad) <= kBent_rad &&
         match.fit() >= kMinFit && match.overlap() >= kMinOverlap && match.inliers >= kMinInliers;
}

void Target::Follow(const std::vector<Stretch>& pieces, std::size_t begin, int step,
                    Pose2 map_from_drive, Place& place) const {
  double found_m = pieces[begin].way_m;
  for (std::size_t i = begin; i < pieces.size(); i += step) {  // below 0 it wraps
    const Stretch& piece = pieces[i];
    const Pose2 expected = map_from_drive * piece.drive_from_base;
    const double bent_m =
        std::min(kBent_m + kBentOfWay * std::abs(piece.way_m - found_m), kMaxBent_m);
    LaserMatch match = Match(piece, expected);
    bool fits = Fits(match, expected, bent_m);
    if (!fits && At(expected) == Cell::kFree) {
      const auto found = search_.Find(
          piece.point_in_base, expected,
          {.distance_m = bent_m, .angle_rad = kBent_rad, .max_point_distance_m = kSearchReach_m},
          kMinScore);
      if (found) match = Match(piece, found->map_from_base);
      fits = found && Fits(match, expected, bent_m);
    }
    if (fits) {
      map_from_drive = match.map_from_base * piece.drive_from_base.Inverse();
      found_m = piece.way_m;
    }
    const Eigen::Isometry2f map_from_piece = InPlane(map_from_drive * piece.drive_from_base);
    int beams_for = 0;
    for (const Beam& beam : piece.beams) {
      const Says says = Ask(map_from_piece * beam.begin_in_base, map_from_piece * beam.end_in_base);
      beams_for += says == Says::kFor;
      place.beams_against += says == Says::kAgainst;
    }
    place.map_from_drive[i] = map_from_drive;
    place.beams_for += beams_for;
    place.support +=
        fits && IsHeldAlong(match) && 2 * beams_for > static_cast<int>(piece.beams.size());
  }
}

Place Target::Weigh(const std::vector<Stretch>& pieces, std::size_t origin,
                    const Pose2& map_from_drive) const {
  Place place{origin, std::vector<Pose2>(pieces.size())};
  Follow(pieces, origin, 1, map_from_drive, place);
  if (origin > 0) Follow(pieces, origin - 1, -1, place.map_from_drive[origin], place);
  return place;
}

// None where nothing holds the drive, or where another place does nearly as well. As it lies at its
// start.
std::optional<Pose2> Best(std::vector<Place> places, const std::vector<Stretch>& pieces) {
  std::erase_if(places, [](const Place& place) { return !place.IsPossible(); });
  if (places.empty()) return std::nullopt;
  const Place& best =
      *std::max_element(places.begin(), places.end(),
                        [](const Place& a, const Place& b) { return a.beams_for < b.beams_for; });
  for (const Place& other : places) {
    const Stretch& origin = pieces[other.origin];
    const Pose2 there = other.map_from_drive[other.origin] * origin.drive_from_base;
    if (other.beams_for > kRival * best.beams_for && !best.Has(other.origin, origin, there)) {
      return std::nullopt;
    }
  }
  return best.map_from_drive.front();
}

}  // namespace

std::optional<Pose2> PlaceLaserDrive(const std::vector<LaserKeyScan>& drive,
                                     const building::FloorPlan& plan, double wall_piece_m,
                                     bool near_start) {
  if (drive.empty()) return std::nullopt;
  const Target target(plan, wall_piece_m);
  const std::vector<Stretch> probes = Stretches(drive, kProbes, kProbe_m);
  const std::vector<Stretch> pieces = Stretches(drive, kMaxPieces, kPiece_m);
  const Pose2& begin = drive.front().map_from_base;
  for (const bool near : {true, false}) {
    if (near && !near_start) continue;
    std::vector<Place> places;
    for (const Stretch& probe : probes) {
      const std::size_t nearest = Nearest(pieces, probe);
      Pose2 start = probe.drive_from_base;
      // Where it was turned at the start, it is moved further on.
      LaserWindow window{
          .distance_m = kNearStart_m + kNearStart_rad * Distance(begin, probe.drive_from_base),
          .angle_rad = kNearStart_rad,
          .max_point_distance_m = kSearchReach_m};
      if (!near) window = target.Everywhere(start);
      for (const LaserSearchResult& found : target.Find(probe, start, window)) {
        const Pose2 at = target.Match(probe, found.map_from_base).map_from_base;
        const bool is_known = std::any_of(places.begin(), places.end(), [&](const Place& known) {
          return known.Has(nearest, probe, at);
        });
        if (is_known) continue;
        places.push_back(target.Weigh(pieces, nearest, at * probe.drive_from_base.Inverse()));
      }
      // A place where nearly all of the drive fits needs no further proof.
      const bool is_sure = std::any_of(places.begin(), places.end(), [&](const Place& place) {
        return place.IsPossible() &&
               place.support > kSureShare * static_cast<double>(pieces.size());
      });
      if (is_sure) break;
    }
    if (const auto place = Best(std::move(places), pieces)) return place;
  }
  return std::nullopt;
}

}  // namespace soundmap::mapping
