#pragma once

#include <limits>

#include "absl/status/statusor.h"
#include "pipeline/events.h"
#include "pipeline/operations.h"
#include "pipeline/session.h"
#include "pipeline/site.h"
#include "soundmap/v1/live_service.pb.h"
#include "soundmap/v1/operation_service.pb.h"
#include "soundmap/v1/robot_service.pb.h"
#include "soundmap/v1/session_service.pb.h"
#include "soundmap/v1/site_service.pb.h"
#include "soundmap/v1/sound_map_service.pb.h"
#include "soundmap/v1/types.pb.h"
#include "soundmap/v1/watch_service.pb.h"

namespace soundmap::api {

// Between the wire and the server's own types; nothing of the wire goes further in.
v1::Pose2 ToProto(const geometry::Pose2& pose);
v1::PoseEstimate ToProto(const localization::PoseEstimate& pose);
v1::Calibration ToProto(const frames::Calibration& calibration);
v1::Site ToProto(const pipeline::Site& site);
v1::Session ToProto(const pipeline::Session& session);
v1::Robot ToProto(const pipeline::RobotInfo& robot);
v1::ClockOffset ToProto(const pipeline::ClockOffset& offset);
v1::LiveView ToProto(const std::string& site, const pipeline::LiveView& view);
// As it stands in the name of a sound source of the band; `band` is a band's name here and below,
// empty for the main one.
std::string SourceId(const std::string& band, std::uint64_t id);
// Capture times start_ns <= t < end_ns.
struct TimeWindow {
  frames::TimeNs start_ns = std::numeric_limits<frames::TimeNs>::min();
  frames::TimeNs end_ns = std::numeric_limits<frames::TimeNs>::max();

  bool Overlaps(const sound_map::HeardPeriod& period) const {
    return period.begin_ns < end_ns && period.end_ns >= start_ns;
  }
};
// With the periods that overlap the window.
v1::SoundSource ToProto(const std::string& site, const std::string& band,
                        const sound_map::RegisteredSource& source, const TimeWindow& periods);
v1::SoundSource ToProto(const std::string& site, const std::string& band,
                        const sound_map::RegisteredSource& source);
v1::SoundSourceEvent ToProto(const std::string& site, const std::string& band,
                             const sound_map::SourceEvent& event);
v1::SoundSourceState ToProto(sound_map::SourceState state);
v1::AudioScan ToProto(const std::string& site, const std::string& band,
                      const pipeline::AudioScanInfo& scan);
v1::Operation ToProto(const pipeline::OperationInfo& operation);

// InvalidArgument: a number that is not finite, a rotation that is none; an absent transform is the
// identity.
absl::StatusOr<geometry::Pose2> FromProto(const v1::Pose2& pose);
pipeline::Band FromProto(const v1::Band& band);
absl::StatusOr<frames::Calibration> FromProto(const v1::Calibration& calibration);
// InvalidArgument: a number that is not finite or out of its range, too many beams. `now_ns`: on
// the server's clock.
absl::StatusOr<pipeline::LiveReport> FromProto(const v1::LiveReport& report, std::int64_t now_ns);

}  // namespace soundmap::api
