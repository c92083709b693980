#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "building/building.h"
#include "mapping/mapper.h"
#include "pipeline/band.h"
#include "pipeline/live_robots.h"
#include "pipeline/operations.h"
#include "pipeline/prepared_building.h"
#include "pipeline/profile.h"
#include "pipeline/records.h"
#include "pipeline/region.h"
#include "pipeline/session.h"
#include "pipeline/trial.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// What a robot says when it begins a drive.
struct SessionRequest {
  std::string session;
  std::string robot;
  Purpose purpose = Purpose::kListening;
  frames::Calibration calibration;
  std::optional<geometry::Pose2> initial_pose;
  std::vector<std::string> warnings;
};

// What the geometric map is to be made from.
struct MapRequest {
  // Mapping sessions, the first fixes the map frame. Empty: all that are complete, oldest first;
  // with surveyed poses the newest; with `extend` those that are not in the map yet.
  std::vector<std::string> sessions;
  std::vector<mapping::StampedPose> surveyed_poses;  // instead of registration
  bool extend = false;                               // the map, its frame and surfaces stay
};

// Which listening drives to run again, and with what.
struct TrialRequest {
  std::vector<std::string> sessions;         // empty: all that are complete
  std::vector<std::string> parameters_toml;  // one trial each, as ProfileFromToml() reads them
};

// One building with its shared maps, one a band, and the drives through it. Thread safe.
class Site : public std::enable_shared_from_this<Site> {
 public:
  static absl::StatusOr<std::shared_ptr<Site>> Open(SiteRecord record, storage::Store* store,
                                                    Session::FrameDecoder decode,
                                                    boost::asio::any_io_executor executor,
                                                    Meters* meters);

  SiteRecord record() const;
  const Profile& profile() const { return profile_; }
  const std::vector<Band>& bands() const { return bands_; }
  // The number of the map that a band's name stands for; empty: the main one. NotFound, listing the
  // site's bands.
  absl::StatusOr<std::uint8_t> FindBand(const std::string& name) const;
  // Empty for the main one.
  std::string BandName(std::uint8_t band) const;
  Region& region() { return *region_; }

  // The session, new or as it was, under a new epoch. FailedPrecondition: the site has no geometric
  // map to listen in. AlreadyExists: the session was
  // created with another robot, purpose or calibration.
  absl::StatusOr<std::shared_ptr<Session>> CreateSession(const SessionRequest& request,
                                                         std::int64_t now_ns);
  absl::StatusOr<std::shared_ptr<Session>> GetSession(const std::string& session) const;
  std::vector<std::shared_ptr<Session>> Sessions() const;  // by name
  // Null if it is not here.
  std::shared_ptr<Session> FindSession(const std::string& session) const;

  // How long the frames of a listening drive are kept from when it was begun, once they have had
  // their effect; 0: for ever. InvalidArgument: negative, or longer than 1000 years.
  absl::Status KeepFrames(std::int64_t seconds);
  // Removes the frames that are older, of a bounded number of drives at a time. Those that
  // something reads, or that cannot be removed, are tried again with the next call.
  void DropOldFrames(std::int64_t now_ns);

  // Null while there is none.
  std::shared_ptr<const building::Building> building() const;
  // Stores the building as the site's next version and puts it to use; sessions that run keep the
  // one they began with.
  // `sessions`: that it was made from.
  absl::Status ActivateBuilding(building::Building building, std::vector<std::string> sessions);

  // Makes the geometric map and puts it to use. The report of the operation is JSON.
  // FailedPrecondition: a drive has not arrived in full or does not overlap the others.
  absl::StatusOr<std::string> BuildMap(const MapRequest& request, OperationContext& context);

  // Runs listening drives again with other parameters; nothing that is stored changes. The report
  // is JSON, {"trials": [...]}, with an entry as trial.h says for each set of parameters.
  // InvalidArgument: parameters that are none, more than 1000 sets. FailedPrecondition: a drive has
  // not arrived in full.
  absl::StatusOr<std::string> TryParameters(const TrialRequest& request, OperationContext& context);

  // Takes a robot's report of the drive `session`, which need not be here yet. Aborted: a later
  // stream has been opened. InvalidArgument: the session is of another robot.
  absl::Status TakeLiveReport(const std::string& robot, const std::string& session,
                              const LiveRobots::Lease& lease, LiveReport report);
  LiveRobots& live() { return *live_; }

  // The newest known state of every robot that has had a session here or reports live, by name.
  std::vector<RobotInfo> Robots() const;

  // Stops the sessions; with `checkpoint`, writes one.
  void Stop(bool checkpoint);

 private:
  Site(SiteRecord record, Profile profile, storage::Store* store, Session::FrameDecoder decode,
       boost::asio::any_io_executor executor, Meters* meters);
  absl::StatusOr<std::shared_ptr<Session>> OpenSession(SessionRecord record);
  absl::StatusOr<std::shared_ptr<const building::Building>> LoadBuilding(
      std::int64_t version) const;
  // Of a version of the building; that of the present one is made once.
  absl::StatusOr<std::shared_ptr<const PreparedBuilding>> Prepared(std::int64_t version);
  // FailedPrecondition: one is of another purpose or has not arrived in full.
  absl::StatusOr<std::vector<SessionRecord>> NamedDrives(const std::vector<std::string>& names,
                                                         Purpose purpose) const;
  absl::StatusOr<std::vector<SessionRecord>> DrivesToMap(const MapRequest& request) const;
  absl::StatusOr<std::vector<TrialDrive>> DrivesToTry(const TrialRequest& request) const;

  const Profile profile_;
  const std::vector<Band> bands_;
  storage::Store* const store_;
  const Session::FrameDecoder decode_;
  const boost::asio::any_io_executor executor_;
  Meters* const meters_;
  std::unique_ptr<Region> region_;
  std::unique_ptr<LiveRobots> live_;

  mutable std::mutex
      mutex_;          // held while a session is made: nothing that a robot waits for needs it
  SiteRecord record_;  // guarded by mutex_
  std::shared_ptr<const building::Building> building_;  // guarded by mutex_
  std::shared_ptr<const PreparedBuilding> prepared_;    // guarded by mutex_; null: not made yet
  mutable std::mutex sessions_mutex_;                   // taken after mutex_
  std::map<std::string, std::shared_ptr<Session>> sessions_;  // guarded by sessions_mutex_
};

}  // namespace soundmap::pipeline
