#include "api/sound_map_service.h"

#include <algorithm>
#include <limits>
#include <optional>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "api/convert.h"
#include "api/find.h"
#include "api/paging.h"
#include "api/reactors.h"
#include "pipeline/archive.h"
#include "sound_map/voxel_query.h"

namespace soundmap::api {
namespace {

constexpr int kVoxelsPerChunk = 8192;

absl::StatusOr<sound_map::VoxelQuery> QueryFrom(const v1::QueryVoxelsRequest& request) {
  sound_map::VoxelQuery query;
  query.limit = kVoxelsPerChunk;
  if (request.has_box()) {
    const v1::Vector3& min = request.box().min_m();
    const v1::Vector3& max = request.box().max_m();
    query.min_in_map_m = {min.x(), min.y(), min.z()};
    query.max_in_map_m = {max.x(), max.y(), max.z()};
  } else {
    query.min_in_map_m.setConstant(-std::numeric_limits<double>::max());
    query.max_in_map_m.setConstant(std::numeric_limits<double>::max());
  }
  if (request.min_updates() < 0 ||
      request.min_updates() > std::numeric_limits<std::uint32_t>::max()) {
    return absl::InvalidArgumentError("min_updates is out of range");
  }
  query.min_updates = static_cast<std::uint32_t>(request.min_updates());
  query.min_probability = request.min_probability();
  return query;
}

void Append(const sound_map::VoxelPage& page, v1::VoxelChunk& chunk) {
  for (std::size_t i = 0; i < page.keys.size(); ++i) {
    chunk.add_x_key(page.keys[i].x);
    chunk.add_y_key(page.keys[i].y);
    chunk.add_z_key(page.keys[i].z);
    chunk.add_log_odds(page.voxels[i].log_odds);
    chunk.add_update_count(page.voxels[i].update_count);
    chunk.add_last_update_ns(page.voxels[i].last_update_ns);
  }
}

// None: the request names no window.
absl::StatusOr<std::optional<TimeWindow>> WindowFrom(const v1::ListSoundSourcesRequest& request) {
  if (request.start_ns() == 0 && request.end_ns() == 0) return std::nullopt;
  TimeWindow window{.start_ns = request.start_ns()};
  if (request.end_ns() != 0) window.end_ns = request.end_ns();
  if (window.end_ns <= window.start_ns) {
    return absl::InvalidArgumentError("end_ns is not after start_ns");
  }
  return window;
}

bool IsWanted(v1::SoundSourceState state, const v1::ListSoundSourcesRequest& request,
              bool has_window) {
  if (request.states().empty()) return has_window || state != v1::SOUND_SOURCE_STATE_GONE;
  return std::find(request.states().begin(), request.states().end(), state) !=
         request.states().end();
}

// "t_k:sequence" of the last scan of the page before.
struct ScanPosition {
  frames::TimeNs time_ns = std::numeric_limits<frames::TimeNs>::min();
  std::uint64_t sequence = 0;

  auto operator<=>(const ScanPosition&) const = default;
};

absl::StatusOr<ScanPosition> PositionFrom(const std::string& token) {
  ScanPosition position;
  if (token.empty()) return position;
  const std::vector<std::string> parts = absl::StrSplit(token, ':');
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &position.time_ns) ||
      !absl::SimpleAtoi(parts[1], &position.sequence)) {
    return absl::InvalidArgumentError(absl::StrCat("the page token '", token, "' is not ours"));
  }
  return position;
}

}  // namespace

grpc::ServerUnaryReactor* SoundMapService::GetSoundSource(grpc::CallbackServerContext* context,
                                                          const v1::GetSoundSourceRequest* request,
                                                          v1::SoundSource* response) {
  const auto caller = access_->CallerOf(*context);
  if (!caller.ok()) return Finish(context, caller.status());
  const auto name = ParseSoundSource(request->name());
  if (!name.ok()) return Finish(context, name.status());
  const absl::Status allowed = access_->Check(*caller, Right::kRead, name->site);
  if (!allowed.ok()) return Finish(context, allowed);
  const auto site = sites_->Get(name->site);
  if (!site.ok()) return Finish(context, site.status());
  if (const auto band = (*site)->FindBand(name->band); band.ok()) {
    const auto sources = (*site)->region().sources(*band);
    for (const sound_map::RegisteredSource& source : sources->sources) {
      if (SourceId(name->band, source.found.id) != name->source) continue;
      *response = ToProto(name->site, name->band, source, TimeWindow());
      return Finish(context, absl::OkStatus());
    }
  }
  return Finish(context,
                absl::NotFoundError(absl::StrCat("sound source '", name->source,
                                                 "' does not exist at site '", name->site, "'")));
}

grpc::ServerUnaryReactor* SoundMapService::ListSoundSources(
    grpc::CallbackServerContext* context, const v1::ListSoundSourcesRequest* request,
    v1::ListSoundSourcesResponse* response) {
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kRead});
  if (!site.ok()) return Finish(context, site.status());
  const std::string site_name = (*site)->record().site;
  const auto window = WindowFrom(*request);
  if (!window.ok()) return Finish(context, window.status());
  if (!(request->min_probability() >= 0.0 && request->min_probability() <= 1.0)) {
    return Finish(context, absl::InvalidArgumentError("min_probability is not in 0 .. 1"));
  }
  const auto band = (*site)->FindBand(request->band());
  if (!band.ok()) return Finish(context, band.status());
  const auto all = (*site)->region().sources(*band);
  std::vector<const sound_map::RegisteredSource*> sources;
  for (const sound_map::RegisteredSource& source : all->sources) {
    if (source.found.probability < request->min_probability()) continue;
    if (source.found.last_heard_ns < request->since_ns()) continue;
    if (!IsWanted(ToProto(source.state), *request, window->has_value())) continue;
    if (*window && std::none_of(source.heard.begin(), source.heard.end(),
                                [&](const auto& period) { return (*window)->Overlaps(period); })) {
      continue;
    }
    sources.push_back(&source);
  }
  const auto page = PageOf(sources.size(), request->page_size(), request->page_token());
  if (!page.ok()) return Finish(context, page.status());
  for (std::size_t i = page->begin; i < page->end; ++i) {
    *response->add_sound_sources() =
        *window ? ToProto(site_name, request->band(), *sources[i], **window)
                : ToProto(site_name, request->band(), *sources[i]);
  }
  response->set_next_page_token(page->next_token);
  response->set_revision(static_cast<std::int64_t>(all->revision));
  response->set_as_of_ns(all->as_of_ns.value_or(0));
  return Finish(context, absl::OkStatus());
}

grpc::ServerWriteReactor<v1::VoxelChunk>* SoundMapService::QueryVoxels(
    grpc::CallbackServerContext* context, const v1::QueryVoxelsRequest* request) {
  using Reactor = StreamReactor<v1::VoxelChunk>;
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kRead});
  if (!site.ok()) return new Reactor(site.status());
  const auto band = (*site)->FindBand(request->band());
  if (!band.ok()) return new Reactor(band.status());
  const auto query = QueryFrom(*request);
  if (!query.ok()) return new Reactor(query.status());
  // Every chunk is of the same snapshot. The first tells the revision even where there is no voxel.
  return new Reactor([map = (*site)->region().snapshot(*band), query = *query, first = true,
                      more = true](v1::VoxelChunk& chunk) mutable -> absl::StatusOr<bool> {
    if (!more) return false;
    const auto page = sound_map::FindVoxels(*map, query);
    if (!page.ok()) return page.status();
    more = page->more;
    if (!page->keys.empty()) query.after = page->keys.back();
    chunk.set_revision(static_cast<std::int64_t>(map->revision()));
    chunk.set_as_of_ns(map->as_of_ns().value_or(0));
    chunk.set_voxel_size_m(map->voxel_size_m());
    Append(*page, chunk);
    return std::exchange(first, false) || !page->keys.empty();
  });
}

grpc::ServerUnaryReactor* SoundMapService::ListAudioScans(grpc::CallbackServerContext* context,
                                                          const v1::ListAudioScansRequest* request,
                                                          v1::ListAudioScansResponse* response) {
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kRead});
  if (!site.ok()) return Finish(context, site.status());
  const auto band = (*site)->FindBand(request->band());
  if (!band.ok()) return Finish(context, band.status());
  std::optional<SessionName> session;
  if (!request->session().empty()) {
    const auto name = ParseSession(request->session());
    if (!name.ok()) return Finish(context, name.status());
    session = *name;
  }
  const auto page_size = PageSize(request->page_size());
  if (!page_size.ok()) return Finish(context, page_size.status());
  const auto after = PositionFrom(request->page_token());
  if (!after.ok()) return Finish(context, after.status());

  const std::string site_name = (*site)->record().site;
  const frames::TimeNs end_ns =
      request->end_ns() == 0 ? std::numeric_limits<frames::TimeNs>::max() : request->end_ns();
  ScanPosition last = *after;
  // Cancelled is how this reading is stopped when the page is full.
  const absl::Status read = store_->ReadJournalRange(
      site_name, std::max(request->start_ns(), after->time_ns), end_ns,
      [&](const storage::JournalRecord& record) -> absl::Status {
        const ScanPosition position{record.entry.evidence.stamp_ns, record.sequence};
        if (position <= *after) return absl::OkStatus();
        if (session && (record.session != session->session || site_name != session->site)) {
          return absl::OkStatus();
        }
        auto scan = pipeline::DecodeAudioScan(record.entry.summary);
        if (!scan.ok()) return scan.status();
        if (scan->band != *band) return absl::OkStatus();
        if (response->audio_scans_size() == *page_size) {
          response->set_next_page_token(absl::StrCat(last.time_ns, ":", last.sequence));
          return absl::CancelledError("");
        }
        scan->session = record.session;
        scan->time_ns = position.time_ns;
        *response->add_audio_scans() = ToProto(site_name, request->band(), *scan);
        last = position;
        return absl::OkStatus();
      });
  if (!read.ok() && !absl::IsCancelled(read)) return Finish(context, read);
  const auto map = (*site)->region().snapshot(*band);
  response->set_revision(static_cast<std::int64_t>(map->revision()));
  response->set_as_of_ns(map->as_of_ns().value_or(0));
  return Finish(context, absl::OkStatus());
}

}  // namespace soundmap::api
