#pragma once

#include <Eigen/Core>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace soundmap::mapping {

using Square = Eigen::Vector2i;

// None where the point is not finite or too far out.
inline std::optional<Square> SquareOf(const Eigen::Vector2f& point, float square_m) {
  const Eigen::Vector2f scaled = point / square_m;
  if (!(scaled.cwiseAbs().maxCoeff() < 1e8f)) return std::nullopt;
  return Square(static_cast<int>(std::floor(scaled.x())), static_cast<int>(std::floor(scaled.y())));
}
inline std::int64_t KeyOf(const Square& square) {
  return (static_cast<std::int64_t>(square.x()) << 32) ^ static_cast<std::uint32_t>(square.y());
}

// A piece of wall in the plane of the LRF, in `map`: the mean of the points in one square and the
// line through those in it and around it.
struct LinePiece {
  Eigen::Vector2f mean = Eigen::Vector2f::Zero();
  float points = 0.0f;
  // Sum of the squared deviations from the mean: xx, xy, yy.
  Eigen::Vector3f scatter = Eigen::Vector3f::Zero();
  // normal . x = offset on the line; the sign is arbitrary, zero means no line.
  Eigen::Vector2f normal = Eigen::Vector2f::Zero();
  float offset_m = 0.0f;
  // Enough points in it and around it to tell that they lie on no line: furniture or the like.
  bool is_spot = false;

  bool has_line() const { return normal.squaredNorm() > 0.0f; }
};

// The walls seen so far, in squares. Memory grows with the walls, not with the points.
class LineMap {
 public:
  explicit LineMap(double square_m) : square_m_(static_cast<float>(square_m)) {}

  // Points that are not finite are left out. Lines are as before until FitLines().
  void Insert(std::span<const Eigen::Vector2f> point_in_map);
  // Fits lines anew where points were added since the last time.
  void FitLines();

  // The piece whose mean is nearest, at most `max_distance_m` away. Null if there is none.
  const LinePiece* Nearest(const Eigen::Vector2f& point_in_map, float max_distance_m) const;
  // The piece of the square that the point lies in. Null if there is none.
  const LinePiece* At(const Eigen::Vector2f& point_in_map) const;

  std::size_t size() const { return pieces_.size(); }
  const std::vector<LinePiece>& pieces() const { return pieces_; }

 private:
  const LinePiece* Find(const Square& square) const;
  void FitLine(const Square& square, LinePiece& piece) const;

  float square_m_;
  boost::unordered_flat_map<std::int64_t, std::uint32_t> index_;
  std::vector<LinePiece> pieces_;
  std::vector<Square> squares_;         // of the pieces
  std::vector<std::uint32_t> changed_;  // pieces with points since the last FitLines()
  std::vector<bool> is_changed_;
};

}  // namespace soundmap::mapping
