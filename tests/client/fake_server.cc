#include "fake_server.h"

#include <google/protobuf/util/field_mask_util.h>

#include <algorithm>
#include <chrono>

namespace soundmap::testing {
namespace {

using grpc::ServerContext;
using grpc::Status;
using grpc::StatusCode;

// Locks the state, counts the call and says whether it fails.
class Call {
 public:
  Call(FakeState& state, const ServerContext* context, const std::string& method)
      : state_(state), lock_(state.mutex) {
    ++state.calls[method];
    const auto& metadata = context->client_metadata();
    const auto found = metadata.find("authorization");
    state.authorization =
        found == metadata.end() ? "" : std::string(found->second.data(), found->second.size());
    if (state.failures > 0) {
      --state.failures;
      status_ = state.failure;
    }
    state.changed.notify_all();
  }
  bool fails() const { return !status_.ok(); }
  const Status& status() const { return status_; }
  std::unique_lock<std::mutex>& lock() { return lock_; }

 private:
  FakeState& state_;
  std::unique_lock<std::mutex> lock_;
  Status status_;
};

// Page tokens are indices.
template <typename Items, typename Request, typename Add, typename Response>
void Page(const Items& items, int page_size, const Request& request, Response* response,
          const Add& add) {
  std::size_t i = request.page_token().empty() ? 0 : std::stoul(request.page_token());
  for (int n = 0; n < page_size && i < items.size(); ++n, ++i) add(items[i]);
  if (i < items.size()) response->set_next_page_token(std::to_string(i));
}

class Sites : public v1::SiteService::Service {
 public:
  explicit Sites(FakeState& state) : state_(state) {}
  Status CreateSite(ServerContext* context, const v1::CreateSiteRequest* request,
                    v1::Site* response) override {
    Call call(state_, context, "CreateSite");
    if (call.fails()) return call.status();
    const std::string name = "sites/" + request->site_id();
    if (state_.sites.contains(name)) {
      return {StatusCode::ALREADY_EXISTS, "the site " + request->site_id() + " exists already"};
    }
    response->set_name(name);
    response->set_profile(request->profile());
    *response->mutable_bands() = request->bands();
    response->set_max_range_m(10.0);
    response->set_voxel_size_m(0.05);
    state_.sites[name] = *response;
    return Status::OK;
  }
  Status GetSite(ServerContext* context, const v1::GetSiteRequest* request,
                 v1::Site* response) override {
    Call call(state_, context, "GetSite");
    if (call.fails()) return call.status();
    const auto found = state_.sites.find(request->name());
    if (found == state_.sites.end()) {
      return {StatusCode::NOT_FOUND, "there is no " + request->name()};
    }
    *response = found->second;
    return Status::OK;
  }
  Status ListSites(ServerContext* context, const v1::ListSitesRequest* request,
                   v1::ListSitesResponse* response) override {
    Call call(state_, context, "ListSites");
    if (call.fails()) return call.status();
    std::vector<v1::Site> sites;
    for (const auto& [name, site] : state_.sites) sites.push_back(site);
    Page(sites, state_.page_size, *request, response,
         [&](const v1::Site& site) { *response->add_sites() = site; });
    return Status::OK;
  }
  Status UpdateSite(ServerContext* context, const v1::UpdateSiteRequest* request,
                    v1::Site* response) override {
    Call call(state_, context, "UpdateSite");
    if (call.fails()) return call.status();
    const auto found = state_.sites.find(request->site().name());
    if (found == state_.sites.end()) {
      return {StatusCode::NOT_FOUND, "there is no " + request->site().name()};
    }
    google::protobuf::util::FieldMaskUtil::MergeMessageTo(request->site(), request->update_mask(),
                                                          {}, &found->second);
    *response = found->second;
    return Status::OK;
  }
  Status DeleteSite(ServerContext* context, const v1::DeleteSiteRequest* request,
                    v1::DeleteSiteResponse*) override {
    Call call(state_, context, "DeleteSite");
    if (call.fails()) return call.status();
    if (state_.sites.erase(request->name()) == 0) {
      return {StatusCode::NOT_FOUND, "there is no " + request->name()};
    }
    return Status::OK;
  }

 private:
  FakeState& state_;
};

class Maps : public v1::MapService::Service {
 public:
  explicit Maps(FakeState& state) : state_(state) {}
  Status BuildMap(ServerContext* context, const v1::BuildMapRequest* request,
                  v1::Operation* response) override {
    Call call(state_, context, "BuildMap");
    if (call.fails()) return call.status();
    state_.last_build_request = *request;
    Start("build_map", request->site(), response);
    return Status::OK;
  }
  Status ImportMap(ServerContext* context, grpc::ServerReader<v1::ImportMapRequest>* reader,
                   v1::Operation* response) override {
    {
      Call call(state_, context, "ImportMap");
      if (call.fails()) return call.status();
    }
    v1::ImportMapRequest message;
    std::string data;
    v1::ImportMapHeader header;
    while (reader->Read(&message)) {
      if (message.has_header()) header = message.header();
      data += message.data();
    }
    const std::lock_guard lock(state_.mutex);
    state_.last_import_header = header;
    state_.imported_data = data;
    Start("import_map", header.site(), response);
    return Status::OK;
  }
  Status ExportMap(ServerContext* context, const v1::ExportMapRequest* request,
                   grpc::ServerWriter<v1::ExportMapResponse>* writer) override {
    Call call(state_, context, "ExportMap");
    if (call.fails()) return call.status();
    state_.last_export_request = *request;
    for (const auto& chunk : state_.export_chunks) writer->Write(chunk);
    return state_.export_status;
  }

 private:
  void Start(const std::string& kind, const std::string& site, v1::Operation* response) {
    state_.operation.set_name("operations/7");
    state_.operation.set_kind(kind);
    state_.operation.set_site(site);
    *response = state_.operation;
  }
  FakeState& state_;
};

class Operations : public v1::OperationService::Service {
 public:
  explicit Operations(FakeState& state) : state_(state) {}
  Status GetOperation(ServerContext* context, const v1::GetOperationRequest* request,
                      v1::Operation* response) override {
    Call call(state_, context, "GetOperation");
    if (call.fails()) return call.status();
    if (request->name() != state_.operation.name()) {
      return {StatusCode::NOT_FOUND, "there is no " + request->name()};
    }
    *response = state_.operation;
    return Status::OK;
  }
  Status ListOperations(ServerContext* context, const v1::ListOperationsRequest*,
                        v1::ListOperationsResponse* response) override {
    Call call(state_, context, "ListOperations");
    if (call.fails()) return call.status();
    if (!state_.operation.name().empty()) *response->add_operations() = state_.operation;
    return Status::OK;
  }
  Status WaitOperation(ServerContext* context, const v1::WaitOperationRequest* request,
                       v1::Operation* response) override {
    Call call(state_, context, "WaitOperation");
    if (call.fails()) return call.status();
    if (state_.waits_until_done > 0 && --state_.waits_until_done == 0) {
      state_.operation.set_done(true);
      state_.operation.set_progress(1.0);
    } else if (!state_.operation.done()) {
      state_.changed.wait_for(call.lock(), std::chrono::milliseconds(request->timeout_ms()),
                              [this] { return state_.operation.done(); });
      state_.operation.set_progress(0.5);
    }
    *response = state_.operation;
    return Status::OK;
  }
  Status CancelOperation(ServerContext* context, const v1::CancelOperationRequest*,
                         v1::Operation* response) override {
    Call call(state_, context, "CancelOperation");
    if (call.fails()) return call.status();
    state_.operation.set_done(true);
    state_.operation.set_error_code(1);
    state_.operation.set_error_message("the operation was cancelled");
    *response = state_.operation;
    return Status::OK;
  }

 private:
  FakeState& state_;
};

class Tuning : public v1::TuningService::Service {
 public:
  explicit Tuning(FakeState& state) : state_(state) {}

  Status TryParameters(ServerContext* context, const v1::TryParametersRequest* request,
                       v1::Operation* response) override {
    Call call(state_, context, "TryParameters");
    if (call.fails()) return call.status();
    state_.last_try_request = *request;
    state_.operation.set_name("operations/7");
    state_.operation.set_kind("try_parameters");
    state_.operation.set_report_json(state_.trials_json);
    *response = state_.operation;
    return Status::OK;
  }

 private:
  FakeState& state_;
};

class Sessions : public v1::SessionService::Service {
 public:
  explicit Sessions(FakeState& state) : state_(state) {}
  Status GetSession(ServerContext* context, const v1::GetSessionRequest* request,
                    v1::Session* response) override {
    Call call(state_, context, "GetSession");
    if (call.fails()) return call.status();
    for (const auto& session : state_.sessions) {
      if (session.name() != request->name()) continue;
      *response = session;
      return Status::OK;
    }
    return {StatusCode::NOT_FOUND, "there is no " + request->name()};
  }
  Status ListSessions(ServerContext* context, const v1::ListSessionsRequest* request,
                      v1::ListSessionsResponse* response) override {
    Call call(state_, context, "ListSessions");
    if (call.fails()) return call.status();
    std::vector<v1::Session> sessions = state_.sessions;
    std::erase_if(sessions, [&](const v1::Session& session) {
      return !request->robot().empty() && session.robot() != request->robot();
    });
    Page(sessions, state_.page_size, *request, response,
         [&](const v1::Session& session) { *response->add_sessions() = session; });
    return Status::OK;
  }
  Status GetTrajectory(ServerContext* context, const v1::GetTrajectoryRequest* request,
                       grpc::ServerWriter<v1::TrajectoryChunk>* writer) override {
    Call call(state_, context, "GetTrajectory");
    if (call.fails()) return call.status();
    for (const auto& pose : state_.paths[request->name()]) {
      v1::TrajectoryChunk chunk;
      *chunk.add_poses() = pose;
      writer->Write(chunk);
    }
    return Status::OK;
  }

 private:
  FakeState& state_;
};

class Robots : public v1::RobotService::Service {
 public:
  explicit Robots(FakeState& state) : state_(state) {}
  Status ListRobots(ServerContext* context, const v1::ListRobotsRequest* request,
                    v1::ListRobotsResponse* response) override {
    Call call(state_, context, "ListRobots");
    if (call.fails()) return call.status();
    Page(state_.robots, state_.page_size, *request, response,
         [&](const v1::Robot& robot) { *response->add_robots() = robot; });
    return Status::OK;
  }

 private:
  FakeState& state_;
};

class SoundMaps : public v1::SoundMapService::Service {
 public:
  explicit SoundMaps(FakeState& state) : state_(state) {}
  Status ListSoundSources(ServerContext* context, const v1::ListSoundSourcesRequest* request,
                          v1::ListSoundSourcesResponse* response) override {
    Call call(state_, context, "ListSoundSources");
    if (call.fails()) return call.status();
    state_.last_sources_request = *request;
    response->set_revision(12);
    response->set_as_of_ns(1'000'000'000'000);
    Page(state_.sources, state_.page_size, *request, response,
         [&](const v1::SoundSource& source) { *response->add_sound_sources() = source; });
    return Status::OK;
  }
  Status QueryVoxels(ServerContext* context, const v1::QueryVoxelsRequest* request,
                     grpc::ServerWriter<v1::VoxelChunk>* writer) override {
    Call call(state_, context, "QueryVoxels");
    if (call.fails()) return call.status();
    state_.last_voxels_request = *request;
    for (const auto& chunk : state_.voxel_chunks) writer->Write(chunk);
    return Status::OK;
  }
  Status ListAudioScans(ServerContext* context, const v1::ListAudioScansRequest* request,
                        v1::ListAudioScansResponse* response) override {
    Call call(state_, context, "ListAudioScans");
    if (call.fails()) return call.status();
    Page(state_.scans, state_.page_size, *request, response,
         [&](const v1::AudioScan& scan) { *response->add_audio_scans() = scan; });
    return Status::OK;
  }

 private:
  FakeState& state_;
};

class Watches : public v1::WatchService::Service {
 public:
  explicit Watches(FakeState& state) : state_(state) {}
  Status Watch(ServerContext* context, const v1::WatchRequest* request,
               grpc::ServerWriter<v1::WatchEvent>* writer) override {
    FakeState::WatchConnection connection;
    {
      Call call(state_, context, "Watch");
      if (call.fails()) return call.status();
      const std::size_t i = std::min(state_.watch_requests.size(), state_.watch_script.size() - 1);
      state_.watch_requests.push_back(*request);
      connection = state_.watch_script[i];
    }
    for (const auto& event : connection.events) writer->Write(event);
    v1::WatchEvent heartbeat;
    heartbeat.mutable_heartbeat();
    while (connection.stays_open && writer->Write(heartbeat)) {
      std::unique_lock lock(state_.mutex);
      state_.changed.wait_for(lock, std::chrono::milliseconds(5));
    }
    if (context->IsCancelled()) {
      const std::lock_guard lock(state_.mutex);
      ++state_.cancelled_watches;
      state_.changed.notify_all();
    }
    return connection.end;
  }

 private:
  FakeState& state_;
};

}  // namespace

FakeServer::FakeServer() {
  services_.push_back(std::make_unique<Sites>(state_));
  services_.push_back(std::make_unique<Maps>(state_));
  services_.push_back(std::make_unique<Operations>(state_));
  services_.push_back(std::make_unique<Sessions>(state_));
  services_.push_back(std::make_unique<Robots>(state_));
  services_.push_back(std::make_unique<SoundMaps>(state_));
  services_.push_back(std::make_unique<Watches>(state_));
  services_.push_back(std::make_unique<Tuning>(state_));
  grpc::ServerBuilder builder;
  int port = 0;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
  for (const auto& service : services_) builder.RegisterService(service.get());
  server_ = builder.BuildAndStart();
  address_ = "127.0.0.1:" + std::to_string(port);
}

FakeServer::~FakeServer() {
  server_->Shutdown(std::chrono::system_clock::now());
  server_->Wait();
}

void FakeServer::WaitFor(const std::function<bool()>& condition) {
  std::unique_lock lock(state_.mutex);
  state_.changed.wait(lock, condition);
}

}  // namespace soundmap::testing
