#include "api/session_service.h"

#include <limits>

#include "absl/strings/str_cat.h"
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
  const AuditedFinish finish(
      access_, context, "create session",
      absl::StrCat(request->site(), "/sessions/", request->session_id(), " of ", request->robot()));
  const auto caller = access_->CallerOf(*context);
  if (!caller.ok()) return finish(caller.status());
  const auto site_name = ParseSite(request->site());
  if (!site_name.ok()) return finish(site_name.status());
  const auto robot = ParseRobot(request->robot());
  if (!robot.ok()) return finish(robot.status());
  const absl::Status allowed = access_->Check(*caller, Right::kStream, *site_name, *robot);
  if (!allowed.ok()) return finish(allowed);
  const auto session_request = RequestFrom(*request);
  if (!session_request.ok()) return finish(session_request.status());
  const auto site = sites_->Get(*site_name);
  if (!site.ok()) return finish(site.status());
  const auto session = (*site)->CreateSession(*session_request, now_ns_());
  if (!session.ok()) return finish(session.status());
  *response = ToProto(**session);
  return finish(absl::OkStatus());
}

grpc::ServerUnaryReactor* SessionService::GetSession(grpc::CallbackServerContext* context,
                                                     const v1::GetSessionRequest* request,
                                                     v1::Session* response) {
  const auto session = FindSession(*sites_, request->name(), {access_, context, Right::kRead});
  if (!session.ok()) return Finish(context, session.status());
  *response = ToProto(**session);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SessionService::ListSessions(grpc::CallbackServerContext* context,
                                                       const v1::ListSessionsRequest* request,
                                                       v1::ListSessionsResponse* response) {
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kRead});
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
    grpc::CallbackServerContext* context, const v1::GetTrajectoryRequest* request) {
  using Reactor = StreamReactor<v1::TrajectoryChunk>;
  const auto session = FindSession(*sites_, request->name(), {access_, context, Right::kRead});
  if (!session.ok()) return new Reactor(session.status());
  const pipeline::SessionRecord record = (*session)->record();
  return new Reactor([store = store_, id = storage::SessionId{record.site, record.session},
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
