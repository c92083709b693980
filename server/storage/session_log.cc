#include "storage/session_log.h"

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <map>
#include <mutex>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "recording/reader.h"
#include "recording/schemas.h"
#include "storage/crc32c.h"
#include "storage/files.h"

namespace soundmap::storage {
namespace {

constexpr std::int64_t kMaxFrameBytes = 32 << 20;
constexpr std::size_t kMaxTopics = 64;
constexpr std::size_t kMaxTopicBytes = 256;
constexpr int kOffsetDigits = 20;
constexpr char kSuffix[] = ".mcap";

struct Segment {
  std::int64_t first_offset = 0;
  std::string path;
};

std::string SegmentPath(const std::string& folder, std::int64_t first_offset) {
  return absl::StrFormat("%s/%0*d%s", folder, kOffsetDigits, first_offset, kSuffix);
}

// None for files that are not segments.
std::optional<std::int64_t> FirstOffsetOf(const std::string& file_name) {
  if (file_name.size() != kOffsetDigits + sizeof(kSuffix) - 1) return std::nullopt;
  if (file_name.substr(kOffsetDigits) != kSuffix) return std::nullopt;
  std::int64_t offset = 0;
  const char* const end = file_name.data() + kOffsetDigits;
  const auto [stop, error] = std::from_chars(file_name.data(), end, offset);
  if (error != std::errc() || stop != end || offset < 0) return std::nullopt;
  return offset;
}

absl::StatusOr<std::vector<Segment>> ListSegments(const std::string& folder) {
  std::vector<Segment> segments;
  std::error_code error;
  for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (const auto first_offset = FirstOffsetOf(it->path().filename().string())) {
      segments.push_back({*first_offset, it->path().string()});
    }
  }
  if (error) {
    return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot list the folder ", folder));
  }
  std::sort(segments.begin(), segments.end(),
            [](const Segment& a, const Segment& b) { return a.first_offset < b.first_offset; });
  return segments;
}

std::uint32_t SequenceOf(std::int64_t offset) { return static_cast<std::uint32_t>(offset); }

absl::Status OutOfSequence(const std::string& path, std::uint32_t sequence, std::int64_t offset) {
  return absl::DataLossError(absl::StrCat(path, " has a message with sequence ", sequence,
                                          " where frame ", offset, " should stand"));
}

// What stands at the end of the last segment.
struct Tail {
  std::int64_t frames = 0;
  std::vector<std::uint32_t> payload_crcs;  // the last ones, at most the window
  std::map<std::string, std::string> schema_of_topic;
  std::string last_topic;
  absl::Status damage;  // why reading ended, if not at a regular end
};

// An error only where the file cannot be read; a file that is cut or damaged ends there.
absl::StatusOr<Tail> ReadTail(const Segment& segment, std::size_t crc_window) {
  Tail tail;
  auto reader = recording::Reader::Open(segment.path);
  if (!reader.ok()) {
    if (!absl::IsInvalidArgument(reader.status()) && !absl::IsDataLoss(reader.status())) {
      return reader.status();
    }
    tail.damage = reader.status();
    return tail;
  }
  std::deque<std::uint32_t> crcs;
  while (true) {
    auto message = (*reader)->Next();
    if (!message.ok()) {
      if (!absl::IsDataLoss(message.status())) return message.status();
      tail.damage = message.status();
      break;
    }
    if (!message->has_value()) break;
    const std::int64_t offset = segment.first_offset + tail.frames;
    if ((*message)->sequence != SequenceOf(offset)) {
      tail.damage = OutOfSequence(segment.path, (*message)->sequence, offset);
      break;
    }
    crcs.push_back(Crc32c((*message)->data));
    if (crcs.size() > crc_window) crcs.pop_front();
    tail.last_topic = (*message)->topic;
    tail.schema_of_topic.emplace(std::move((*message)->topic), std::move((*message)->schema));
    ++tail.frames;
  }
  tail.payload_crcs.assign(crcs.begin(), crcs.end());
  return tail;
}

}  // namespace

struct FrameReader::State {
  std::vector<Segment> segments;  // that hold [first_offset, end_offset)
  std::int64_t first_offset = 0;
  std::int64_t end_offset = 0;

  std::size_t segment = 0;
  std::int64_t position = 0;  // offset of the message that `reader` gives next
  std::unique_ptr<recording::Reader> reader;
  absl::Status error;

  std::int64_t SegmentEnd() const {
    return segment + 1 < segments.size() ? segments[segment + 1].first_offset : end_offset;
  }

  absl::StatusOr<recording::Message> NextOfSegments();
};

absl::StatusOr<recording::Message> FrameReader::State::NextOfSegments() {
  while (reader && position == SegmentEnd()) {
    reader.reset();
    ++segment;
  }
  const std::string& path = segments[segment].path;
  if (!reader) {
    auto opened = recording::Reader::Open(path);
    if (!opened.ok()) {
      return absl::IsUnavailable(opened.status()) || absl::IsPermissionDenied(opened.status())
                 ? opened.status()
                 : absl::DataLossError(
                       absl::StrCat("frame ", position, " is lost: ", opened.status().message()));
    }
    reader = *std::move(opened);
    position = segments[segment].first_offset;
  }
  auto message = reader->Next();
  if (!message.ok()) return message.status();
  if (!message->has_value()) {
    return absl::DataLossError(absl::StrCat(path, " ends before frame ", position,
                                            " although it holds frames up to ", SegmentEnd() - 1));
  }
  if ((*message)->sequence != SequenceOf(position)) {
    return OutOfSequence(path, (*message)->sequence, position);
  }
  ++position;
  return *std::move(*message);
}

FrameReader::FrameReader(std::unique_ptr<State> state) : state_(std::move(state)) {}
FrameReader::~FrameReader() = default;

std::int64_t FrameReader::next_offset() const {
  return std::max(state_->first_offset, state_->position);
}

absl::StatusOr<std::optional<recording::Message>> FrameReader::Next() {
  if (!state_->error.ok()) return state_->error;
  if (next_offset() == state_->end_offset) return std::nullopt;
  while (true) {
    auto message = state_->NextOfSegments();
    if (!message.ok()) {
      state_->error = message.status();
      return state_->error;
    }
    if (state_->position > state_->first_offset) return *std::move(message);
  }
}

struct SessionLog::State {
  std::string folder;
  SessionLogOptions options;
  std::function<void(std::int64_t)> on_durable;

  mutable std::mutex
      mutex;  // guards the members up to sync_mutex; never held while waiting for the disk
  std::vector<Segment> segments;  // the last one may be empty or absent while a sync runs
  std::int64_t durable = 0;
  std::deque<recording::Message> pending;  // frames durable .. received-1
  std::int64_t pending_bytes = 0;
  std::deque<std::uint32_t> payload_crcs;  // of the last frames
  std::map<std::string, std::string> schema_of_topic;
  std::string last_topic;  // of frame received-1
  absl::Status sync_error;
  bool closed = false;

  std::mutex sync_mutex;  // one sync at a time; taken before `mutex`; guards the members below
  std::unique_ptr<recording::Writer> writer;  // of the last segment
  std::int64_t segment_frame_bytes = 0;
  std::int64_t synced_file_bytes = 0;  // of the last segment
  bool is_folder_synced = false;       // in its parent, since this log was opened

  std::int64_t received() const { return durable + static_cast<std::int64_t>(pending.size()); }

  void ExtendLocked(FrameReader::State& reading) const;
  absl::Status CheckSpace() const;
  absl::Status WriteAndSync(const std::vector<const recording::Message*>& frames,
                            std::int64_t first_offset);
  void DropSegmentAfterError(std::int64_t durable_frames);
  absl::StatusOr<std::int64_t> SyncLocked();
  void RememberCrc(std::uint32_t crc) {
    payload_crcs.push_back(crc);
    if (payload_crcs.size() > static_cast<std::size_t>(options.crc_window_frames)) {
      payload_crcs.pop_front();
    }
  }
};

absl::Status SessionLog::State::CheckSpace() const {
  const auto free_bytes = FreeBytes(folder);
  if (!free_bytes.ok()) return free_bytes.status();
  if (*free_bytes < options.min_free_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat("cannot write to ", folder, ": the disk has ",
                                                     *free_bytes, " bytes left, fewer than ",
                                                     options.min_free_bytes));
  }
  return absl::OkStatus();
}

absl::Status SessionLog::State::WriteAndSync(const std::vector<const recording::Message*>& frames,
                                             std::int64_t first_offset) {
  const bool starts_segment = writer == nullptr;
  if (starts_segment) {
    const Segment segment{first_offset, SegmentPath(folder, first_offset)};
    recording::WriterOptions writer_options;
    writer_options.compression = options.compression;
    auto created = recording::Writer::Create(segment.path, writer_options);
    // A writer that fails after it has made the file leaves it behind; its name is needed again.
    {
      const std::lock_guard lock(mutex);
      segments.push_back(segment);
    }
    segment_frame_bytes = 0;
    synced_file_bytes = 0;
    if (!created.ok()) return created.status();
    writer = *std::move(created);
  }
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const recording::Message& frame = *frames[i];
    const std::int64_t offset = first_offset + static_cast<std::int64_t>(i);
    const absl::Status written =
        writer->Write(frame.topic, frame.schema, frame.log_time_ns, SequenceOf(offset), frame.data);
    if (!written.ok()) return written;
    segment_frame_bytes += static_cast<std::int64_t>(frame.data.size());
  }
  if (absl::Status flushed = writer->Flush(/*sync=*/true); !flushed.ok()) return flushed;
  if (starts_segment) {
    if (absl::Status synced = SyncFolder(folder); !synced.ok()) return synced;
  }
  if (!is_folder_synced) {
    if (absl::Status synced = SyncFolder(ParentOf(folder)); !synced.ok()) return synced;
    is_folder_synced = true;
  }
  struct stat file = {};
  synced_file_bytes = ::stat(segments.back().path.c_str(), &file) == 0 ? file.st_size : -1;
  return absl::OkStatus();
}

// What was written after the last sync is of unknown state and is not written to again: a segment
// without durable frames goes, another one is cut to what is durable. The cut saves space, reading
// stops at the first frame of the next segment anyway.
void SessionLog::State::DropSegmentAfterError(std::int64_t durable_frames) {
  writer.reset();
  const std::lock_guard lock(mutex);
  if (segments.empty()) return;
  const Segment& last = segments.back();
  if (last.first_offset == durable_frames) {
    ::unlink(last.path.c_str());
    segments.pop_back();
  } else if (synced_file_bytes > 0 && ::truncate(last.path.c_str(), synced_file_bytes) != 0) {
    // The bytes stay until the session goes.
  }
}

absl::StatusOr<std::int64_t> SessionLog::State::SyncLocked() {
  std::vector<const recording::Message*> frames;  // a deque's elements stay where they are
  std::int64_t first_offset = 0;
  {
    const std::lock_guard lock(mutex);
    first_offset = durable;
    if (pending.empty()) return durable;
    frames.reserve(pending.size());
    for (const recording::Message& frame : pending) frames.push_back(&frame);
  }
  absl::Status written = CheckSpace();
  if (written.ok()) {
    written = WriteAndSync(frames, first_offset);
    if (!written.ok()) DropSegmentAfterError(first_offset);
  }
  if (!written.ok()) {
    const std::lock_guard lock(mutex);
    sync_error = written;
    return written;
  }
  const std::int64_t now_durable = first_offset + static_cast<std::int64_t>(frames.size());
  {
    const std::lock_guard lock(mutex);
    for (std::size_t i = 0; i < frames.size(); ++i) {
      pending_bytes -= static_cast<std::int64_t>(pending.front().data.size());
      pending.pop_front();
    }
    durable = now_durable;
    sync_error = absl::OkStatus();
  }
  if (segment_frame_bytes >= options.segment_bytes) {
    // The frames are safe; a summary that does not fit on the disk is not missed.
    writer->Close().IgnoreError();
    writer.reset();
  }
  if (on_durable) on_durable(now_durable);
  return now_durable;
}

SessionLog::SessionLog(std::unique_ptr<State> state) : state_(std::move(state)) {}
SessionLog::~SessionLog() = default;

absl::StatusOr<std::shared_ptr<SessionLog>> SessionLog::Open(
    const std::string& folder, const SessionLogOptions& options, std::int64_t known_durable,
    std::function<void(std::int64_t)> on_durable) {
  if (options.segment_bytes < 1 || options.max_pending_bytes < 1 || options.crc_window_frames < 1) {
    return absl::InvalidArgumentError(
        "segment_bytes, max_pending_bytes and crc_window_frames of a session log must be positive");
  }
  // Sessions are many, and most wait for their robot: the folder is synced with the first frames.
  if (absl::Status created = CreateFolder(folder, /*sync=*/false); !created.ok()) return created;
  auto segments = ListSegments(folder);
  if (!segments.ok()) return segments.status();

  auto state = std::make_unique<State>();
  state->folder = folder;
  state->options = options;
  state->on_durable = std::move(on_durable);
  state->segments = *std::move(segments);
  while (!state->segments.empty()) {
    const Segment& last = state->segments.back();
    auto tail = ReadTail(last, static_cast<std::size_t>(options.crc_window_frames));
    if (!tail.ok()) return tail.status();
    const std::int64_t end = last.first_offset + tail->frames;
    if (end < known_durable) {
      return absl::DataLossError(
          absl::StrCat(last.path, " holds frames up to ", end, " only, where ", known_durable,
                       " were durable", tail->damage.ok() ? "" : ": ", tail->damage.message()));
    }
    if (tail->frames > 0) {
      if (absl::Status synced = SyncFile(last.path); !synced.ok()) return synced;
      state->durable = end;
      state->payload_crcs.assign(tail->payload_crcs.begin(), tail->payload_crcs.end());
      state->schema_of_topic = std::move(tail->schema_of_topic);
      state->last_topic = std::move(tail->last_topic);
      break;
    }
    // The crash came before the first frame of the segment was whole. Its name is needed again.
    const std::string aside = absl::StrCat(last.path, ".torn");
    if (::rename(last.path.c_str(), aside.c_str()) != 0) {
      return absl::ErrnoToStatus(errno, absl::StrCat("cannot rename ", last.path));
    }
    state->segments.pop_back();
  }
  if (state->durable < known_durable) {
    return absl::DataLossError(
        absl::StrCat(folder, " holds no segment, where ", known_durable, " frames were durable"));
  }
  if (!state->segments.empty() && state->segments.front().first_offset != 0) {
    return absl::DataLossError(absl::StrCat(SegmentPath(folder, 0), " is missing"));
  }
  return std::shared_ptr<SessionLog>(new SessionLog(std::move(state)));
}

absl::StatusOr<std::int64_t> SessionLog::Append(recording::Message frame) {
  State& state = *state_;
  const auto bytes = static_cast<std::int64_t>(frame.data.size());
  if (bytes > kMaxFrameBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("a frame of ", bytes, " bytes is longer than ", kMaxFrameBytes));
  }
  if (frame.topic.empty() || frame.topic.size() > kMaxTopicBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("the topic of a frame is not 1-", kMaxTopicBytes, " bytes long"));
  }
  if (frame.log_time_ns < 0) {
    return absl::InvalidArgumentError(absl::StrCat("a frame on ", frame.topic, " has the time ",
                                                   frame.log_time_ns, " ns, before 1970"));
  }
  const std::uint32_t crc = Crc32c(frame.data);

  const std::lock_guard lock(state.mutex);
  if (state.closed) {
    return absl::FailedPreconditionError(
        absl::StrCat("the session log ", state.folder, " is closed"));
  }
  if (!state.sync_error.ok()) return state.sync_error;
  if (!state.pending.empty() && state.pending_bytes + bytes > state.options.max_pending_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        state.pending_bytes, " bytes wait to be written to ", state.folder, ", no more are taken"));
  }
  const auto schema = state.schema_of_topic.find(frame.topic);
  if (schema == state.schema_of_topic.end()) {
    if (state.schema_of_topic.size() >= kMaxTopics) {
      return absl::InvalidArgumentError(
          absl::StrCat("a session has at most ", kMaxTopics, " topics"));
    }
    if (!recording::DescriptorSetOf(frame.schema)) {
      return absl::InvalidArgumentError(absl::StrCat("the schema ",
                                                     frame.schema.substr(0, kMaxTopicBytes),
                                                     " is not of the recording format"));
    }
    state.schema_of_topic.emplace(frame.topic, frame.schema);
  } else if (schema->second != frame.schema) {
    return absl::InvalidArgumentError(absl::StrCat("the topic ", frame.topic, " has the schema ",
                                                   schema->second, ", not ", frame.schema));
  }
  const std::int64_t offset = state.received();
  state.last_topic = frame.topic;
  state.pending.push_back(std::move(frame));
  state.pending_bytes += bytes;
  state.RememberCrc(crc);
  return offset;
}

absl::StatusOr<std::int64_t> SessionLog::Sync() {
  const std::lock_guard sync_lock(state_->sync_mutex);
  {
    const std::lock_guard lock(state_->mutex);
    if (state_->closed && !state_->pending.empty()) {
      return absl::FailedPreconditionError(
          absl::StrCat("the session log ", state_->folder, " is closed"));
    }
  }
  return state_->SyncLocked();
}

std::int64_t SessionLog::received() const {
  const std::lock_guard lock(state_->mutex);
  return state_->received();
}

std::int64_t SessionLog::durable() const {
  const std::lock_guard lock(state_->mutex);
  return state_->durable;
}

std::string SessionLog::last_topic() const {
  const std::lock_guard lock(state_->mutex);
  return state_->last_topic;
}

std::optional<std::uint32_t> SessionLog::PayloadCrc(std::int64_t offset) const {
  const std::lock_guard lock(state_->mutex);
  const std::int64_t first =
      state_->received() - static_cast<std::int64_t>(state_->payload_crcs.size());
  if (offset < first || offset >= state_->received()) return std::nullopt;
  return state_->payload_crcs[static_cast<std::size_t>(offset - first)];
}

absl::StatusOr<std::unique_ptr<FrameReader>> SessionLog::Read(std::int64_t first_offset) const {
  auto reading = std::make_unique<FrameReader::State>();
  {
    const std::lock_guard lock(state_->mutex);
    if (first_offset < 0 || first_offset > state_->durable) {
      return absl::OutOfRangeError(absl::StrCat("frame ", first_offset, " is not in the ",
                                                state_->durable, " durable frames of ",
                                                state_->folder));
    }
    reading->first_offset = first_offset;
    state_->ExtendLocked(*reading);
  }
  return std::unique_ptr<FrameReader>(new FrameReader(std::move(reading)));
}

absl::Status SessionLog::Extend(FrameReader& reader) const {
  {
    const std::lock_guard lock(state_->mutex);
    state_->ExtendLocked(*reader.state_);
  }
  return reader.state_->reader ? reader.state_->reader->TakeGrowth() : absl::OkStatus();
}

void SessionLog::State::ExtendLocked(FrameReader::State& reading) const {
  for (const Segment& segment : segments) {
    if (segment.first_offset >= durable) break;
    std::vector<Segment>& known = reading.segments;
    if (!known.empty() && segment.first_offset <= known.back().first_offset) continue;
    // Of those that begin before the reader's first frame, the last one holds it.
    if (segment.first_offset <= reading.first_offset) known.clear();
    known.push_back(segment);
  }
  reading.end_offset = durable;
}

absl::Status SessionLog::Close() {
  const std::lock_guard sync_lock(state_->sync_mutex);
  {
    const std::lock_guard lock(state_->mutex);
    if (state_->closed) return absl::OkStatus();
    state_->closed = true;
  }
  const absl::Status synced = state_->SyncLocked().status();
  if (state_->writer) {
    state_->writer->Close().IgnoreError();
    state_->writer.reset();
  }
  return synced;
}

void SessionLog::Abandon() {
  const std::lock_guard sync_lock(state_->sync_mutex);
  state_->writer.reset();
  const std::lock_guard lock(state_->mutex);
  state_->closed = true;
  state_->pending.clear();
  state_->pending_bytes = 0;
  state_->payload_crcs.clear();
}

absl::StatusOr<SessionLogCheck> CheckSessionLog(const std::string& folder,
                                                std::int64_t known_durable) {
  SessionLogCheck check;
  std::error_code error;
  if (std::filesystem::exists(folder, error)) {
    const auto segments = ListSegments(folder);
    if (!segments.ok()) return segments.status();
    for (std::size_t i = 0; i < segments->size(); ++i) {
      const Segment& segment = (*segments)[i];
      const auto tail = ReadTail(segment, /*crc_window=*/0);
      if (!tail.ok()) return tail.status();
      ++check.segments;
      if (segment.first_offset > check.frames) {
        check.faults.push_back(absl::StrCat(folder, ": frames ", check.frames, " to ",
                                            segment.first_offset - 1, " are missing"));
      }
      const std::int64_t end = segment.first_offset + tail->frames;
      const bool is_last = i + 1 == segments->size();
      // A segment ends where the next one begins, whatever stands behind.
      const std::int64_t needed = is_last ? known_durable : (*segments)[i + 1].first_offset;
      if (end < needed) {
        check.faults.push_back(absl::StrCat(segment.path, " holds frames up to ", end,
                                            " only, where ", needed, " were durable",
                                            tail->damage.ok() ? "" : ": ", tail->damage.message()));
      } else if (!tail->damage.ok()) {
        absl::StrAppend(&check.cut_tail, check.cut_tail.empty() ? "" : "; ",
                        tail->damage.message());
      }
      check.frames = is_last ? end : needed;
    }
  }
  if (check.segments == 0 && known_durable > 0) {
    check.faults.push_back(
        absl::StrCat(folder, " holds no segment, where ", known_durable, " frames were durable"));
  }
  return check;
}

}  // namespace soundmap::storage
