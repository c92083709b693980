#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "building/building.h"
#include "mapping/mapper.h"
#include "pipeline/operations.h"
#include "pipeline/profile.h"
#include "pipeline/records.h"
#include "pipeline/region.h"
#include "pipeline/session.h"
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

// One building with its shared map, and the drives through it. Thread safe.
class Site : public std::enable_shared_from_this<Site> {
 public:
  static absl::StatusOr<std::shared_ptr<Site>> Open(SiteRecord record, storage::Store* store,
                                                    Session::FrameDecoder decode,
                                                    boost::asio::any_io_executor executor);

  SiteRecord record() const;
  const Profile& profile() const { return profile_; }
  Region& region() { return *region_; }

  // The session, new or as it was, under a new epoch. FailedPrecondition: the site has no geometric
  // map to listen in, or the robot does not say where it starts. AlreadyExists: the session was
  // created with another robot, purpose or calibration.
  absl::StatusOr<std::shared_ptr<Session>> CreateSession(const SessionRequest& request,
                                                         std::int64_t now_ns);
  absl::StatusOr<std::shared_ptr<Session>> GetSession(const std::string& session) const;
  std::vector<std::shared_ptr<Session>> Sessions() const;  // by name
  // Null if it is not here.
  std::shared_ptr<Session> FindSession(const std::string& session) const;

  // Null while there is none.
  std::shared_ptr<const building::Building> building() const;
  // Stores the building as the site's next version and puts it to use; sessions that run keep the
  // one they began with.
  absl::Status ActivateBuilding(building::Building building);

  // Makes the geometric map from a mapping session that is complete (the newest when `session` is
  // empty), with surveyed poses instead of registration if there are any. The report of the
  // operation is JSON.
  absl::StatusOr<std::string> BuildMap(const std::string& session,
                                       const std::vector<mapping::StampedPose>& surveyed_poses,
                                       OperationContext& context);

  // The newest known state of every robot that has had a session here, by name.
  std::vector<RobotInfo> Robots() const;

  // Stops the sessions; with `checkpoint`, writes one.
  void Stop(bool checkpoint);

 private:
  Site(SiteRecord record, Profile profile, storage::Store* store, Session::FrameDecoder decode,
       boost::asio::any_io_executor executor);
  absl::StatusOr<std::shared_ptr<Session>> OpenSession(SessionRecord record);
  absl::StatusOr<std::shared_ptr<const building::Building>> LoadBuilding(
      std::int64_t version) const;

  const Profile profile_;
  storage::Store* const store_;
  const Session::FrameDecoder decode_;
  const boost::asio::any_io_executor executor_;
  std::unique_ptr<Region> region_;

  mutable std::mutex mutex_;
  SiteRecord record_;                                         // guarded by mutex_
  std::shared_ptr<const building::Building> building_;        // guarded by mutex_
  std::map<std::string, std::shared_ptr<Session>> sessions_;  // guarded by mutex_
};

}  // namespace soundmap::pipeline
