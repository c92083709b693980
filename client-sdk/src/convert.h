#pragma once

#include <string>
#include <string_view>

#include "soundmap/map_files.h"
#include "soundmap/poses.h"
#include "soundmap/resources.h"
#include "soundmap/sound.h"
#include "soundmap/v1/map_service.pb.h"
#include "soundmap/v1/operation_service.pb.h"
#include "soundmap/v1/robot_service.pb.h"
#include "soundmap/v1/session_service.pb.h"
#include "soundmap/v1/site_service.pb.h"
#include "soundmap/v1/sound_map_service.pb.h"
#include "soundmap/v1/watch_service.pb.h"
#include "soundmap/watch.h"

namespace soundmap::internal {

// Resource names. An id that already is a full name stays as it is.
std::string SiteName(const std::string& site);
std::string SessionName(const std::string& site, const std::string& session);
std::string SourceName(const std::string& site, const std::string& source);
std::string RobotName(const std::string& robot);
std::string OperationName(const std::string& operation);
// "sites/hall/sessions/s1", "sessions" -> "s1"; empty when there is no such part.
std::string IdIn(const std::string& name, std::string_view collection);

Site FromProto(const v1::Site& wire);
Session FromProto(const v1::Session& wire);
Robot FromProto(const v1::Robot& wire);
Operation FromProto(const v1::Operation& wire);
PoseEstimate FromProto(const v1::PoseEstimate& wire);
SoundSource FromProto(const v1::SoundSource& wire);
AudioScan FromProto(const v1::AudioScan& wire);
// Columns of unequal length are cut to the shortest: the caller compares size() with what came.
VoxelColumns FromProto(const v1::VoxelChunk& wire);
WatchEvent FromProto(const v1::WatchEvent& wire);

void ToProto(const Pose2& pose, v1::Pose2& wire);
void ToProto(const Vector3& vector, v1::Vector3& wire);
v1::ExportWhat ToProto(ExportWhat what);
v1::SoundSourceState ToProto(SoundSourceState state);

}  // namespace soundmap::internal
