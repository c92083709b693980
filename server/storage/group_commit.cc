#include "storage/group_commit.h"

#include <algorithm>
#include <boost/asio/error.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <condition_variable>
#include <ctime>
#include <map>
#include <mutex>
#include <utility>

namespace soundmap::storage {
namespace {

std::chrono::nanoseconds ThreadCpuTime() {
  timespec time = {};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

}  // namespace

struct GroupCommit::State : std::enable_shared_from_this<State> {
  State(boost::asio::any_io_executor executor_in, Store* store_in, OnDurable on_durable_in,
        const GroupCommitOptions& options_in)
      : executor(std::move(executor_in)),
        store(store_in),
        on_durable(std::move(on_durable_in)),
        options(options_in),
        timer(executor) {}

  struct Backoff {
    int wait_intervals = 0;  // still to wait
    int next_intervals = 1;  // to wait after the next error
  };

  const boost::asio::any_io_executor executor;
  Store* const store;
  const OnDurable on_durable;
  const GroupCommitOptions options;

  std::mutex mutex;  // guards what follows
  std::condition_variable idle;
  boost::asio::steady_timer timer;
  bool stopping = false;
  int running = 0;                        // a tick counts as one
  std::map<SessionId, Backoff> backoffs;  // of the logs that fail

  void ScheduleLocked();
  void Tick();
  bool IsDueLocked(const SessionId& id, const SessionLog& log);
  void SyncOne(const SessionId& id, SessionLog* log);
  void EndOneLocked();
};

void GroupCommit::State::ScheduleLocked() {
  if (stopping) return;
  timer.expires_after(options.interval);
  timer.async_wait([self = shared_from_this()](const boost::system::error_code& error) {
    if (!error) self->Tick();
  });
}

void GroupCommit::State::EndOneLocked() {
  if (--running > 0) return;
  ScheduleLocked();
  idle.notify_all();
}

bool GroupCommit::State::IsDueLocked(const SessionId& id, const SessionLog& log) {
  if (log.received() == log.durable()) return false;
  const auto backoff = backoffs.find(id);
  return backoff == backoffs.end() || --backoff->second.wait_intervals <= 0;
}

void GroupCommit::State::Tick() {
  {
    const std::lock_guard lock(mutex);
    if (stopping) return;
    running = 1;
  }
  const auto sessions = store->OpenSessions();
  const std::lock_guard lock(mutex);
  for (const auto& [id, log] : sessions) {
    if (stopping || !IsDueLocked(id, *log)) continue;
    ++running;
    boost::asio::post(executor, [self = shared_from_this(), id = id, log = log] {
      self->SyncOne(id, log.get());
    });
  }
  std::erase_if(backoffs, [&sessions](const auto& entry) {
    return std::none_of(sessions.begin(), sessions.end(),
                        [&entry](const auto& session) { return session.first == entry.first; });
  });
  EndOneLocked();
}

void GroupCommit::State::SyncOne(const SessionId& id, SessionLog* log) {
  const std::chrono::nanoseconds begin = ThreadCpuTime();
  const absl::StatusOr<std::int64_t> durable = log->Sync();
  if (options.on_sync) options.on_sync(ThreadCpuTime() - begin);
  on_durable(id, durable);
  const std::lock_guard lock(mutex);
  if (durable.ok()) {
    backoffs.erase(id);
  } else {
    Backoff& backoff = backoffs[id];
    backoff.wait_intervals = backoff.next_intervals;
    backoff.next_intervals = std::min(2 * backoff.next_intervals, options.max_backoff_intervals);
  }
  EndOneLocked();
}

GroupCommit::GroupCommit(boost::asio::any_io_executor executor, Store* store, OnDurable on_durable,
                         const GroupCommitOptions& options)
    : state_(std::make_shared<State>(std::move(executor), store, std::move(on_durable), options)) {
  const std::lock_guard lock(state_->mutex);
  state_->ScheduleLocked();
}

GroupCommit::~GroupCommit() { Stop(); }

void GroupCommit::Stop() {
  std::unique_lock lock(state_->mutex);
  state_->stopping = true;
  state_->timer.cancel();
  state_->idle.wait(lock, [this] { return state_->running == 0; });
}

}  // namespace soundmap::storage
