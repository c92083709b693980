#include "mapping/pose_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

constexpr float kCell_m = 0.25f;
// Steps of the search: half of what a cell and its neighbours forgive.
constexpr double kStep_m = 0.35;
constexpr double kStep_rad = geometry::RadFromDeg(4.0);
constexpr std::size_t kMaxPoints = 300;
constexpr float kMaxVerticalNormal = 0.5f;
constexpr double kApart_m = 1.0;
constexpr double kApart_rad = geometry::RadFromDeg(15.0);
// More cells than this are no building.
constexpr double kMaxCells = 1e8;
// Guesses kept before those beside a better one are left out.
constexpr std::size_t kMaxGuesses = 4000;

std::vector<Eigen::Vector2f> SteepPlaces(const SurfaceMap& map) {
  std::vector<Eigen::Vector2f> places;
  for (const Surfel& surfel : map.surfels()) {
    if (surfel.has_plane() && std::abs(surfel.normal.z()) <= kMaxVerticalNormal) {
      places.push_back(surfel.mean.head<2>());
    }
  }
  return places;
}

}  // namespace

PoseSearch::PoseSearch(const SurfaceMap& map) {
  const std::vector<Eigen::Vector2f> places = SteepPlaces(map);
  if (places.empty()) return;
  Eigen::Vector2f min_m = places.front(), max_m = places.front();
  for (const Eigen::Vector2f& place : places) {
    min_m = min_m.cwiseMin(place);
    max_m = max_m.cwiseMax(place);
  }
  origin_m_ = min_m - Eigen::Vector2f::Constant(2 * kCell_m);
  const Eigen::Vector2f size = (max_m - origin_m_) / kCell_m;
  if (static_cast<double>(size.x() + 3) * (size.y() + 3) > kMaxCells) return;
  width_ = static_cast<int>(size.x()) + 3;
  height_ = static_cast<int>(size.y()) + 3;
  cells_.assign(static_cast<std::size_t>(width_) * height_, 0);
  for (const Eigen::Vector2f& place : places) {
    const Eigen::Vector2f cell = (place - origin_m_) / kCell_m;
    for (int row = static_cast<int>(cell.y()) - 1; row <= static_cast<int>(cell.y()) + 1; ++row) {
      for (int column = static_cast<int>(cell.x()) - 1; column <= static_cast<int>(cell.x()) + 1;
           ++column) {
        cells_[static_cast<std::size_t>(row) * width_ + column] = 1;
      }
    }
  }
}

SearchWindow PoseSearch::Everywhere() const {
  const double half_width_m = 0.5 * width_ * kCell_m;
  const double half_height_m = 0.5 * height_ * kCell_m;
  return {{origin_m_.x() + half_width_m, origin_m_.y() + half_height_m, 0.0},
          half_width_m,
          half_height_m,
          geometry::kPi};
}

inline bool PoseSearch::IsSurface(float x_m, float y_m) const {
  const float column = (x_m - origin_m_.x()) / kCell_m;
  const float row = (y_m - origin_m_.y()) / kCell_m;
  if (!(column >= 0.0f && row >= 0.0f && column < static_cast<float>(width_) &&
        row < static_cast<float>(height_))) {
    return false;
  }
  return cells_[static_cast<std::size_t>(row) * width_ + static_cast<std::size_t>(column)] != 0;
}

std::vector<PoseGuess> PoseSearch::Best(std::span<const Eigen::Vector3f> point_in_base,
                                        const SearchWindow& window, int count) const {
  SurfaceMap scan(0.2);
  scan.Insert(point_in_base);
  scan.FitPlanes();
  const std::vector<Eigen::Vector2f> places = SteepPlaces(scan);
  if (places.empty() || cells_.empty()) return {};
  const std::size_t stride = (places.size() + kMaxPoints - 1) / kMaxPoints;
  std::vector<Eigen::Vector2f> thinned;
  for (std::size_t i = 0; i < places.size(); i += stride) thinned.push_back(places[i]);

  const auto steps = [](double half, double step) {
    return static_cast<int>(std::ceil(half / step));
  };
  const int steps_x = steps(window.half_width_m, kStep_m);
  const int steps_y = steps(window.half_height_m, kStep_m);
  const int steps_turn = steps(window.half_turn_rad, kStep_rad);
  std::vector<PoseGuess> guesses;
  const auto better = [](const PoseGuess& a, const PoseGuess& b) { return a.score > b.score; };
  double least = 0.0;  // score that is not worth keeping
  std::vector<Eigen::Vector2f> turned(thinned.size());
  for (int turn = -steps_turn; turn <= steps_turn; ++turn) {
    const double yaw_rad = geometry::NormalizeAngle(window.centre.yaw_rad + turn * kStep_rad);
    const Eigen::Matrix2f rotation =
        Eigen::Rotation2Df(static_cast<float>(yaw_rad)).toRotationMatrix();
    for (std::size_t i = 0; i < thinned.size(); ++i) turned[i] = rotation * thinned[i];
    for (int x = -steps_x; x <= steps_x; ++x) {
      for (int y = -steps_y; y <= steps_y; ++y) {
        const Pose2 pose{window.centre.x_m + x * kStep_m, window.centre.y_m + y * kStep_m, yaw_rad};
        const auto place_x = static_cast<float>(pose.x_m);
        const auto place_y = static_cast<float>(pose.y_m);
        int hits = 0;
        for (const Eigen::Vector2f& point : turned) {
          hits += IsSurface(place_x + point.x(), place_y + point.y());
        }
        const double score = static_cast<double>(hits) / static_cast<double>(turned.size());
        if (score <= least) continue;
        guesses.push_back({pose, score});
        if (guesses.size() < 2 * kMaxGuesses) continue;
        std::stable_sort(guesses.begin(), guesses.end(), better);
        guesses.resize(kMaxGuesses);
        least = guesses.back().score;
      }
    }
  }
  std::stable_sort(guesses.begin(), guesses.end(), better);
  std::vector<PoseGuess> best;
  for (const PoseGuess& guess : guesses) {
    if (static_cast<int>(best.size()) >= count) break;
    const bool beside = std::any_of(best.begin(), best.end(), [&](const PoseGuess& other) {
      const Pose2 apart = other.map_from_base.Inverse() * guess.map_from_base;
      return std::hypot(apart.x_m, apart.y_m) < kApart_m && std::abs(apart.yaw_rad) < kApart_rad;
    });
    if (!beside) best.push_back(guess);
  }
  return best;
}

}  // namespace soundmap::mapping
