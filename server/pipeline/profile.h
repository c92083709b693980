#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "acoustics/config.h"
#include "building/point_cloud.h"
#include "localization/config.h"
#include "mapping/floor_plan_mapper.h"
#include "mapping/mapper.h"
#include "ray_casting/ray_caster.h"
#include "sound_map/config.h"

namespace soundmap::pipeline {

// When the branches of the pipeline meet.
struct FusionConfig {
  double pose_wait_s = 0.3;   // an audio scan waits this long for the correction after it
  double lidar_wait_s = 1.0;  // and this long, at most, for the LIDAR scan after it
  // And this long for an uncertain robot to know where it is, or that it is lost.
  double doubt_wait_s = 30.0;
};

// The parameters of every stage. Two named sets: `paper` is the paper as printed, `default` the
// best that we know.
struct Profile {
  std::string name;
  acoustics::AcousticsConfig acoustics;
  localization::Config localization;
  ray_casting::RayCastingConfig ray_casting;
  sound_map::SoundMapConfig sound_map;
  FusionConfig fusion;
  mapping::MapperConfig mapping;
  mapping::FloorPlanMapperConfig floor_plan_mapping;  // of drives without a LIDAR
  building::PointCloudConfig import;  // of point clouds, and the slice of imported octrees

  absl::Status Validate() const;
};

// NotFound unless `name` is "paper" or "default".
absl::StatusOr<Profile> ProfileByName(const std::string& name);

// Every parameter, in sections named after the stages; the names end in the unit. Angles are in
// degrees.
std::string ToToml(const Profile& profile);

// The profile that `name` in the text says, with the parameters that the text has. InvalidArgument,
// naming the parameter: unknown, of another type, out of range.
absl::StatusOr<Profile> ProfileFromToml(const std::string& text);

}  // namespace soundmap::pipeline
