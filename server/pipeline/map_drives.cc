#include "pipeline/map_drives.h"

#include <functional>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "mapping/floor_plan_mapper.h"
#include "mapping/mapper.h"
#include "pipeline/drive_log.h"

namespace soundmap::pipeline {
namespace {

// Of the whole work; the rest is relaxing the scans and casting their rays.
constexpr double kReadingShare = 0.5;

// Gives the frames of mapping drives to `take`, with progress over all of them.
class DriveReader {
 public:
  DriveReader(const std::vector<SessionRecord>& drives, storage::Store* store,
              const Session::FrameDecoder& decode, OperationContext& context)
      : store_(store), decode_(decode), context_(context) {
    for (const SessionRecord& drive : drives) frames_ += drive.frame_count;
  }

  template <typename Take>
  absl::Status Read(const SessionRecord& drive, const Take& take) {
    const auto log = DriveLog::Open(drive, store_, decode_);
    if (!log.ok()) return log.status();
    auto reader = (*log)->Read();
    if (!reader.ok()) return reader.status();
    for (std::int64_t offset = 0; offset < drive.frame_count; ++offset) {
      if (context_.cancelled()) {
        return absl::CancelledError("the building of the map was cancelled");
      }
      if (read_++ % 64 == 0) {
        context_.Report(kReadingShare * static_cast<double>(read_) / static_cast<double>(frames_),
                        "registering scans");
      }
      const auto frame = reader->Next();
      if (!frame.ok()) return frame.status();
      if (*frame) take(**frame);
    }
    return absl::OkStatus();
  }

 private:
  storage::Store* const store_;
  const Session::FrameDecoder& decode_;
  OperationContext& context_;
  std::int64_t frames_ = 0;
  std::int64_t read_ = 0;
};

// The drives are counted in what the mapping module says; here they have names.
absl::Status NameDrives(const absl::Status& status, const std::vector<SessionRecord>& drives) {
  if (drives.size() < 2 || absl::IsCancelled(status)) return status;
  std::string names;
  for (std::size_t i = 0; i < drives.size(); ++i) {
    absl::StrAppend(&names, i > 0 ? ", " : "", i + 1, " is '", drives[i].session, "'");
  }
  return absl::Status(status.code(), absl::StrCat(std::string(status.message()), " (", names, ")"));
}

template <typename Report>
nlohmann::json ToJson(const Report& report, const std::vector<SessionRecord>& drives) {
  nlohmann::json json{{"scans", report.scans},
                      {"scans_dropped", report.scans_dropped},
                      {"scans_unregistered", report.scans_unregistered},
                      {"key_scans", report.key_scans},
                      {"loops_closed", report.loops_closed},
                      {"loops_refused", report.loops_refused},
                      {"mean_residual_m", report.mean_residual_m},
                      {"drift_removed_m", report.drift_removed_m}};
  for (const SessionRecord& drive : drives) json["sessions"].push_back(drive.session);
  return json;
}

std::function<bool(double)> FinishProgress(OperationContext& context) {
  return [&context](double share) {
    context.Report(kReadingShare + (1.0 - kReadingShare) * share,
                   "relaxing the scans and casting their rays");
    return !context.cancelled();
  };
}

absl::StatusOr<DrivenMap> MapByLaser(const std::vector<SessionRecord>& drives,
                                     const std::vector<mapping::StampedPose>& surveyed_poses,
                                     const std::shared_ptr<const building::Building>& extend,
                                     const mapping::FloorPlanMapperConfig& config,
                                     DriveReader& reader, OperationContext& context) {
  const SessionRecord& first = drives.front();
  auto mapper = mapping::FloorPlanMapper::Create(config, first.calibration,
                                                 first.initial_pose.value_or(geometry::Pose2{}),
                                                 surveyed_poses, extend);
  if (!mapper.ok()) return mapper.status();
  for (const SessionRecord& drive : drives) {
    if (&drive != &first) {
      const absl::Status begun = mapper->BeginDrive(drive.calibration, drive.initial_pose);
      if (!begun.ok()) return begun;
    }
    const absl::Status read =
        reader.Read(drive, [&](const frames::Frame& frame) { mapper->Add(frame).IgnoreError(); });
    if (!read.ok()) return read;
  }
  auto result = mapper->Finish(FinishProgress(context));
  if (!result.ok()) return NameDrives(result.status(), drives);
  nlohmann::json report = ToJson(result->report, drives);
  report["laser_lag_s"] = result->report.laser_lag_s;
  return DrivenMap{std::move(result->building), report.dump()};
}

}  // namespace

absl::StatusOr<DrivenMap> MapDrives(const std::vector<SessionRecord>& drives,
                                    const std::vector<mapping::StampedPose>& surveyed_poses,
                                    const std::shared_ptr<const building::Building>& extend,
                                    const Profile& profile, storage::Store* store,
                                    const Session::FrameDecoder& decode,
                                    OperationContext& context) {
  if (!surveyed_poses.empty() && drives.size() > 1) {
    return absl::InvalidArgumentError("surveyed poses place one mapping drive, not several");
  }
  DriveReader reader(drives, store, decode, context);
  if (extend && !extend->octree) {
    return MapByLaser(drives, surveyed_poses, extend, profile.floor_plan_mapping, reader, context);
  }
  const SessionRecord& first = drives.front();
  auto mapper = mapping::Mapper::Create(profile.mapping, first.calibration,
                                        first.initial_pose.value_or(geometry::Pose2{}),
                                        surveyed_poses, extend);
  if (!mapper.ok()) return mapper.status();
  bool has_lidar = false;
  for (const SessionRecord& drive : drives) {
    if (&drive != &first) {
      const absl::Status begun = mapper->BeginDrive(drive.calibration, drive.initial_pose);
      if (!begun.ok()) return begun;
    }
    const absl::Status read = reader.Read(drive, [&](const frames::Frame& frame) {
      has_lidar = has_lidar || std::holds_alternative<frames::LidarScan>(frame);
      mapper->Add(frame).IgnoreError();  // a malformed frame is left out and counted
    });
    if (!read.ok()) return read;
  }
  if (!has_lidar) {
    return MapByLaser(drives, surveyed_poses, extend, profile.floor_plan_mapping, reader, context);
  }
  auto result = mapper->Finish(FinishProgress(context));
  if (!result.ok()) return NameDrives(result.status(), drives);
  nlohmann::json report = ToJson(result->report, drives);
  report["loops_tried"] = result->report.loops_tried;
  return DrivenMap{std::move(result->building), report.dump()};
}

}  // namespace soundmap::pipeline
