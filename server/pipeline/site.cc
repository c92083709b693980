#include "pipeline/site.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "building/stored_building.h"
#include "pipeline/archive.h"
#include "storage/names.h"

namespace soundmap::pipeline {
namespace {

std::string BuildingKey(const std::string& site, std::int64_t version) {
  return absl::StrCat(site, "/", absl::StrFormat("%08d", version));
}

}  // namespace

Site::Site(SiteRecord record, Profile profile, storage::Store* store, Session::FrameDecoder decode,
           boost::asio::any_io_executor executor)
    : profile_(std::move(profile)),
      store_(store),
      decode_(std::move(decode)),
      executor_(std::move(executor)),
      record_(std::move(record)) {}

absl::StatusOr<std::shared_ptr<Site>> Site::Open(SiteRecord record, storage::Store* store,
                                                 Session::FrameDecoder decode,
                                                 boost::asio::any_io_executor executor) {
  auto profile = ProfileFromToml(record.parameters_toml);
  if (!profile.ok()) return profile.status();
  const std::string name = record.site;
  std::shared_ptr<Site> site(new Site(std::move(record), *std::move(profile), store,
                                      std::move(decode), std::move(executor)));
  auto region = Region::Open(name, store, site->profile_.sound_map);
  if (!region.ok()) return region.status();
  site->region_ = *std::move(region);
  if (site->record_.building_version > 0) {
    auto building = site->LoadBuilding(site->record_.building_version);
    if (!building.ok()) return building.status();
    site->building_ = *std::move(building);
  }
  const auto sessions = store->ListRecords(storage::Table::kSession, name + "/");
  if (!sessions.ok()) return sessions.status();
  for (const storage::Record& stored : *sessions) {
    auto session_record = SessionRecordFromJson(stored.bytes);
    if (!session_record.ok()) return session_record.status();
    auto session = site->OpenSession(*std::move(session_record));
    if (!session.ok()) return session.status();
    site->sessions_[(*session)->record().session] = *session;
  }
  return site;
}

absl::StatusOr<std::shared_ptr<const building::Building>> Site::LoadBuilding(
    std::int64_t version) const {
  if (building_ && version == record_.building_version) return building_;
  const std::string key = BuildingKey(record_.site, version);
  const auto bytes = store_->GetRecord(storage::Table::kBuilding, key);
  if (!bytes.ok()) return bytes.status();
  if (!bytes->has_value()) {
    return absl::DataLossError(absl::StrCat("the geometric map ", key, " is gone"));
  }
  auto building = building::ParseBuilding(**bytes);
  if (!building.ok()) return building.status();
  return std::make_shared<const building::Building>(*std::move(building));
}

absl::StatusOr<std::shared_ptr<Session>> Site::OpenSession(SessionRecord record) {
  Session::Site parts{store_, region_.get(), &profile_, nullptr, decode_, executor_};
  if (record.purpose == Purpose::kListening && !record.complete) {
    auto building = LoadBuilding(record.building_version);
    if (!building.ok()) return building.status();
    parts.building = *std::move(building);
  }
  return Session::Open(std::move(record), std::move(parts));
}

SiteRecord Site::record() const {
  std::lock_guard lock(mutex_);
  return record_;
}

absl::StatusOr<std::shared_ptr<Session>> Site::CreateSession(const SessionRequest& request,
                                                             std::int64_t now_ns) {
  absl::Status valid = storage::ValidateName("session", request.session);
  if (valid.ok()) valid = storage::ValidateName("robot", request.robot);
  if (valid.ok()) valid = request.calibration.Validate();
  if (!valid.ok()) return valid;

  std::lock_guard lock(mutex_);
  if (const auto known = sessions_.find(request.session); known != sessions_.end()) {
    const SessionRecord record = known->second->record();
    if (record.robot != request.robot || record.purpose != request.purpose) {
      return absl::AlreadyExistsError(
          absl::StrCat("session '", request.session, "' exists already, for robot '", record.robot,
                       "' and another purpose or robot than was asked for"));
    }
    const auto epoch = known->second->NextEpoch();
    if (!epoch.ok()) return epoch.status();
    return known->second;
  }
  if (request.purpose == Purpose::kListening) {
    if (!building_) {
      return absl::FailedPreconditionError(absl::StrCat(
          "site '", record_.site,
          "' has no geometric map; replay a mapping drive and run `soundmap map build ",
          record_.site, "`, or import a map"));
    }
    if (!request.initial_pose) {
      return absl::FailedPreconditionError(absl::StrCat(
          "robot '", request.robot, "' does not say where it starts; give --initial-pose x,y,yaw"));
    }
  }
  SessionRecord record;
  record.site = record_.site;
  record.session = request.session;
  record.robot = request.robot;
  record.purpose = request.purpose;
  record.calibration = request.calibration;
  record.initial_pose = request.initial_pose;
  record.warnings = request.warnings;
  record.epoch = 1;
  record.create_time_ns = now_ns;
  record.building_version = record_.building_version;
  auto session = OpenSession(record);
  if (!session.ok()) return session.status();
  const absl::Status stored = store_->PutRecord(
      storage::Table::kSession, absl::StrCat(record.site, "/", record.session), ToJson(record));
  if (!stored.ok()) return stored;
  sessions_[record.session] = *session;
  return session;
}

absl::StatusOr<std::shared_ptr<Session>> Site::GetSession(const std::string& name) const {
  if (auto session = FindSession(name)) return session;
  return absl::NotFoundError(
      absl::StrCat("session '", name, "' does not exist at site '", record().site, "'"));
}

std::shared_ptr<Session> Site::FindSession(const std::string& name) const {
  std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name);
  return found == sessions_.end() ? nullptr : found->second;
}

std::vector<std::shared_ptr<Session>> Site::Sessions() const {
  std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<Session>> sessions;
  for (const auto& [name, session] : sessions_) sessions.push_back(session);
  return sessions;
}

std::shared_ptr<const building::Building> Site::building() const {
  std::lock_guard lock(mutex_);
  return building_;
}

absl::Status Site::ActivateBuilding(building::Building building) {
  // A plan that cannot be localized in is refused here, not when the first robot comes.
  const auto plan = localization::PreparedPlan::Create(profile_.localization, building.floor_plan);
  if (!plan.ok()) return plan.status();
  const std::string bytes = building::SerializeBuilding(building);
  std::lock_guard lock(mutex_);
  SiteRecord record = record_;
  ++record.building_version;
  absl::Status stored = store_->PutRecord(storage::Table::kBuilding,
                                          BuildingKey(record.site, record.building_version), bytes);
  if (stored.ok()) stored = store_->PutRecord(storage::Table::kSite, record.site, ToJson(record));
  if (!stored.ok()) return stored;
  record_ = std::move(record);
  building_ = std::make_shared<const building::Building>(std::move(building));
  return absl::OkStatus();
}

absl::StatusOr<std::string> Site::BuildMap(const std::string& session_name,
                                           const std::vector<mapping::StampedPose>& surveyed_poses,
                                           OperationContext& context) {
  std::shared_ptr<Session> session;
  if (!session_name.empty()) {
    auto named = GetSession(session_name);
    if (!named.ok()) return named.status();
    session = *std::move(named);
    if (session->record().purpose != Purpose::kMapping) {
      return absl::FailedPreconditionError(
          absl::StrCat("session '", session_name, "' is not a mapping drive"));
    }
  } else {
    for (const std::shared_ptr<Session>& candidate : Sessions()) {
      const SessionRecord record = candidate->record();
      if (record.purpose != Purpose::kMapping) continue;
      if (!session || record.create_time_ns > session->record().create_time_ns) session = candidate;
    }
    if (!session) {
      return absl::FailedPreconditionError(absl::StrCat(
          "site '", record().site, "' has no mapping drive; replay one with --purpose mapping"));
    }
  }
  const SessionRecord record = session->record();
  if (!record.complete) {
    return absl::FailedPreconditionError(
        absl::StrCat("the mapping drive '", record.session, "' has not arrived in full"));
  }

  auto mapper =
      mapping::Mapper::Create(profile_.mapping, record.calibration,
                              record.initial_pose.value_or(geometry::Pose2{}), surveyed_poses);
  if (!mapper.ok()) return mapper.status();
  const storage::SessionId id{record.site, record.session};
  const auto log = store_->OpenSession(id);
  if (!log.ok()) return log.status();
  const auto reader = (*log)->Read(0);
  if (!reader.ok()) return reader.status();
  for (std::int64_t offset = 0; offset < record.frame_count; ++offset) {
    if (context.cancelled()) return absl::CancelledError("the building of the map was cancelled");
    if (offset % 64 == 0) {
      context.Report(0.5 * static_cast<double>(offset) / static_cast<double>(record.frame_count),
                     "registering scans");
    }
    const auto message = (*reader)->Next();
    if (!message.ok()) return message.status();
    if (!message->has_value()) return absl::DataLossError("the session log ends early");
    const auto frame = decode_(**message, record.calibration);
    if (!frame.ok()) return frame.status();
    mapper->Add(*frame).IgnoreError();  // a malformed frame is left out and counted
  }
  store_->CloseSession(id).IgnoreError();  // nothing was appended
  auto result = mapper->Finish([&context](double share) {
    context.Report(0.5 + 0.5 * share, "relaxing the scans and casting their rays");
    return !context.cancelled();
  });
  if (!result.ok()) return result.status();
  const std::string report =
      nlohmann::json{{"session", record.session},
                     {"scans", result->report.scans},
                     {"scans_dropped", result->report.scans_dropped},
                     {"scans_unregistered", result->report.scans_unregistered},
                     {"key_scans", result->report.key_scans},
                     {"mean_residual_m", result->report.mean_residual_m},
                     {"drift_removed_m", result->report.drift_removed_m}}
          .dump();
  const absl::Status activated = ActivateBuilding(std::move(result->building));
  if (!activated.ok()) return activated;
  return report;
}

std::vector<RobotInfo> Site::Robots() const {
  std::map<std::string, RobotInfo> robots;
  for (const std::shared_ptr<Session>& session : Sessions()) {
    const SessionRecord record = session->record();
    RobotInfo& robot = robots[record.robot];
    robot.streaming = robot.streaming || session->streaming();
    if (!robot.session.empty() && record.last_frame_ns < robot.last_seen_ns) continue;
    robot.robot = record.robot;
    robot.site = record.site;
    robot.session = record.session;
    robot.last_seen_ns = record.last_frame_ns;
    robot.pose = session->newest_pose();
  }
  std::vector<RobotInfo> list;
  for (auto& [name, robot] : robots) list.push_back(std::move(robot));
  return list;
}

void Site::Stop(bool checkpoint) {
  for (const std::shared_ptr<Session>& session : Sessions()) session->Stop();
  if (checkpoint) region_->Checkpoint().IgnoreError();  // the journal has everything
}

}  // namespace soundmap::pipeline
