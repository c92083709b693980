#include "soundmap/client.h"

#include <algorithm>
#include <utility>

#include "absl/random/random.h"
#include "absl/strings/str_cat.h"
#include "connection.h"
#include "convert.h"

namespace soundmap {
namespace {

using internal::FromProto;

constexpr int kPageSize = 1000;
constexpr std::chrono::milliseconds kWaitSlice{500};

// So that a server can tell a repeated change from a second one.
std::string RequestId() {
  absl::BitGen random;
  return absl::StrCat(absl::Hex(absl::Uniform<std::uint64_t>(random), absl::kZeroPad16),
                      absl::Hex(absl::Uniform<std::uint64_t>(random), absl::kZeroPad16));
}

// Calls `page(request)` -> StatusOr<response> until no page follows.
template <typename Request, typename Page>
absl::Status ForEachPage(Request request, const Page& page) {
  request.set_page_size(kPageSize);
  for (;;) {
    auto response = page(request);
    if (!response.ok()) return response.status();
    if (response->next_page_token().empty()) return absl::OkStatus();
    if (response->next_page_token() == request.page_token()) {
      return absl::InternalError("the server repeats a page of its answer");
    }
    request.set_page_token(response->next_page_token());
  }
}

absl::StatusOr<Operation> Outcome(const Operation& operation) {
  if (operation.error_code == 0) return operation;
  return absl::Status(static_cast<absl::StatusCode>(operation.error_code),
                      operation.error_message.empty()
                          ? absl::StrCat("the operation ", operation.id, " failed")
                          : operation.error_message);
}

}  // namespace

Client::Client(std::shared_ptr<Connection> connection) : connection_(std::move(connection)) {}

absl::StatusOr<Site> Client::CreateSite(const std::string& site, const std::string& profile,
                                        const std::vector<Band>& bands) {
  v1::CreateSiteRequest request;
  request.set_site_id(site);
  request.set_profile(profile);
  for (const Band& band : bands) {
    v1::Band& wire = *request.add_bands();
    wire.set_name(band.name);
    wire.set_min_frequency_hz(band.min_frequency_hz);
    wire.set_max_frequency_hz(band.max_frequency_hz);
  }
  request.set_request_id(RequestId());
  // The request id makes a repetition harmless.
  const auto response =
      connection_->Call<v1::Site>(Connection::Repeat::kOnUnavailable, *connection_->sites,
                                  &v1::SiteService::Stub::CreateSite, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::StatusOr<Site> Client::GetSite(const std::string& site) {
  v1::GetSiteRequest request;
  request.set_name(internal::SiteName(site));
  const auto response =
      connection_->Call<v1::Site>(Connection::Repeat::kOnUnavailable, *connection_->sites,
                                  &v1::SiteService::Stub::GetSite, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::StatusOr<std::vector<Site>> Client::ListSites() {
  std::vector<Site> sites;
  const absl::Status status =
      ForEachPage(v1::ListSitesRequest(), [&](const v1::ListSitesRequest& request) {
        auto response = connection_->Call<v1::ListSitesResponse>(
            Connection::Repeat::kOnUnavailable, *connection_->sites,
            &v1::SiteService::Stub::ListSites, request);
        if (response.ok()) {
          for (const auto& site : response->sites()) sites.push_back(FromProto(site));
        }
        return response;
      });
  if (!status.ok()) return status;
  return sites;
}

absl::StatusOr<Site> Client::KeepFrames(const std::string& site, std::int64_t seconds) {
  v1::UpdateSiteRequest request;
  request.mutable_site()->set_name(internal::SiteName(site));
  request.mutable_site()->set_keep_frames_s(seconds);
  request.mutable_update_mask()->add_paths("keep_frames_s");
  const auto response =
      connection_->Call<v1::Site>(Connection::Repeat::kOnUnavailable, *connection_->sites,
                                  &v1::SiteService::Stub::UpdateSite, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::Status Client::DeleteSite(const std::string& site) {
  v1::DeleteSiteRequest request;
  request.set_name(internal::SiteName(site));
  return connection_
      ->Call<v1::DeleteSiteResponse>(Connection::Repeat::kNever, *connection_->sites,
                                     &v1::SiteService::Stub::DeleteSite, request)
      .status();
}

absl::StatusOr<Operation> Client::BuildMap(const BuildMapRequest& request,
                                           const ProgressCallback& progress) {
  v1::BuildMapRequest wire;
  wire.set_site(internal::SiteName(request.site));
  for (const std::string& session : request.sessions) {
    wire.add_sessions(internal::SessionName(request.site, session));
  }
  wire.set_extend(request.extend);
  for (const StampedPose& pose : request.surveyed_poses) {
    auto& surveyed = *wire.add_surveyed_poses();
    surveyed.set_time_ns(pose.time_ns);
    internal::ToProto(pose.map_from_base, *surveyed.mutable_map_from_base());
  }
  wire.set_request_id(RequestId());
  const auto response = connection_->Call<v1::Operation>(
      Connection::Repeat::kNever, *connection_->maps, &v1::MapService::Stub::BuildMap, wire);
  if (!response.ok()) return response.status();
  return WaitOperation(response->name(), progress);
}

absl::StatusOr<Operation> Client::CreateBackup(const std::string& backup,
                                               const ProgressCallback& progress) {
  v1::CreateBackupRequest request;
  request.set_backup_id(backup);
  request.set_request_id(RequestId());
  const auto response =
      connection_->Call<v1::Operation>(Connection::Repeat::kNever, *connection_->backups,
                                       &v1::BackupService::Stub::CreateBackup, request);
  if (!response.ok()) return response.status();
  return WaitOperation(response->name(), progress);
}

absl::StatusOr<Operation> Client::TryParameters(const TryParametersRequest& request,
                                                const ProgressCallback& progress) {
  v1::TryParametersRequest wire;
  wire.set_site(internal::SiteName(request.site));
  for (const std::string& session : request.sessions) {
    wire.add_sessions(internal::SessionName(request.site, session));
  }
  for (const std::string& text : request.parameters_toml) wire.add_parameters_toml(text);
  wire.set_request_id(RequestId());
  const auto response =
      connection_->Call<v1::Operation>(Connection::Repeat::kNever, *connection_->tuning,
                                       &v1::TuningService::Stub::TryParameters, wire);
  if (!response.ok()) return response.status();
  return WaitOperation(response->name(), progress);
}

absl::StatusOr<SoundSource> Client::GetSoundSource(const std::string& site,
                                                   const std::string& source) {
  v1::GetSoundSourceRequest request;
  request.set_name(internal::SourceName(site, source));
  const auto response = connection_->Call<v1::SoundSource>(
      Connection::Repeat::kOnUnavailable, *connection_->sound_maps,
      &v1::SoundMapService::Stub::GetSoundSource, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::StatusOr<SoundSourceList> Client::ListSoundSources(const SoundSourceQuery& query) {
  v1::ListSoundSourcesRequest first;
  first.set_site(internal::SiteName(query.site));
  first.set_min_probability(query.min_probability);
  first.set_since_ns(query.since_ns);
  first.set_band(query.band);
  first.set_start_ns(query.start_ns);
  first.set_end_ns(query.end_ns);
  for (const SoundSourceState state : query.states) first.add_states(internal::ToProto(state));
  SoundSourceList list;
  const absl::Status status = ForEachPage(first, [&](const v1::ListSoundSourcesRequest& request) {
    auto response = connection_->Call<v1::ListSoundSourcesResponse>(
        Connection::Repeat::kOnUnavailable, *connection_->sound_maps,
        &v1::SoundMapService::Stub::ListSoundSources, request);
    if (response.ok()) {
      for (const auto& source : response->sound_sources()) {
        list.sources.push_back(FromProto(source));
      }
      list.revision = response->revision();
      list.as_of_ns = response->as_of_ns();
    }
    return response;
  });
  if (!status.ok()) return status;
  std::sort(list.sources.begin(), list.sources.end(),
            [](const SoundSource& a, const SoundSource& b) {
              return a.probability != b.probability ? a.probability > b.probability : a.id < b.id;
            });
  return list;
}

absl::Status Client::QueryVoxels(const VoxelQuery& query,
                                 const std::function<bool(const VoxelColumns&)>& chunk) {
  v1::QueryVoxelsRequest request;
  request.set_site(internal::SiteName(query.site));
  if (query.box_in_map) {
    internal::ToProto(query.box_in_map->min_m, *request.mutable_box()->mutable_min_m());
    internal::ToProto(query.box_in_map->max_m, *request.mutable_box()->mutable_max_m());
  }
  request.set_min_updates(query.min_updates);
  request.set_min_probability(query.min_probability);
  request.set_band(query.band);
  absl::Status malformed;
  const absl::Status status = connection_->Stream<v1::VoxelChunk>(
      *connection_->sound_maps, &v1::SoundMapService::Stub::QueryVoxels, request,
      [&](const v1::VoxelChunk& wire) {
        const VoxelColumns columns = FromProto(wire);
        const auto size = static_cast<std::size_t>(wire.x_key_size());
        if (columns.size() != size || wire.log_odds_size() != wire.x_key_size()) {
          malformed = absl::InternalError("the server sent voxel columns of unequal length");
          return false;
        }
        return chunk(columns);
      });
  return malformed.ok() ? status : malformed;
}

absl::StatusOr<std::vector<AudioScan>> Client::ListAudioScans(const AudioScanQuery& query) {
  v1::ListAudioScansRequest first;
  first.set_site(internal::SiteName(query.site));
  if (!query.session.empty()) {
    first.set_session(internal::SessionName(query.site, query.session));
  }
  first.set_start_ns(query.start_ns);
  first.set_end_ns(query.end_ns);
  first.set_band(query.band);
  std::vector<AudioScan> scans;
  const absl::Status status = ForEachPage(first, [&](const v1::ListAudioScansRequest& request) {
    auto response = connection_->Call<v1::ListAudioScansResponse>(
        Connection::Repeat::kOnUnavailable, *connection_->sound_maps,
        &v1::SoundMapService::Stub::ListAudioScans, request);
    if (response.ok()) {
      for (const auto& scan : response->audio_scans()) scans.push_back(FromProto(scan));
    }
    return response;
  });
  if (!status.ok()) return status;
  return scans;
}

absl::StatusOr<Robot> Client::GetRobot(const std::string& robot) {
  v1::GetRobotRequest request;
  request.set_name(internal::RobotName(robot));
  const auto response =
      connection_->Call<v1::Robot>(Connection::Repeat::kOnUnavailable, *connection_->robots,
                                   &v1::RobotService::Stub::GetRobot, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::StatusOr<std::vector<Robot>> Client::ListRobots(const std::string& site) {
  v1::ListRobotsRequest first;
  if (!site.empty()) first.set_site(internal::SiteName(site));
  std::vector<Robot> robots;
  const absl::Status status = ForEachPage(first, [&](const v1::ListRobotsRequest& request) {
    auto response = connection_->Call<v1::ListRobotsResponse>(
        Connection::Repeat::kOnUnavailable, *connection_->robots,
        &v1::RobotService::Stub::ListRobots, request);
    if (response.ok()) {
      for (const auto& robot : response->robots()) robots.push_back(FromProto(robot));
    }
    return response;
  });
  if (!status.ok()) return status;
  return robots;
}

absl::StatusOr<Session> Client::GetSession(const std::string& site, const std::string& session) {
  v1::GetSessionRequest request;
  request.set_name(internal::SessionName(site, session));
  const auto response =
      connection_->Call<v1::Session>(Connection::Repeat::kOnUnavailable, *connection_->sessions,
                                     &v1::SessionService::Stub::GetSession, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::StatusOr<std::vector<Session>> Client::ListSessions(const std::string& site,
                                                          const std::string& robot) {
  v1::ListSessionsRequest first;
  first.set_site(internal::SiteName(site));
  if (!robot.empty()) first.set_robot(internal::RobotName(robot));
  std::vector<Session> sessions;
  const absl::Status status = ForEachPage(first, [&](const v1::ListSessionsRequest& request) {
    auto response = connection_->Call<v1::ListSessionsResponse>(
        Connection::Repeat::kOnUnavailable, *connection_->sessions,
        &v1::SessionService::Stub::ListSessions, request);
    if (response.ok()) {
      for (const auto& session : response->sessions()) sessions.push_back(FromProto(session));
    }
    return response;
  });
  if (!status.ok()) return status;
  return sessions;
}

absl::StatusOr<std::vector<PoseEstimate>> Client::GetTrajectory(const std::string& site,
                                                                const std::string& session) {
  v1::GetTrajectoryRequest request;
  request.set_name(internal::SessionName(site, session));
  std::vector<PoseEstimate> path;
  const absl::Status status = connection_->Stream<v1::TrajectoryChunk>(
      *connection_->sessions, &v1::SessionService::Stub::GetTrajectory, request,
      [&](const v1::TrajectoryChunk& chunk) {
        for (const auto& pose : chunk.poses()) path.push_back(FromProto(pose));
        return true;
      });
  if (!status.ok()) return status;
  return path;
}

absl::StatusOr<Operation> Client::GetOperation(const std::string& operation) {
  v1::GetOperationRequest request;
  request.set_name(internal::OperationName(operation));
  const auto response =
      connection_->Call<v1::Operation>(Connection::Repeat::kOnUnavailable, *connection_->operations,
                                       &v1::OperationService::Stub::GetOperation, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

absl::StatusOr<std::vector<Operation>> Client::ListOperations(const std::string& site) {
  v1::ListOperationsRequest first;
  if (!site.empty()) first.set_site(internal::SiteName(site));
  std::vector<Operation> operations;
  const absl::Status status = ForEachPage(first, [&](const v1::ListOperationsRequest& request) {
    auto response = connection_->Call<v1::ListOperationsResponse>(
        Connection::Repeat::kOnUnavailable, *connection_->operations,
        &v1::OperationService::Stub::ListOperations, request);
    if (response.ok()) {
      for (const auto& operation : response->operations()) {
        operations.push_back(FromProto(operation));
      }
    }
    return response;
  });
  if (!status.ok()) return status;
  return operations;
}

absl::StatusOr<Operation> Client::WaitOperation(const std::string& operation,
                                                const ProgressCallback& progress) {
  v1::WaitOperationRequest request;
  request.set_name(internal::OperationName(operation));
  request.set_timeout_ms(static_cast<int>(kWaitSlice.count()));
  bool cancelled = false;
  for (;;) {
    const auto response = connection_->Call<v1::Operation>(
        Connection::Repeat::kOnUnavailable, *connection_->operations,
        &v1::OperationService::Stub::WaitOperation, request, kWaitSlice);
    if (!response.ok()) return response.status();
    const Operation state = FromProto(*response);
    const bool go_on = cancelled || !progress || progress(state);
    if (state.done) return Outcome(state);
    if (!go_on) {
      const auto answer = CancelOperation(operation);
      if (!answer.ok()) return answer.status();
      cancelled = true;
    }
  }
}

absl::StatusOr<Operation> Client::CancelOperation(const std::string& operation) {
  v1::CancelOperationRequest request;
  request.set_name(internal::OperationName(operation));
  const auto response =
      connection_->Call<v1::Operation>(Connection::Repeat::kOnUnavailable, *connection_->operations,
                                       &v1::OperationService::Stub::CancelOperation, request);
  if (!response.ok()) return response.status();
  return FromProto(*response);
}

}  // namespace soundmap
