#pragma once

#include <Eigen/Core>
#include <vector>

#include "sources/simulation/scene.h"

namespace soundmap::simulation {

// Speed at which p^2 of the reverberation falls: 60 dB in RT60.
inline constexpr double kDecayNepers = 13.815510557964274;  // ln 10^6

// A mirror image of a source in the walls of the room. Order 0 is the source itself.
struct RoomImage {
  Eigen::Vector3d position_m;
  double gain = 1.0;  // product of the walls' pressure reflections
  int order = 0;
};

// All images up to `max_order`, and none further than `max_distance_m` from the room's middle. A
// source that lies on a wall radiates away from it: images whose path would leave the source into
// that wall are left out, so that no image coincides with another and `level` keeps its meaning.
std::vector<RoomImage> RoomImages(const Eigen::Vector3d& room_m,
                                  const ReverberationConfig& reverberation,
                                  const Eigen::Vector3d& source_m, int max_order,
                                  double max_distance_m);

// Share of a full sphere into which the source radiates: 1, 1/2 on a wall, 1/4 in an edge, 1/8 in a
// corner.
double RadiationShare(const Eigen::Vector3d& room_m, const Eigen::Vector3d& source_m);

// The points that stand for a source: one, or a square of incoherent ones in the surface that it
// lies on.
std::vector<Eigen::Vector3d> EmittingPoints(const Scene& scene, const SourceConfig& source);

// Energy of the impulse response that the images up to `reverberation.image_order` leave out, per
// sample, from t = 0 to RT60, for a source of unit amplitude at 1 m that radiates into a full
// sphere. The diffuse field of a room has the energy density 4 pi c / V exp(-13.8 t / RT60); the
// share that is missing comes from counting images over the pairs of `sources_m` and `listeners_m`.
std::vector<double> TailEnergy(const Scene& scene, double sample_rate_hz,
                               const std::vector<Eigen::Vector3d>& sources_m,
                               const std::vector<Eigen::Vector3d>& listeners_m);

}  // namespace soundmap::simulation
