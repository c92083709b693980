#include "mapping/laser_lines.h"

#include <algorithm>

namespace soundmap::mapping {
namespace {

constexpr float kMinPoints = 3.0f;
constexpr float kMinSpotPoints = 12.0f;
// Of a line: how much thinner than long its points lie, and how thick at most.
constexpr float kMaxWidthToLength = 0.3f;
constexpr float kMaxWidth_m = 0.06f;

}  // namespace

void LineMap::Insert(std::span<const Eigen::Vector2f> point_in_map) {
  for (const Eigen::Vector2f& point : point_in_map) {
    const auto square = SquareOf(point, square_m_);
    if (!square) continue;
    const auto [entry, added] =
        index_.try_emplace(KeyOf(*square), static_cast<std::uint32_t>(pieces_.size()));
    if (added) {
      pieces_.emplace_back();
      squares_.push_back(*square);
      is_changed_.push_back(false);
    }
    LinePiece& piece = pieces_[entry->second];
    const Eigen::Vector2f before = point - piece.mean;
    piece.points += 1.0f;
    piece.mean += before / piece.points;
    const Eigen::Vector2f after = point - piece.mean;
    piece.scatter +=
        Eigen::Vector3f(before.x() * after.x(), before.x() * after.y(), before.y() * after.y());
    if (!is_changed_[entry->second]) {
      is_changed_[entry->second] = true;
      changed_.push_back(entry->second);
    }
  }
}

void LineMap::FitLines() {
  std::vector<std::uint32_t> to_fit;
  for (const std::uint32_t i : changed_) {
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        const auto found = index_.find(KeyOf(squares_[i] + Square(dx, dy)));
        if (found != index_.end()) to_fit.push_back(found->second);
      }
    }
  }
  std::sort(to_fit.begin(), to_fit.end());
  to_fit.erase(std::unique(to_fit.begin(), to_fit.end()), to_fit.end());
  for (const std::uint32_t i : to_fit) FitLine(squares_[i], pieces_[i]);
  for (const std::uint32_t i : changed_) is_changed_[i] = false;
  changed_.clear();
}

void LineMap::FitLine(const Square& square, LinePiece& piece) const {
  float points = 0.0f;
  Eigen::Vector2f sum = Eigen::Vector2f::Zero();  // from this piece's mean
  Eigen::Vector3f moment = Eigen::Vector3f::Zero();
  for (int dx = -1; dx <= 1; ++dx) {
    for (int dy = -1; dy <= 1; ++dy) {
      const LinePiece* other = Find(square + Square(dx, dy));
      if (!other) continue;
      const Eigen::Vector2f d = other->mean - piece.mean;
      points += other->points;
      sum += other->points * d;
      moment += other->scatter +
                other->points * Eigen::Vector3f(d.x() * d.x(), d.x() * d.y(), d.y() * d.y());
    }
  }
  piece.normal.setZero();
  piece.offset_m = 0.0f;
  piece.is_spot = points >= kMinSpotPoints;
  if (points < kMinPoints) return;
  const Eigen::Vector2f mean = sum / points;
  const float xx = moment[0] / points - mean.x() * mean.x();
  const float xy = moment[1] / points - mean.x() * mean.y();
  const float yy = moment[2] / points - mean.y() * mean.y();
  const float middle = 0.5f * (xx + yy);
  const float radius = std::hypot(0.5f * (xx - yy), xy);
  const float thin = std::max(middle - radius, 0.0f);
  const float long_ = middle + radius;
  if (!(thin <= kMaxWidthToLength * kMaxWidthToLength * long_) ||
      thin > kMaxWidth_m * kMaxWidth_m) {
    return;
  }
  piece.is_spot = false;
  const float along_rad = 0.5f * std::atan2(2.0f * xy, xx - yy);
  piece.normal = {-std::sin(along_rad), std::cos(along_rad)};
  piece.offset_m = piece.normal.dot(piece.mean + mean);
}

const LinePiece* LineMap::Find(const Square& square) const {
  const auto found = index_.find(KeyOf(square));
  return found == index_.end() ? nullptr : &pieces_[found->second];
}

const LinePiece* LineMap::At(const Eigen::Vector2f& point_in_map) const {
  const auto square = SquareOf(point_in_map, square_m_);
  return square ? Find(*square) : nullptr;
}

const LinePiece* LineMap::Nearest(const Eigen::Vector2f& point_in_map, float max_distance_m) const {
  const auto square = SquareOf(point_in_map, square_m_);
  if (!square) return nullptr;
  const LinePiece* nearest = nullptr;
  float nearest_m2 = max_distance_m * max_distance_m;
  const int reach = static_cast<int>(std::ceil(max_distance_m / square_m_));
  for (int dx = -reach; dx <= reach; ++dx) {
    for (int dy = -reach; dy <= reach; ++dy) {
      const LinePiece* piece = Find(*square + Square(dx, dy));
      if (!piece) continue;
      const float distance_m2 = (piece->mean - point_in_map).squaredNorm();
      if (distance_m2 < nearest_m2) {
        nearest_m2 = distance_m2;
        nearest = piece;
      }
    }
  }
  return nearest;
}

}  // namespace soundmap::mapping
