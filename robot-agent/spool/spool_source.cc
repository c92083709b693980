#include "spool/spool_source.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "foxglove/KeyValuePair.pb.h"
#include "sources/sensor_format.h"

namespace soundmap::spool {
namespace {

std::optional<sources::Sensor> SensorOf(const std::string& topic) {
  for (const auto sensor : {sources::Sensor::kAudio, sources::Sensor::kLidar,
                            sources::Sensor::kLaser, sources::Sensor::kOdometry}) {
    if (sources::FormatOf(sensor).topic == topic) return sensor;
  }
  return std::nullopt;
}

}  // namespace

struct SpoolSource::Place {
  enum class Kind { kNothingYet, kEnd, kGap, kHole, kMemory, kDisk };
  Kind kind = Kind::kNothingYet;
  Gap gap;                     // kGap: recorded before
  std::int64_t end = 0;        // kHole, kDisk: of the hole, of the segment
  std::int64_t first = 0;      // kDisk: of the segment
  std::string path;            // kDisk
  sources::SensorFrame frame;  // kMemory
};

SpoolSource::SpoolSource(Spool* spool, std::string session)
    : spool_(spool), session_(std::move(session)) {}

absl::Status SpoolSource::Seek(std::int64_t offset) {
  std::lock_guard lock(spool_->mutex_);
  const auto found = spool_->sessions_.find(session_);
  if (found == spool_->sessions_.end()) {
    return absl::NotFoundError(absl::StrCat("the spool has no session '", session_, "'"));
  }
  offset_ = offset;
  position_ = PositionOf(found->second.record, offset);
  if (found->second.record.ended && position_ > found->second.next) {
    return absl::OutOfRangeError(absl::StrCat("the server has ", offset, " frames of session '",
                                              session_, "', the spool fewer"));
  }
  reader_.reset();
  return absl::OkStatus();
}

SpoolSource::Place SpoolSource::Look() const {
  Place place;
  const auto found = spool_->sessions_.find(session_);
  if (found == spool_->sessions_.end()) return place;
  const Spool::Session& session = found->second;
  for (const Gap& gap : session.record.gaps) {
    if (gap.offset != offset_ || gap.first != position_) continue;
    place.kind = Place::Kind::kGap;
    place.gap = gap;
    return place;
  }
  if (position_ >= session.synced) {
    const bool ended = session.record.ended && session.synced == session.next;
    place.kind = ended ? Place::Kind::kEnd : Place::Kind::kNothingYet;
    return place;
  }
  if (session_ == spool_->current_ && position_ >= spool_->recent_first_) {
    place.kind = Place::Kind::kMemory;
    place.frame = spool_->recent_[static_cast<std::size_t>(position_ - spool_->recent_first_)];
    return place;
  }
  // The last segment that begins here or before, if any.
  place.kind = Place::Kind::kHole;
  place.end = session.synced;
  for (const Segment& segment : session.segments) {
    if (segment.first > position_) {
      place.end = segment.first;
      break;
    }
    place.kind = Place::Kind::kDisk;
    place.first = segment.first;
    place.path = segment.path;
  }
  return place;
}

absl::StatusOr<std::optional<sources::SensorFrame>> SpoolSource::Next() {
  Place place;
  {
    std::lock_guard lock(spool_->mutex_);
    place = Look();
  }
  switch (place.kind) {
    case Place::Kind::kNothingYet:
    case Place::Kind::kEnd:
      return std::nullopt;
    case Place::Kind::kGap:
      ++offset_;
      position_ = place.gap.end;
      return GapFrame(place.gap);
    case Place::Kind::kHole:
      return MakeGap(place.end, "the spool was full");
    case Place::Kind::kDisk: {
      auto frame = ReadSegment(place);
      if (absl::IsNotFound(frame.status())) return MakeGap(place.end, "the spool was full");
      if (!frame.ok()) return MakeGap(place.end, "the spool is damaged");
      place.frame = **std::move(frame);
      break;
    }
    case Place::Kind::kMemory:
      break;
  }
  ++offset_;
  ++position_;
  last_log_time_ns_ = place.frame.log_time_ns;
  return std::move(place.frame);
}

bool SpoolSource::AtEnd() const {
  std::lock_guard lock(spool_->mutex_);
  return Look().kind == Place::Kind::kEnd;
}

absl::StatusOr<std::optional<sources::SensorFrame>> SpoolSource::ReadSegment(const Place& place) {
  if (!reader_ || reader_path_ != place.path || reader_position_ > position_) {
    auto opened = recording::Reader::Open(place.path);
    if (!opened.ok()) return opened.status();
    reader_ = *std::move(opened);
    reader_path_ = place.path;
    reader_position_ = place.first;
  }
  while (true) {
    auto message = reader_->Next();
    if (!message.ok()) return message.status();
    if (!*message) return absl::DataLossError(absl::StrCat(place.path, " ends early"));
    if ((*message)->sequence != static_cast<std::uint32_t>(reader_position_)) {
      return absl::DataLossError(absl::StrCat(place.path, " has frames out of sequence"));
    }
    if (reader_position_++ < position_) continue;
    const auto sensor = SensorOf((*message)->topic);
    if (!sensor) return absl::DataLossError(absl::StrCat(place.path, " has a strange topic"));
    return sources::SensorFrame{*sensor, (*message)->log_time_ns, std::move((*message)->data)};
  }
}

// Frames up to `end` are lost. The record of it is on the disk before the server hears of it, so
// that it stays the same however often it is sent.
absl::StatusOr<std::optional<sources::SensorFrame>> SpoolSource::MakeGap(
    std::int64_t end, const std::string& reason) {
  reader_.reset();
  Gap gap{offset_, position_, end, last_log_time_ns_, 0, reason};
  const std::int64_t begin = position_;
  position_ = end;
  Place behind;
  {
    std::lock_guard lock(spool_->mutex_);
    // Of the server's frames only those before this offset are there.
    behind = Look();
  }
  if (behind.kind == Place::Kind::kMemory) gap.to_ns = behind.frame.log_time_ns;
  if (behind.kind == Place::Kind::kDisk) {
    if (const auto frame = ReadSegment(behind); frame.ok()) gap.to_ns = (*frame)->log_time_ns;
    reader_.reset();
  }
  std::lock_guard lock(spool_->mutex_);
  const auto found = spool_->sessions_.find(session_);
  if (found == spool_->sessions_.end()) return std::nullopt;
  std::vector<Gap>& gaps = found->second.record.gaps;
  while (!gaps.empty() && gaps.back().offset >= offset_) gaps.pop_back();
  gaps.push_back(gap);
  if (absl::Status stored = spool_->StoreRecord(found->second); !stored.ok()) {
    gaps.pop_back();
    position_ = begin;
    return stored;
  }
  ++offset_;
  return GapFrame(gap);
}

sources::SensorFrame SpoolSource::GapFrame(const Gap& gap) const {
  const nlohmann::json value = {{"frames", gap.end - gap.first},
                                {"from_ns", gap.from_ns},
                                {"to_ns", gap.to_ns},
                                {"reason", gap.reason}};
  foxglove::KeyValuePair pair;
  pair.set_key("gap");
  pair.set_value(value.dump());
  return {sources::Sensor::kGap, gap.to_ns != 0 ? gap.to_ns : gap.from_ns,
          pair.SerializeAsString()};
}

}  // namespace soundmap::spool
