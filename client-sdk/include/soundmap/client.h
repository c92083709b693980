#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "soundmap/map_files.h"
#include "soundmap/options.h"
#include "soundmap/poses.h"
#include "soundmap/resources.h"
#include "soundmap/sound.h"
#include "soundmap/watch.h"

namespace soundmap {

// A connection to a sound map server. Cheap to copy (copies share the connection); any thread may
// call any method.
//
// Methods block. Errors are the server's status, or Unavailable when it cannot be reached, or
// DeadlineExceeded; the message is one sentence that names the thing at fault. Reads are tried
// again on Unavailable (RetryOptions); changes are sent once. Callbacks run on the calling thread.
class Client {
 public:
  // Does not wait for the server. InvalidArgument: `server` is not HOST:PORT, or a token would
  // travel unencrypted.
  static absl::StatusOr<Client> Connect(const ClientOptions& options);

  // `profile`: "default" or "paper"; `bands`: with sound maps of their own. AlreadyExists.
  absl::StatusOr<Site> CreateSite(const std::string& site, const std::string& profile = "default",
                                  const std::vector<Band>& bands = {});
  absl::StatusOr<Site> GetSite(const std::string& site);
  absl::StatusOr<std::vector<Site>> ListSites();
  // How long the site keeps the frames of a listening drive from when it was begun; 0: for ever.
  absl::StatusOr<Site> KeepFrames(const std::string& site, std::int64_t seconds);
  // With its map, sessions and recordings.
  absl::Status DeleteSite(const std::string& site);

  // Makes the geometric map and waits until it is in use. Cancelled when `progress` said so.
  absl::StatusOr<Operation> BuildMap(const BuildMapRequest& request,
                                     const ProgressCallback& progress = {});
  // The extension of `path` (.bt .ot .ply .pcd .yaml) is the format; a ROS map's .yaml brings the
  // image that it names.
  absl::StatusOr<Operation> ImportMap(const std::string& site, const std::string& path,
                                      const ProgressCallback& progress = {});
  // Writes to `path`, whole or not at all. "yaml" also writes an image beside it.
  absl::StatusOr<ExportedMap> ExportMap(const ExportMapRequest& request, const std::string& path,
                                        const BytesCallback& progress = {});

  // Runs listening drives again with other parameters; the site's map stays as it is. The
  // operation's report is {"trials": [{"audio_scans", "sources": [{"position_m", "extent_m",
  // "probability", "evidence_count"}]}]}. Cancelled when `progress` said so.
  absl::StatusOr<Operation> TryParameters(const TryParametersRequest& request,
                                          const ProgressCallback& progress = {});

  absl::StatusOr<SoundSource> GetSoundSource(const std::string& site, const std::string& source);
  absl::StatusOr<SoundSourceList> ListSoundSources(const SoundSourceQuery& query);
  // Calls `chunk` with one or more pieces (one without voxels, if there are none) of one revision
  // until it returns false.
  absl::Status QueryVoxels(const VoxelQuery& query,
                           const std::function<bool(const VoxelColumns&)>& chunk);
  // Oldest first.
  absl::StatusOr<std::vector<AudioScan>> ListAudioScans(const AudioScanQuery& query);

  absl::StatusOr<Robot> GetRobot(const std::string& robot);
  // Of one site; of all with an empty `site`.
  absl::StatusOr<std::vector<Robot>> ListRobots(const std::string& site);

  absl::StatusOr<Session> GetSession(const std::string& site, const std::string& session);
  // Of one robot; of all with an empty `robot`.
  absl::StatusOr<std::vector<Session>> ListSessions(const std::string& site,
                                                    const std::string& robot = "");
  // The path that the server estimated, oldest first.
  absl::StatusOr<std::vector<PoseEstimate>> GetTrajectory(const std::string& site,
                                                          const std::string& session);

  // Tells what happens at a site until `callback` returns false or `stop` is requested (then OK).
  // Connects again, and goes on where it stopped, when the connection breaks.
  absl::Status Watch(const WatchRequest& request, const WatchCallback& callback,
                     std::stop_token stop = {});

  absl::StatusOr<Operation> GetOperation(const std::string& operation);
  // Of one site; of all with an empty `site`.
  absl::StatusOr<std::vector<Operation>> ListOperations(const std::string& site);
  // Waits until it is done; its error becomes the status.
  absl::StatusOr<Operation> WaitOperation(const std::string& operation,
                                          const ProgressCallback& progress = {});
  absl::StatusOr<Operation> CancelOperation(const std::string& operation);

  // Copies all that the server keeps into a folder of this name on the server, and waits for it.
  absl::StatusOr<Operation> CreateBackup(const std::string& backup,
                                         const ProgressCallback& progress = {});

 private:
  class Connection;
  explicit Client(std::shared_ptr<Connection> connection);
  std::shared_ptr<Connection> connection_;
};

}  // namespace soundmap
