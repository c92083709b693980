#include "pipeline/site.h"

#include <algorithm>
#include <iterator>
#include <tuple>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "building/stored_building.h"
#include "pipeline/archive.h"
#include "pipeline/map_drives.h"
#include "storage/names.h"

namespace soundmap::pipeline {
namespace {

constexpr std::size_t kMaxTrials = 1000;
constexpr std::int64_t kMaxKeep_s = 1000ll * 366 * 86400;
// Drives whose frames are removed in one go, each some milliseconds of a thread.
constexpr int kMaxDrops = 16;

bool IsOlder(const SessionRecord& a, const SessionRecord& b) {
  return std::tie(a.create_time_ns, a.session) < std::tie(b.create_time_ns, b.session);
}

std::string BuildingKey(const std::string& site, std::int64_t version) {
  return absl::StrCat(site, "/", absl::StrFormat("%08d", version));
}

}  // namespace

Site::Site(SiteRecord record, Profile profile, storage::Store* store, Session::FrameDecoder decode,
           boost::asio::any_io_executor executor, Meters* meters)
    : profile_(std::move(profile)),
      bands_(record.bands),
      store_(store),
      decode_(std::move(decode)),
      executor_(std::move(executor)),
      meters_(meters),
      record_(std::move(record)) {}

absl::StatusOr<std::shared_ptr<Site>> Site::Open(SiteRecord record, storage::Store* store,
                                                 Session::FrameDecoder decode,
                                                 boost::asio::any_io_executor executor,
                                                 Meters* meters) {
  auto profile = ProfileFromToml(record.parameters_toml);
  if (!profile.ok()) return profile.status();
  const std::string name = record.site;
  std::shared_ptr<Site> site(new Site(std::move(record), *std::move(profile), store,
                                      std::move(decode), std::move(executor), meters));
  auto region = Region::Open(name, store, site->profile_.sound_map, 1 + site->bands_.size());
  if (!region.ok()) return region.status();
  site->region_ = *std::move(region);
  site->live_ = std::make_unique<LiveRobots>(&site->region_->events());
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
  site->region_->FindSources();  // the sessions may have brought evidence
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

absl::StatusOr<std::shared_ptr<const PreparedBuilding>> Site::Prepared(std::int64_t version) {
  if (prepared_ && version == record_.building_version) return prepared_;
  auto building = LoadBuilding(version);
  if (!building.ok()) return building.status();
  auto prepared = PreparedBuilding::Create(profile_, **building);
  if (prepared.ok() && version == record_.building_version) prepared_ = *prepared;
  return prepared;
}

absl::StatusOr<std::shared_ptr<Session>> Site::OpenSession(SessionRecord record) {
  Session::Site parts{store_,  region_.get(), &profile_, &bands_,
                      nullptr, decode_,       executor_, meters_};
  if (record.purpose == Purpose::kListening && !record.complete) {
    auto prepared = Prepared(record.building_version);
    if (!prepared.ok()) return prepared.status();
    parts.building = *std::move(prepared);
  }
  return Session::Open(std::move(record), std::move(parts));
}

absl::StatusOr<std::uint8_t> Site::FindBand(const std::string& name) const {
  if (name.empty()) return kMainBand;
  std::vector<std::string> names;
  for (std::size_t i = 0; i < bands_.size(); ++i) {
    if (bands_[i].name == name) return static_cast<std::uint8_t>(1 + i);
    names.push_back(bands_[i].name);
  }
  return absl::NotFoundError(absl::StrCat(
      "site '", record().site, "' has no band '", name, "'",
      names.empty() ? "; it has none" : absl::StrCat("; it has ", absl::StrJoin(names, ", "))));
}

std::string Site::BandName(std::uint8_t band) const {
  return band == kMainBand ? "" : bands_[band - 1].name;
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
  if (const auto known = FindSession(request.session)) {
    const SessionRecord record = known->record();
    if (record.robot != request.robot || record.purpose != request.purpose) {
      return absl::AlreadyExistsError(
          absl::StrCat("session '", request.session, "' exists already, for robot '", record.robot,
                       "' and another purpose or robot than was asked for"));
    }
    const auto epoch = known->NextEpoch();
    if (!epoch.ok()) return epoch.status();
    return known;
  }
  if (request.purpose == Purpose::kListening) {
    if (!building_) {
      return absl::FailedPreconditionError(absl::StrCat(
          "site '", record_.site,
          "' has no geometric map; replay a mapping drive and run `soundmap map build ",
          record_.site, "`, or import a map"));
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
  std::lock_guard sessions_lock(sessions_mutex_);
  sessions_[record.session] = *session;
  return session;
}

absl::StatusOr<std::shared_ptr<Session>> Site::GetSession(const std::string& name) const {
  if (auto session = FindSession(name)) return session;
  return absl::NotFoundError(
      absl::StrCat("session '", name, "' does not exist at site '", record().site, "'"));
}

std::shared_ptr<Session> Site::FindSession(const std::string& name) const {
  std::lock_guard lock(sessions_mutex_);
  const auto found = sessions_.find(name);
  return found == sessions_.end() ? nullptr : found->second;
}

std::vector<std::shared_ptr<Session>> Site::Sessions() const {
  std::lock_guard lock(sessions_mutex_);
  std::vector<std::shared_ptr<Session>> sessions;
  for (const auto& [name, session] : sessions_) sessions.push_back(session);
  return sessions;
}

absl::Status Site::KeepFrames(std::int64_t seconds) {
  if (seconds < 0 || seconds > kMaxKeep_s) {
    return absl::InvalidArgumentError(absl::StrCat("frames can be kept for 0 (for ever) to ",
                                                   kMaxKeep_s, " s, not for ", seconds, " s"));
  }
  std::lock_guard lock(mutex_);
  SiteRecord record = record_;
  record.keep_frames_s = seconds;
  const absl::Status stored = store_->PutRecord(storage::Table::kSite, record.site, ToJson(record));
  if (stored.ok()) record_ = std::move(record);
  return stored;
}

void Site::DropOldFrames(std::int64_t now_ns) {
  const std::int64_t keep_s = record().keep_frames_s;
  if (keep_s == 0) return;
  const std::int64_t begun_before_ns = now_ns - frames::NsFromSeconds(static_cast<double>(keep_s));
  int dropped = 0;
  for (const std::shared_ptr<Session>& session : Sessions()) {
    if (dropped == kMaxDrops) return;
    const absl::StatusOr<bool> done = session->DropFrames(begun_before_ns);
    if (done.ok() && *done) ++dropped;
  }
}

std::shared_ptr<const building::Building> Site::building() const {
  std::lock_guard lock(mutex_);
  return building_;
}

absl::Status Site::ActivateBuilding(building::Building building,
                                    std::vector<std::string> sessions) {
  // A plan that cannot be localized in is refused here, not when the first robot comes.
  auto prepared = PreparedBuilding::Create(profile_, building);
  if (!prepared.ok()) return prepared.status();
  const std::string bytes = building::SerializeBuilding(building);
  std::lock_guard lock(mutex_);
  SiteRecord record = record_;
  ++record.building_version;
  record.building_sessions = std::move(sessions);
  absl::Status stored = store_->PutRecord(storage::Table::kBuilding,
                                          BuildingKey(record.site, record.building_version), bytes);
  if (stored.ok()) stored = store_->PutRecord(storage::Table::kSite, record.site, ToJson(record));
  if (!stored.ok()) return stored;
  record_ = std::move(record);
  building_ = std::make_shared<const building::Building>(std::move(building));
  prepared_ = *std::move(prepared);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<SessionRecord>> Site::NamedDrives(const std::vector<std::string>& names,
                                                             Purpose purpose) const {
  const char* const kind = purpose == Purpose::kMapping ? "mapping" : "listening";
  std::vector<SessionRecord> drives;
  for (const std::string& name : names) {
    auto session = GetSession(name);
    if (!session.ok()) return session.status();
    drives.push_back((*session)->record());
    if (drives.back().purpose != purpose) {
      return absl::FailedPreconditionError(
          absl::StrCat("session '", name, "' is not a ", kind, " drive"));
    }
    if (!drives.back().complete) {
      return absl::FailedPreconditionError(
          absl::StrCat("the ", kind, " drive '", name, "' has not arrived in full"));
    }
    if (drives.back().frames_dropped) {
      return absl::FailedPreconditionError(
          absl::StrCat("the frames of the ", kind, " drive '", name, "' are not kept any more"));
    }
  }
  return drives;
}

absl::StatusOr<std::vector<SessionRecord>> Site::DrivesToMap(const MapRequest& request) const {
  if (!request.sessions.empty()) return NamedDrives(request.sessions, Purpose::kMapping);

  std::vector<SessionRecord> drives;
  const std::vector<std::string> mapped = record().building_sessions;
  int incomplete = 0;
  for (const std::shared_ptr<Session>& session : Sessions()) {
    SessionRecord drive = session->record();
    if (drive.purpose != Purpose::kMapping) continue;
    if (request.extend && std::find(mapped.begin(), mapped.end(), drive.session) != mapped.end()) {
      continue;
    }
    if (drive.complete) {
      drives.push_back(std::move(drive));
    } else {
      ++incomplete;
    }
  }
  if (drives.empty()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "site '", record().site, "' has no ",
        request.extend ? "mapping drive that is not in its map yet" : "mapping drive",
        incomplete > 0 ? " and has arrived in full" : "; replay one with --purpose mapping"));
  }
  std::sort(drives.begin(), drives.end(), IsOlder);
  if (!request.surveyed_poses.empty()) drives.erase(drives.begin(), std::prev(drives.end()));
  return drives;
}

absl::StatusOr<std::string> Site::BuildMap(const MapRequest& request, OperationContext& context) {
  const auto drives = DrivesToMap(request);
  if (!drives.ok()) return drives.status();
  std::vector<std::string> sessions;
  std::shared_ptr<const building::Building> present;
  if (request.extend) {
    present = building();
    if (!present) {
      return absl::FailedPreconditionError(
          absl::StrCat("site '", record().site, "' has no map to extend"));
    }
    sessions = record().building_sessions;
  }
  for (const SessionRecord& drive : *drives) sessions.push_back(drive.session);
  auto map =
      MapDrives(*drives, request.surveyed_poses, present, profile_, store_, decode_, context);
  if (!map.ok()) return map.status();
  const absl::Status activated = ActivateBuilding(std::move(map->building), std::move(sessions));
  if (!activated.ok()) return activated;
  return map->report_json;
}

absl::StatusOr<std::vector<TrialDrive>> Site::DrivesToTry(const TrialRequest& request) const {
  auto records = NamedDrives(request.sessions, Purpose::kListening);
  if (!records.ok()) return records.status();
  if (request.sessions.empty()) {
    for (const std::shared_ptr<Session>& session : Sessions()) {
      SessionRecord drive = session->record();
      if (drive.purpose == Purpose::kListening && drive.complete && !drive.frames_dropped) {
        records->push_back(std::move(drive));
      }
    }
    std::sort(records->begin(), records->end(), IsOlder);
  }
  if (records->empty()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "site '", record().site, "' has no listening drive that has arrived in full and is kept"));
  }
  std::map<std::int64_t, std::shared_ptr<const building::Building>> buildings;
  std::vector<TrialDrive> drives;
  for (SessionRecord& drive : *records) {
    std::shared_ptr<const building::Building>& building = buildings[drive.building_version];
    if (!building) {
      auto loaded = LoadBuilding(drive.building_version);
      if (!loaded.ok()) return loaded.status();
      building = *std::move(loaded);
    }
    drives.push_back({std::move(drive), building});
  }
  return drives;
}

absl::StatusOr<std::string> Site::TryParameters(const TrialRequest& request,
                                                OperationContext& context) {
  if (request.parameters_toml.empty() || request.parameters_toml.size() > kMaxTrials) {
    return absl::InvalidArgumentError(absl::StrCat("a trial needs 1 to ", kMaxTrials,
                                                   " sets of parameters, not ",
                                                   request.parameters_toml.size()));
  }
  std::vector<Profile> profiles;
  for (const std::string& text : request.parameters_toml) {
    auto profile = ProfileFromToml(text);
    if (!profile.ok()) {
      return absl::InvalidArgumentError(absl::StrCat(
          "set ", profiles.size(), " of parameters: ", std::string(profile.status().message())));
    }
    profiles.push_back(*std::move(profile));
  }
  const auto drives = DrivesToTry(request);
  if (!drives.ok()) return drives.status();
  std::vector<std::string> trials;
  for (const Profile& profile : profiles) {
    const std::string text =
        absl::StrCat("trying set ", trials.size() + 1, " of ", profiles.size());
    const auto trial =
        pipeline::TryParameters(*drives, profile, store_, decode_, [&](double share) {
          context.Report(
              (static_cast<double>(trials.size()) + share) / static_cast<double>(profiles.size()),
              text);
          return !context.cancelled();
        });
    if (!trial.ok()) return trial.status();
    trials.push_back(ToJson(*trial));
  }
  return absl::StrCat("{\"trials\":[", absl::StrJoin(trials, ","), "]}");
}

absl::Status Site::TakeLiveReport(const std::string& robot, const std::string& session,
                                  const LiveRobots::Lease& lease, LiveReport report) {
  const std::shared_ptr<Session> drive = FindSession(session);
  if (drive && drive->robot() != robot) {
    return absl::InvalidArgumentError(
        absl::StrCat("session '", session, "' is of robot '", drive->robot(), "'"));
  }
  const std::optional<ClockOffset> clock_offset = report.clock_offset;
  LiveView view{session, std::move(report), std::chrono::steady_clock::now(), std::nullopt, 0};
  const auto frame = drive ? drive->odometry_frame() : std::nullopt;
  if (frame && view.report.odometry) {
    view.map_from_base = frame->map_from_odom * view.report.odometry->odom_from_base;
    view.localized_ns = frame->stamp_ns;
  }
  const absl::Status reported = live_->Report(robot, lease, std::move(view));
  if (reported.ok() && drive && clock_offset) drive->TakeClockOffset(*clock_offset);
  return reported;
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
    robot.lost_frames = record.lost_frames();
    robot.clock_offset = record.newest_offset();
  }
  const std::string site = record().site;
  for (auto& [name, view] : live_->List()) {
    RobotInfo& robot = robots[name];
    robot.robot = name;
    robot.site = site;
    if (view.report.clock_offset) robot.clock_offset = view.report.clock_offset;
    robot.live = std::move(view);
  }
  std::vector<RobotInfo> list;
  list.reserve(robots.size());
  for (auto& [name, robot] : robots) list.push_back(std::move(robot));
  return list;
}

void Site::Stop(bool checkpoint) {
  const std::vector<std::shared_ptr<Session>> sessions = Sessions();
  for (const std::shared_ptr<Session>& session : sessions) session->AskToStop();
  for (const std::shared_ptr<Session>& session : sessions) session->Stop();
  if (checkpoint) region_->Checkpoint().IgnoreError();  // the journal has everything
}

}  // namespace soundmap::pipeline
