#pragma once

#include "api/access.h"
#include "pipeline/sites.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "storage/store.h"

namespace soundmap::api {

class SessionService : public v1::SessionService::CallbackService {
 public:
  SessionService(pipeline::Sites* sites, Access* access, const storage::Store* store,
                 std::function<std::int64_t()> now_ns)
      : sites_(sites), access_(access), store_(store), now_ns_(std::move(now_ns)) {}

  grpc::ServerUnaryReactor* CreateSession(grpc::CallbackServerContext* context,
                                          const v1::CreateSessionRequest* request,
                                          v1::Session* response) override;
  grpc::ServerUnaryReactor* GetSession(grpc::CallbackServerContext* context,
                                       const v1::GetSessionRequest* request,
                                       v1::Session* response) override;
  grpc::ServerUnaryReactor* ListSessions(grpc::CallbackServerContext* context,
                                         const v1::ListSessionsRequest* request,
                                         v1::ListSessionsResponse* response) override;
  grpc::ServerWriteReactor<v1::TrajectoryChunk>* GetTrajectory(
      grpc::CallbackServerContext* context, const v1::GetTrajectoryRequest* request) override;

 private:
  pipeline::Sites* const sites_;
  Access* const access_;
  const storage::Store* const store_;
  const std::function<std::int64_t()> now_ns_;
};

}  // namespace soundmap::api
