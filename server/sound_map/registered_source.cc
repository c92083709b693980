#include "sound_map/registered_source.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "geometry/angles.h"

namespace soundmap::sound_map {
namespace {

constexpr frames::TimeNs kPeriodPause_ns = 60'000'000'000;
constexpr std::size_t kMaxPeriods = 512;
constexpr std::size_t kMaxRobots = 64;

// The mean over fewer scans says little about a level.
constexpr std::int64_t kMinLevelScans = 4;

// How much the levels of one source may differ over the bands (root mean square): the room changes
// what a source sounds like from other places by some decibels.
constexpr double kMaxUnlike_db = 4.0;
constexpr int kMinAlikeBands = 3;

// Directions that are closer are one: half a lobe of a small array, and what a place of a view
// point a metre wide is off by.
const double kOneDirection_rad = geometry::RadFromDeg(12.0);

constexpr double kOnSurface_m = 0.3;

// A full-scale square wave beside a full-scale sine.
const double kSquareOverSine_db = 10.0 * std::log10(2.0);

// By band, of the median over the view points of sum(view point, band) / scans(view point).
template <typename Scans, typename Sum>
Spectrum MedianOfMeans_db(const std::vector<ViewPoint>& view_points, Scans scans, Sum sum) {
  Spectrum spectrum_db;
  std::vector<double> means;
  for (int band = 0; band < frames::kOctaveBands; ++band) {
    means.clear();
    for (const ViewPoint& view_point : view_points) {
      if (scans(view_point) < kMinLevelScans) continue;
      means.push_back(sum(view_point)[band] / static_cast<double>(scans(view_point)));
    }
    if (means.empty()) continue;
    const auto middle = means.begin() + static_cast<std::ptrdiff_t>(means.size() / 2);
    std::nth_element(means.begin(), middle, means.end());
    if (*middle > 0.0) spectrum_db[band] = 10.0 * std::log10(*middle);
  }
  return spectrum_db;
}

}  // namespace

void ViewPoint::AddArray(const Eigen::Vector3d& in_map_m, const std::optional<ArrayPlane>& plane) {
  const bool in_plane = plane_normal_in_map != Eigen::Vector3d::Zero();
  if (array_known && (!in_plane || plane)) return;
  array_known = true;
  array_in_map_m = in_map_m;
  plane_normal_in_map = plane ? plane->normal_in_map : Eigen::Vector3d::Zero();
}

bool ViewPoint::InOneDirection(const Eigen::Vector3d& place_in_map_m,
                               const Eigen::Vector3d& other_in_map_m) const {
  const Eigen::Vector3d direction = (place_in_map_m - array_in_map_m).normalized();
  const Eigen::Vector3d other = (other_in_map_m - array_in_map_m).normalized();
  if (plane_normal_in_map == Eigen::Vector3d::Zero()) {
    return direction.dot(other) > std::cos(kOneDirection_rad);
  }
  // What lies alike along the plane sounds alike, above and below it.
  const Eigen::Vector3d off = direction - other;
  return (off - off.dot(plane_normal_in_map) * plane_normal_in_map).norm() <
         std::sin(kOneDirection_rad);
}

bool ViewPoint::Mirrors(const Eigen::Vector3d& place_in_map_m,
                        const Eigen::Vector3d& other_in_map_m) const {
  if (plane_normal_in_map != Eigen::Vector3d::Zero() ||
      surface_normal_sum_in_map == Eigen::Vector3d::Zero()) {
    return false;
  }
  const Eigen::Vector3d normal = surface_normal_sum_in_map.normalized();
  const double height_m = (other_in_map_m - place_in_map_m).dot(normal);
  // What is on the surface itself is its own image; what is behind it has none.
  if (height_m < kOnSurface_m || (array_in_map_m - place_in_map_m).dot(normal) <= 0.0) return false;
  return InOneDirection(place_in_map_m, other_in_map_m - 2.0 * height_m * normal);
}

void ViewPoint::AddLevel(const frames::BandPowers& power,
                         const std::optional<double>& full_scale_spl_db) {
  ++level_scans;
  for (int band = 0; band < frames::kOctaveBands; ++band) power_at_1m[band] += power[band];
  if (!full_scale_spl_db) return;
  ++spl_scans;
  const double full_scale = std::pow(10.0, (*full_scale_spl_db + kSquareOverSine_db) / 10.0);
  for (int band = 0; band < frames::kOctaveBands; ++band) {
    squared_pressure_at_1m[band] += full_scale * power[band];
  }
}

std::optional<double> TotalLevel_db(const Spectrum& spectrum_db) {
  double power = 0.0;
  for (const std::optional<double>& band_db : spectrum_db) {
    if (band_db) power += std::pow(10.0, *band_db / 10.0);
  }
  if (!(power > 0.0)) return std::nullopt;
  return 10.0 * std::log10(power);
}

bool RegisteredSource::HeardInPlanesAlone() const {
  bool in_plane = false;
  for (const ViewPoint& view_point : view_points) {
    if (!view_point.array_known) continue;
    if (view_point.plane_normal_in_map == Eigen::Vector3d::Zero()) return false;
    in_plane = true;
  }
  return in_plane;
}

Explained RegisteredSource::ExplainedBy(const Eigen::Vector3d& other_in_map_m) const {
  int known = 0;
  Explained explained;
  for (const ViewPoint& view_point : view_points) {
    if (!view_point.array_known) continue;
    ++known;
    if (view_point.InOneDirection(found.position_in_map_m, other_in_map_m)) ++explained.direct;
    if (view_point.Mirrors(found.position_in_map_m, other_in_map_m)) ++explained.mirrored;
  }
  if (known == 0) return {};
  return {explained.direct / known, explained.mirrored / known};
}

Spectrum RegisteredSource::Spectrum_db() const {
  return MedianOfMeans_db(
      view_points, [](const ViewPoint& view_point) { return view_point.level_scans; },
      [](const ViewPoint& view_point) -> const auto& { return view_point.power_at_1m; });
}

Spectrum RegisteredSource::SpectrumSpl_db() const {
  return MedianOfMeans_db(
      view_points, [](const ViewPoint& view_point) { return view_point.spl_scans; },
      [](const ViewPoint& view_point) -> const auto& { return view_point.squared_pressure_at_1m; });
}

void RegisteredSource::AddHeard(frames::TimeNs time_ns) {
  std::vector<HeardPeriod>& periods = heard;
  // The first one that ends less than a pause before the time, or later.
  auto at = std::lower_bound(periods.begin(), periods.end(), time_ns - kPeriodPause_ns,
                             [](const HeardPeriod& p, frames::TimeNs t) { return p.end_ns < t; });
  if (at == periods.end() || at->begin_ns > time_ns + kPeriodPause_ns) {
    periods.insert(at, {time_ns, time_ns});
    if (periods.size() > kMaxPeriods) periods.erase(periods.begin());
    return;
  }
  at->begin_ns = std::min(at->begin_ns, time_ns);
  at->end_ns = std::max(at->end_ns, time_ns);
  const auto next = std::next(at);
  if (next != periods.end() && next->begin_ns - at->end_ns <= kPeriodPause_ns) {
    at->end_ns = std::max(at->end_ns, next->end_ns);
    periods.erase(next);
  }
}

void RegisteredSource::AddRobot(const std::string& robot) {
  const auto at = std::lower_bound(robots.begin(), robots.end(), robot);
  if ((at == robots.end() || *at != robot) && robots.size() < kMaxRobots) robots.insert(at, robot);
}

void RegisteredSource::TakeHistory(const RegisteredSource& from) {
  found.first_heard_ns = std::min(found.first_heard_ns, from.found.first_heard_ns);
  found.last_heard_ns = std::max(found.last_heard_ns, from.found.last_heard_ns);
  for (const std::string& robot : from.robots) AddRobot(robot);
  for (const HeardPeriod& period : from.heard) {
    // A pause at a time: the ends alone would leave a hole.
    for (frames::TimeNs t = period.begin_ns; t < period.end_ns; t += kPeriodPause_ns) AddHeard(t);
    AddHeard(period.end_ns);
  }
}

bool SoundAlike(const RegisteredSource& a, const RegisteredSource& b) {
  const Spectrum spectrum_a = a.Spectrum_db();
  const Spectrum spectrum_b = b.Spectrum_db();
  int bands = 0;
  double squares = 0.0;
  for (int band = 0; band < frames::kOctaveBands; ++band) {
    if (!spectrum_a[band] || !spectrum_b[band]) continue;
    ++bands;
    squares += (*spectrum_a[band] - *spectrum_b[band]) * (*spectrum_a[band] - *spectrum_b[band]);
  }
  return bands >= kMinAlikeBands && std::sqrt(squares / bands) <= kMaxUnlike_db;
}

}  // namespace soundmap::sound_map
