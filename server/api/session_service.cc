#include "api/session_service.h"

#include <limits>

#include "api/convert.h"
#include "api/find.h"
#include "api/paging.h"
#include "api/reactors.h"
#include "pipeline/archive.h"

namespace soundmap::api {
namespace {

constexpr int kPosesPerChunk = 512;

absl::StatusOr<pipeline::SessionRequest> RequestFrom(const v1::CreateSessionRequest& proto) {
  pipeline::SessionRequest request;
  request.session = proto.session_id();
  const auto robot = ParseRobot(proto.robot());
  if (!robot.ok()) return robot.status();
  request.robot = *robot;
  switch (proto.purpose()) {
    case v1::PURPOSE_LISTENING:
      request.purpose = pipeline::Purpose::kListening;
      break;
    case v1::PURPOSE_MAPPING:
      request.purpose = pipeline::Purpose::kMapping;
      break;
    default:
      return absl::InvalidArgumentError("the session's purpose is not given");
  }
  auto calibration = FromProto(proto.calibration());
  if (!calibration.ok()) return calibration.status();
  request.calibration = *std::move(calibration);
  if (proto.has_initial_pose()) {
    const auto pose = FromProto(proto.initial_pose());
    if (!pose.ok()) return pose.status();
    request.initial_pose = *pose;
  }
  request.warnings.assign(proto.warnings().begin(), proto.warnings().end());
  return request;
}

}  // namespace

grpc::ServerUnaryReactor* SessionService::CreateSession(grpc::CallbackServerContext* context,
                                                        const v1::CreateSessionRequest* request,
                                                        v1::Session* response) {
  const auto site = FindSite(*sites_, request->site());
  if (!site.ok()) return Finish(context, site.status());
  const auto session_request = RequestFrom(*request);
  if (!session_request.ok()) return Finish(context, session_request.status());
  const auto session = (*site)->CreateSession(*session_request, now_ns_());
  if (!session.ok()) return Finish(context, session.status());
  *response = ToProto(**session);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SessionService::GetSession(grpc::CallbackServerContext* context,
                                                     const v1::GetSessionRequest* request,
                                                     v1::Session* response) {
  const auto session = FindSession(*sites_, request->name());
  if (!session.ok()) return Finish(context, session.status());
  *response = ToProto(**session);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SessionService::ListSessions(grpc::CallbackServerContext* context,
                                                       const v1::ListSessionsRequest* request,
                                                       v1::ListSessionsResponse* response) {
  const auto site = FindSite(*sites_, request->site());
  if (!site.ok()) return Finish(context, site.status());
  std::vector<v1::Session> sessions;
  for (const auto& session : (*site)->Sessions()) {
    v1::Session proto = ToProto(*session);
    if (request->robot().empty() || proto.robot() == request->robot()) {
      sessions.push_back(std::move(proto));
    }
  }
  const auto page = PageOf(sessions.size(), request->page_size(), request->page_token());
  if (!page.ok()) return Finish(context, page.status());
  for (std::size_t i = page->begin; i < page->end; ++i) {
    *response->add_sessions() = std::move(sessions[i]);
  }
  response->set_next_page_token(page->next_token);
  return Finish(context, absl::OkStatus());
}

grpc::ServerWriteReactor<v1::TrajectoryChunk>* SessionService::GetTrajectory(
    grpc::CallbackServerContext*, const v1::GetTrajectoryRequest* request) {
  using Reactor = StreamReactor<v1::TrajectoryChunk>;
  const auto name = ParseSession(request->name());
  if (!name.ok()) return new Reactor(name.status());
  const auto session = FindSession(*sites_, request->name());
  if (!session.ok()) return new Reactor(session.status());
  return new Reactor([store = store_, id = storage::SessionId{name->site, name->session},
                      from_ns = std::numeric_limits<frames::TimeNs>::min()](
                         v1::TrajectoryChunk& chunk) mutable -> absl::StatusOr<bool> {
    // Cancelled is how this reading is stopped when the chunk is full.
    const absl::Status read =
        store->ReadTrajectory(id, from_ns, std::numeric_limits<frames::TimeNs>::max(),
                              [&](const storage::TrajectoryEntry& entry) -> absl::Status {
                                if (chunk.poses_size() == kPosesPerChunk)
                                  return absl::CancelledError("");
                                const auto pose = pipeline::DecodePose(entry.pose);
                                if (!pose.ok()) return pose.status();
                                *chunk.add_poses() = ToProto(*pose);
                                from_ns = entry.time_ns + 1;
                                return absl::OkStatus();
                              });
    if (!read.ok() && !absl::IsCancelled(read)) return read;
    return chunk.poses_size() > 0;
  });
}

}  // namespace soundmap::api
