#pragma once

#include <grpcpp/grpcpp.h>

#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "soundmap/v1/map_service.grpc.pb.h"
#include "soundmap/v1/operation_service.grpc.pb.h"
#include "soundmap/v1/robot_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "soundmap/v1/site_service.grpc.pb.h"
#include "soundmap/v1/sound_map_service.grpc.pb.h"
#include "soundmap/v1/tuning_service.grpc.pb.h"
#include "soundmap/v1/watch_service.grpc.pb.h"

namespace soundmap::testing {

// What the fake server knows and what it was asked. Tests fill it and look at it; every access is
// under `mutex` once the server runs.
struct FakeState {
  std::mutex mutex;
  std::condition_variable changed;

  std::map<std::string, v1::Site> sites;  // by resource name
  std::vector<v1::Session> sessions;
  std::vector<v1::Robot> robots;
  std::vector<v1::SoundSource> sources;
  std::vector<v1::VoxelChunk> voxel_chunks;
  std::vector<v1::AudioScan> scans;
  std::map<std::string, std::vector<v1::PoseEstimate>> paths;  // by session
  std::vector<v1::ExportMapResponse> export_chunks;
  grpc::Status export_status;
  // An operation takes so many waits; negative: until it is cancelled.
  int waits_until_done = 2;
  v1::Operation operation;  // the only one
  int page_size = 2;        // of every list

  struct WatchConnection {
    std::vector<v1::WatchEvent> events;
    grpc::Status end;
    bool stays_open = false;  // until the client leaves
  };
  std::vector<WatchConnection> watch_script;  // one entry a connection; the last repeats

  // So many calls, of whatever kind, fail with `failure` before one is served.
  int failures = 0;
  grpc::Status failure{grpc::StatusCode::UNAVAILABLE, "the server is starting"};

  std::map<std::string, int> calls;  // by method
  std::string authorization;         // of the last call
  v1::ListSoundSourcesRequest last_sources_request;
  v1::QueryVoxelsRequest last_voxels_request;
  v1::ExportMapRequest last_export_request;
  v1::BuildMapRequest last_build_request;
  v1::ImportMapHeader last_import_header;
  v1::TryParametersRequest last_try_request;
  std::string trials_json;  // report of a trial
  std::string imported_data;
  std::vector<v1::WatchRequest> watch_requests;
  int cancelled_watches = 0;
};

// The API in this process, on a port of its own.
class FakeServer {
 public:
  FakeServer();
  ~FakeServer();

  const std::string& address() const { return address_; }  // HOST:PORT
  FakeState& state() { return state_; }
  // Waits until `condition`, called under the mutex, holds.
  void WaitFor(const std::function<bool()>& condition);

 private:
  FakeState state_;
  std::string address_;
  std::vector<std::unique_ptr<grpc::Service>> services_;
  std::unique_ptr<grpc::Server> server_;
};

}  // namespace soundmap::testing
