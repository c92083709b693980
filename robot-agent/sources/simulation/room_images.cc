#include "sources/simulation/room_images.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace soundmap::simulation {
namespace {

constexpr double kFlushM = 0.02;  // a source this near to a surface lies on it
constexpr double kBinS = 0.002;
constexpr double kFreePaths =
    8.0;  // after as many mean free paths hardly any image has a low order

struct AxisImage {
  double coordinate_m;
  double gain;
  int order;
};

// Mirror images along one axis: (1 - 2 q) x + 2 n L, with |n - q| reflections at 0 and |n| at L.
std::vector<AxisImage> AxisImages(double length_m, double source_m, double reflection_min,
                                  double reflection_max, int max_order, double max_distance_m) {
  const bool on_min = source_m < kFlushM;
  const bool on_max = source_m > length_m - kFlushM;
  const int reach = std::min(max_order, static_cast<int>(max_distance_m / (2.0 * length_m)) + 1);
  std::vector<AxisImage> images;
  for (int n = -reach; n <= reach; ++n) {
    for (int q = 0; q <= 1; ++q) {
      const int order = std::abs(2 * n - q);
      if (order > max_order) continue;
      if (order > 0) {
        const bool first_at_max = q == 0 ? n < 0 : n > 0;  // where the path first meets a wall
        if (first_at_max ? on_max : on_min) continue;
      }
      images.push_back(
          {(1 - 2 * q) * source_m + 2 * n * length_m,
           std::pow(reflection_min, std::abs(n - q)) * std::pow(reflection_max, std::abs(n)),
           order});
    }
  }
  return images;
}

}  // namespace

std::vector<RoomImage> RoomImages(const Eigen::Vector3d& room_m,
                                  const ReverberationConfig& reverberation,
                                  const Eigen::Vector3d& source_m, int max_order,
                                  double max_distance_m) {
  std::vector<AxisImage> along[3];
  for (int axis = 0; axis < 3; ++axis) {
    along[axis] =
        AxisImages(room_m[axis], source_m[axis], reverberation.wall_reflection[2 * axis],
                   reverberation.wall_reflection[2 * axis + 1], max_order, max_distance_m);
  }
  std::vector<RoomImage> images;
  for (const auto& x : along[0]) {
    for (const auto& y : along[1]) {
      for (const auto& z : along[2]) {
        RoomImage image{{x.coordinate_m, y.coordinate_m, z.coordinate_m},
                        x.gain * y.gain * z.gain,
                        x.order + y.order + z.order};
        if (image.order > max_order || !(image.gain > 0.0)) continue;
        if ((image.position_m - room_m / 2).norm() > max_distance_m) continue;
        images.push_back(image);
      }
    }
  }
  std::stable_sort(images.begin(), images.end(),
                   [](const RoomImage& a, const RoomImage& b) { return a.order < b.order; });
  return images;
}

double RadiationShare(const Eigen::Vector3d& room_m, const Eigen::Vector3d& source_m) {
  double share = 1.0;
  for (int axis = 0; axis < 3; ++axis) {
    if (source_m[axis] < kFlushM || source_m[axis] > room_m[axis] - kFlushM) share /= 2.0;
  }
  return share;
}

std::vector<Eigen::Vector3d> EmittingPoints(const Scene& scene, const SourceConfig& source) {
  if (source.extent_m < 0.02) return {source.position_m};
  // The axis across the nearest surface, of the room or of furniture.
  int normal = 2;
  double nearest_m = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    const double to_wall_m =
        std::min(source.position_m[axis], scene.room_m[axis] - source.position_m[axis]);
    if (to_wall_m < nearest_m) {
      nearest_m = to_wall_m;
      normal = axis;
    }
    for (const Box& box : scene.furniture) {
      const bool beside = ((source.position_m - box.min_m).array() > -kFlushM).all() &&
                          ((box.max_m - source.position_m).array() > -kFlushM).all();
      const double to_face_m = std::min(std::abs(source.position_m[axis] - box.min_m[axis]),
                                        std::abs(source.position_m[axis] - box.max_m[axis]));
      if (beside && to_face_m < nearest_m) {
        nearest_m = to_face_m;
        normal = axis;
      }
    }
  }
  const int across = (normal + 1) % 3, along = (normal + 2) % 3;
  const int side = source.extent_m > 1.0 ? 3 : 2;
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < side; ++i) {
    for (int k = 0; k < side; ++k) {
      Eigen::Vector3d point = source.position_m;
      point[across] += source.extent_m * ((i + 0.5) / side - 0.5);
      point[along] += source.extent_m * ((k + 0.5) / side - 0.5);
      points.push_back(point.cwiseMax(0.0).cwiseMin(scene.room_m));
    }
  }
  return points;
}

std::vector<double> TailEnergy(const Scene& scene, double sample_rate_hz,
                               const std::vector<Eigen::Vector3d>& sources_m,
                               const std::vector<Eigen::Vector3d>& listeners_m) {
  const auto& reverberation = scene.reverberation;
  if (!(reverberation.rt60_s > 0.0) || sources_m.empty() || listeners_m.empty()) return {};
  const Eigen::Vector3d& room_m = scene.room_m;
  const double volume_m3 = room_m.prod();
  const double surface_m2 =
      2.0 * (room_m.x() * room_m.y() + room_m.x() * room_m.z() + room_m.y() * room_m.z());
  const double counted_m = kFreePaths * 4.0 * volume_m3 / surface_m2;
  const int bins = static_cast<int>(counted_m / scene.speed_of_sound_mps / kBinS) + 1;
  std::vector<double> all(bins, 0.0), missing(bins, 0.0);
  for (const auto& source_m : sources_m) {
    for (const auto& image :
         RoomImages(room_m, reverberation, source_m, std::numeric_limits<int>::max() / 4,
                    counted_m + room_m.norm())) {
      for (const auto& listener_m : listeners_m) {
        const double distance_m = (image.position_m - listener_m).norm();
        const int bin = static_cast<int>(distance_m / scene.speed_of_sound_mps / kBinS);
        if (bin >= bins) continue;
        const double energy = image.gain * image.gain / (distance_m * distance_m);
        all[bin] += energy;
        if (image.order > reverberation.image_order) missing[bin] += energy;
      }
    }
  }
  const double density_per_s = 4.0 * std::numbers::pi * scene.speed_of_sound_mps / volume_m3;
  const int samples = static_cast<int>(reverberation.rt60_s * sample_rate_hz);
  std::vector<double> energy(samples, 0.0);
  for (int i = 0; i < samples; ++i) {
    const double time_s = (i + 0.5) / sample_rate_hz;
    const int bin = static_cast<int>(time_s / kBinS);
    double share = 1.0;
    if (bin < bins) share = all[bin] > 0.0 ? missing[bin] / all[bin] : 0.0;
    energy[i] = share * density_per_s * std::exp(-kDecayNepers * time_s / reverberation.rt60_s) /
                sample_rate_hz;
  }
  return energy;
}

}  // namespace soundmap::simulation
