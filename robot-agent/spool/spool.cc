#include "spool/spool.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "sources/sensor_format.h"
#include "spool/spool_source.h"

namespace soundmap::spool {
namespace {

// What may wait in memory while the disk does not answer.
constexpr std::int64_t kMaxUnsyncedBytes = 32 << 20;
// Of sessions that are delivered; they are what tells a repeated drive from a new one.
constexpr std::size_t kMaxDeliveredRecords = 100;
constexpr std::chrono::milliseconds kRetry(500);
constexpr char kNameCharacters[] = "abcdefghijklmnopqrstuvwxyz0123456789_-";

std::int64_t BytesOf(const sources::SensorFrame& frame) {
  return static_cast<std::int64_t>(frame.payload.size());
}

absl::Status MakeFolder(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  return error ? absl::ErrnoToStatus(error.value(), absl::StrCat("cannot create ", folder))
               : absl::OkStatus();
}

}  // namespace

absl::Status SpoolOptions::Validate() const {
  if (segment_bytes <= 0 || sync_bytes <= 0 || sync_interval.count() <= 0) {
    return absl::InvalidArgumentError("the spool's sizes and times must be positive");
  }
  if (max_bytes < 4 * segment_bytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("the spool needs ", 4 * segment_bytes, " bytes or more"));
  }
  if (!(max_hours > 0.0) || !std::isfinite(max_hours)) {
    return absl::InvalidArgumentError("the spool's hours must be a positive number");
  }
  return absl::OkStatus();
}

Spool::Spool(std::string folder, int lock, const SpoolOptions& options,
             std::function<std::int64_t()> now_ns)
    : folder_(std::move(folder)), lock_file_(lock), options_(options), now_ns_(std::move(now_ns)) {}

absl::StatusOr<std::unique_ptr<Spool>> Spool::Open(const std::string& folder,
                                                   const SpoolOptions& options,
                                                   std::function<std::int64_t()> now_ns) {
  if (absl::Status valid = options.Validate(); !valid.ok()) return valid;
  if (absl::Status made = MakeFolder(folder); !made.ok()) return made;
  const std::string path = absl::StrCat(folder, "/LOCK");
  const int lock = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock < 0) return absl::ErrnoToStatus(errno, absl::StrCat("cannot open ", path));
  std::unique_ptr<Spool> spool(new Spool(folder, lock, options, std::move(now_ns)));
  if (::flock(lock, LOCK_EX | LOCK_NB) != 0) {
    return absl::FailedPreconditionError(absl::StrCat("another agent is using the spool ", folder));
  }
  if (absl::Status loaded = spool->Load(); !loaded.ok()) return loaded;
  spool->syncer_ = std::thread([raw = spool.get()] { raw->SyncLoop(); });
  return spool;
}

Spool::~Spool() {
  Stop();
  if (syncer_.joinable()) syncer_.join();
  ::close(lock_file_);
}

absl::Status Spool::Load() {
  std::vector<std::pair<std::int64_t, std::string>> delivered;
  for (const auto& entry : std::filesystem::directory_iterator(folder_)) {
    if (!entry.is_directory()) continue;
    auto session = LoadSession(entry.path().string());
    if (!session.ok()) {
      warnings_.push_back(absl::StrCat("the spooled session ", entry.path().filename().string(),
                                       " is left alone: ", session.status().message()));
      continue;
    }
    if (session->record.delivered) {
      delivered.emplace_back(session->record.created_ns, session->folder);
    }
    sessions_.emplace(entry.path().filename().string(), *std::move(session));
  }
  std::sort(delivered.begin(), delivered.end());
  for (std::size_t i = 0; i + kMaxDeliveredRecords < delivered.size(); ++i) {
    sessions_.erase(std::filesystem::path(delivered[i].second).filename().string());
    std::filesystem::remove_all(delivered[i].second);
  }
  return absl::OkStatus();
}

absl::StatusOr<Spool::Session> Spool::LoadSession(const std::string& folder) const {
  Session session;
  session.folder = folder;
  auto record = ReadRecord(folder);
  if (!record.ok()) return record.status();
  session.record = *std::move(record);
  auto segments = ListSegments(folder);
  if (!segments.ok()) return segments.status();
  session.segments = *std::move(segments);
  session.next = session.record.next;
  if (!session.segments.empty()) {
    const Segment& last = session.segments.back();
    const auto count = CountFrames(last.path);
    if (!count.ok()) return count.status();
    session.next = std::max(session.next, last.first + *count);
    const bool news = session.record.next != session.next;
    session.record.next = session.next;
    if (absl::Status stored = news ? WriteRecord(folder, session.record) : absl::OkStatus();
        !stored.ok()) {
      return stored;
    }
    if (*count == 0) {
      ::unlink(last.path.c_str());
      session.segments.pop_back();
    }
  }
  session.synced = session.next;
  return session;
}

absl::StatusOr<Spool::Begun> Spool::Begin(const v1::CreateSessionRequest& request) {
  const std::string& id = request.session_id();
  if (id.empty() || id.find_first_not_of(kNameCharacters) != std::string::npos) {
    return absl::InvalidArgumentError(absl::StrCat("'", id, "' is no name for a session"));
  }
  std::unique_lock lock(mutex_);
  WaitForSync(lock);
  if (stopping_) return absl::CancelledError("the spool is stopping");
  auto found = sessions_.find(id);
  if (found == sessions_.end()) {
    Session session;
    session.folder = absl::StrCat(folder_, "/", id);
    session.record.request = request;
    session.record.created_ns = now_ns_();
    if (absl::Status made = MakeFolder(session.folder); !made.ok()) return made;
    if (absl::Status stored = WriteRecord(session.folder, session.record); !stored.ok()) {
      return stored;
    }
    found = sessions_.emplace(id, std::move(session)).first;
  }
  Session& session = found->second;
  if (const auto before = sessions_.find(current_); before != sessions_.end()) {
    CloseSegment(before->second);
  }
  current_ = id;
  recent_.clear();
  recent_first_ = session.next;
  return Begun{session.next, session.record.ended};
}

absl::Status Spool::Append(sources::SensorFrame frame) {
  std::unique_lock lock(mutex_);
  const std::int64_t bytes = BytesOf(frame);
  changed_.wait(lock, [&] {
    return stopping_ || (unsynced_bytes_ + bytes <= kMaxUnsyncedBytes && MakeRoom(bytes));
  });
  if (stopping_) return absl::CancelledError("the spool is stopping");
  const auto found = sessions_.find(current_);
  if (found == sessions_.end() || found->second.record.ended) {
    return absl::FailedPreconditionError("no drive has been begun");
  }
  recent_.push_back(std::move(frame));
  ++found->second.next;
  unsynced_bytes_ += bytes;
  if (unsynced_bytes_ >= options_.sync_bytes) changed_.notify_all();
  return absl::OkStatus();
}

absl::Status Spool::End() {
  std::unique_lock lock(mutex_);
  WaitForSync(lock);
  const auto found = sessions_.find(current_);
  if (found == sessions_.end()) return absl::FailedPreconditionError("no drive has been begun");
  Session& session = found->second;
  if (session.synced < session.next) return absl::CancelledError("the spool is stopping");
  session.record.ended = true;
  return StoreRecord(session);
}

void Spool::Stop() {
  {
    std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
}

std::vector<std::string> Spool::Waiting() const {
  std::lock_guard lock(mutex_);
  std::vector<std::pair<std::int64_t, std::string>> waiting;
  for (const auto& [id, session] : sessions_) {
    if (!session.record.delivered) waiting.emplace_back(session.record.created_ns, id);
  }
  std::sort(waiting.begin(), waiting.end());
  std::vector<std::string> ids;
  for (auto& [created_ns, id] : waiting) ids.push_back(std::move(id));
  return ids;
}

absl::StatusOr<v1::CreateSessionRequest> Spool::RequestOf(const std::string& session) const {
  std::lock_guard lock(mutex_);
  const auto found = sessions_.find(session);
  if (found == sessions_.end()) {
    return absl::NotFoundError(absl::StrCat("the spool has no session '", session, "'"));
  }
  return found->second.record.request;
}

std::unique_ptr<sources::FrameSource> Spool::Read(const std::string& session) {
  return std::make_unique<SpoolSource>(this, session);
}

void Spool::Free(const std::string& session, std::int64_t offset) {
  std::lock_guard lock(mutex_);
  const auto found = sessions_.find(session);
  if (found == sessions_.end()) return;
  std::vector<Segment>& segments = found->second.segments;
  const std::int64_t position = PositionOf(found->second.record, offset);
  // The last segment stays: it tells where the session goes on.
  std::size_t gone = 0;
  while (gone + 1 < segments.size() && segments[gone + 1].first <= position) {
    ::unlink(segments[gone++].path.c_str());
  }
  if (gone == 0) return;
  segments.erase(segments.begin(), segments.begin() + static_cast<std::ptrdiff_t>(gone));
  changed_.notify_all();
}

absl::Status Spool::SetDelivered(const std::string& session) {
  std::unique_lock lock(mutex_);
  const auto found = sessions_.find(session);
  if (found == sessions_.end()) return absl::OkStatus();
  Session& done = found->second;
  if (session == current_) {
    WaitForSync(lock);
    if (stopping_) return absl::CancelledError("the spool is stopping");
    CloseSegment(done);
  }
  done.record.delivered = true;
  if (absl::Status stored = StoreRecord(done); !stored.ok()) return stored;
  for (const Segment& segment : done.segments) ::unlink(segment.path.c_str());
  done.segments.clear();
  changed_.notify_all();
  return absl::OkStatus();
}

std::int64_t Spool::TotalBytes() const {
  std::int64_t bytes = unsynced_bytes_;
  for (const auto& [id, session] : sessions_) {
    for (const Segment& segment : session.segments) bytes += segment.bytes;
  }
  return bytes;
}

bool Spool::MakeRoom(std::int64_t bytes) {
  if (options_.pause_when_full) return TotalBytes() + bytes <= options_.max_bytes;
  while (TotalBytes() + bytes > options_.max_bytes) {
    if (!DropOldestSegment()) return true;
  }
  return true;
}

// Of those that are closed.
bool Spool::DropOldestSegment() {
  Session* oldest = nullptr;
  for (auto& [id, session] : sessions_) {
    if (session.segments.size() <= (id == current_ ? 1u : 0u)) continue;
    if (oldest == nullptr ||
        session.segments.front().written_ns < oldest->segments.front().written_ns) {
      oldest = &session;
    }
  }
  if (oldest == nullptr) return false;
  // Where the session goes on is told by its last segment, or else by its record.
  if (oldest->segments.size() == 1 && !StoreRecord(*oldest).ok()) return false;
  ::unlink(oldest->segments.front().path.c_str());
  oldest->segments.erase(oldest->segments.begin());
  return true;
}

absl::Status Spool::StoreRecord(Session& session) {
  session.record.next = std::max(session.record.next, session.synced);
  return WriteRecord(session.folder, session.record);
}

void Spool::WaitForSync(std::unique_lock<std::mutex>& lock) {
  const auto found = sessions_.find(current_);
  while (!stopping_ && found != sessions_.end() && found->second.synced < found->second.next) {
    sync_now_ = true;
    changed_.notify_all();
    changed_.wait(lock);
  }
}

void Spool::SyncLoop() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait_for(lock, options_.sync_interval, [&] {
      return stopping_ || sync_now_ || unsynced_bytes_ >= options_.sync_bytes;
    });
    sync_now_ = false;
    const bool last = stopping_;
    const auto found = sessions_.find(current_);
    if (found != sessions_.end()) {
      while (found->second.synced < found->second.next && SyncBatch(found->second, lock)) {
        if (!options_.pause_when_full) MakeRoom(0);
      }
    }
    const std::int64_t too_old_ns =
        now_ns_() - static_cast<std::int64_t>(options_.max_hours * 3600.0 * 1e9);
    while (!options_.pause_when_full) {
      bool old = false;
      for (const auto& [id, session] : sessions_) {
        old |= session.segments.size() > (id == current_ ? 1u : 0u) &&
               session.segments.front().written_ns < too_old_ns;
      }
      if (!old || !DropOldestSegment()) break;
    }
    if (last) break;
  }
  if (const auto found = sessions_.find(current_); found != sessions_.end()) {
    CloseSegment(found->second);
  }
}

bool Spool::SyncBatch(Session& session, std::unique_lock<std::mutex>& lock) {
  const std::int64_t first = session.synced;
  std::vector<const sources::SensorFrame*> frames;  // a deque's elements stay where they are
  std::int64_t bytes = 0;
  const bool starts_segment = writer_ == nullptr;
  if (starts_segment) segment_frame_bytes_ = 0;
  for (auto i = static_cast<std::size_t>(first - recent_first_);
       i < recent_.size() && segment_frame_bytes_ + bytes < options_.segment_bytes; ++i) {
    frames.push_back(&recent_[i]);
    bytes += BytesOf(recent_[i]);
  }
  const std::string folder = session.folder;
  lock.unlock();
  const absl::Status written = WriteAndSync(folder, first, frames);
  lock.lock();
  if (!written.ok()) {
    // What stands behind the last sync is of unknown state: a segment of its own begins there.
    writer_.reset();
    if (starts_segment) ::unlink(SegmentPath(folder, first).c_str());
    const bool made_room = !options_.pause_when_full && DropOldestSegment();
    if (!made_room && !stopping_) changed_.wait_for(lock, kRetry, [&] { return stopping_; });
    return false;
  }
  if (starts_segment) session.segments.push_back({first, SegmentPath(folder, first), 0, 0});
  session.segments.back().bytes = writer_->size_bytes();
  session.segments.back().written_ns = now_ns_();
  session.synced = first + static_cast<std::int64_t>(frames.size());
  unsynced_bytes_ -= bytes;
  segment_frame_bytes_ += bytes;
  if (segment_frame_bytes_ >= options_.segment_bytes) CloseSegment(session);
  changed_.notify_all();
  return true;
}

absl::Status Spool::WriteAndSync(const std::string& folder, std::int64_t first,
                                 const std::vector<const sources::SensorFrame*>& frames) {
  const bool starts_segment = writer_ == nullptr;
  if (starts_segment) {
    const std::string path = SegmentPath(folder, first);
    ::unlink(path.c_str());
    recording::WriterOptions options;
    options.compression = recording::Compression::kLz4;
    options.summary = false;
    auto created = recording::Writer::Create(path, options);
    if (!created.ok()) return created.status();
    writer_ = *std::move(created);
  }
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const sources::SensorFormat format = sources::FormatOf(frames[i]->sensor);
    const absl::Status written = writer_->Write(
        format.topic, format.schema, frames[i]->log_time_ns,
        static_cast<std::uint32_t>(first + static_cast<std::int64_t>(i)), frames[i]->payload);
    if (!written.ok()) return written;
  }
  if (absl::Status flushed = writer_->Flush(/*sync=*/true); !flushed.ok()) return flushed;
  return starts_segment ? SyncFolder(folder) : absl::OkStatus();
}

// Its frames are read from the disk from now on.
void Spool::CloseSegment(Session& session) {
  if (writer_ && writer_->Close().ok()) session.segments.back().bytes = writer_->size_bytes();
  writer_.reset();
  while (recent_first_ < session.synced && !recent_.empty()) {
    recent_.pop_front();
    ++recent_first_;
  }
}

}  // namespace soundmap::spool
