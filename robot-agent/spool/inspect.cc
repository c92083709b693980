#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "spool/spool.h"

namespace soundmap::spool {

absl::StatusOr<std::vector<SessionSummary>> Inspect(const std::string& folder) {
  std::error_code error;
  std::filesystem::directory_iterator it(folder, error);
  if (error) return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot read ", folder));
  std::vector<SessionSummary> summaries;
  for (const auto& entry : it) {
    if (!entry.is_directory()) continue;
    const auto record = ReadRecord(entry.path().string());
    if (absl::IsNotFound(record.status())) continue;  // it is just being made
    if (!record.ok()) return record.status();
    const auto segments = ListSegments(entry.path().string());
    if (!segments.ok()) return segments.status();
    SessionSummary summary;
    summary.session = record->request.session_id();
    summary.site = record->request.site();
    summary.robot = record->request.robot();
    summary.created_ns = record->created_ns;
    summary.recorded = record->next;
    summary.ended = record->ended;
    summary.delivered = record->delivered;
    summary.gaps = record->gaps;
    for (const Segment& segment : *segments) summary.bytes += segment.bytes;
    if (!segments->empty()) {
      summary.oldest_ns = segments->front().written_ns;
      const auto count = CountFrames(segments->back().path);
      if (!count.ok()) return count.status();
      summary.recorded = std::max(summary.recorded, segments->back().first + *count);
      summary.waiting = summary.recorded - segments->front().first;
    }
    summaries.push_back(std::move(summary));
  }
  std::sort(
      summaries.begin(), summaries.end(),
      [](const SessionSummary& a, const SessionSummary& b) { return a.created_ns < b.created_ns; });
  return summaries;
}

std::string ToJson(const std::vector<SessionSummary>& sessions) {
  nlohmann::json json = nlohmann::json::array();
  for (const SessionSummary& session : sessions) {
    nlohmann::json gaps = nlohmann::json::array();
    for (const Gap& gap : session.gaps) {
      gaps.push_back({{"frames", gap.end - gap.first},
                      {"from_ns", gap.from_ns},
                      {"to_ns", gap.to_ns},
                      {"reason", gap.reason}});
    }
    json.push_back({{"session", session.session},
                    {"site", session.site},
                    {"robot", session.robot},
                    {"created_ns", session.created_ns},
                    {"recorded", session.recorded},
                    {"waiting", session.waiting},
                    {"bytes", session.bytes},
                    {"oldest_ns", session.oldest_ns},
                    {"ended", session.ended},
                    {"delivered", session.delivered},
                    {"gaps", gaps}});
  }
  return nlohmann::json{{"sessions", json}}.dump(1);
}

}  // namespace soundmap::spool
