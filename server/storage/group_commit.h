#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>

#include "absl/status/statusor.h"
#include "storage/store.h"

namespace soundmap::storage {

struct GroupCommitOptions {
  std::chrono::milliseconds interval{100};
  int max_backoff_intervals =
      64;  // a log that fails is tried again after 1, 2, 4, .. this many intervals
  std::function<void(std::chrono::nanoseconds cpu_time)> on_sync;  // for those who measure
};

// Syncs the session logs of a store that have pending frames, once an interval and as many at a
// time as the executor has threads, so that frames become durable together.
class GroupCommit {
 public:
  // Called on the executor, once for each log that was synced: its durable() or the error, which
  // will be tried again. Calls for one session follow one another. It must not wait for Stop().
  using OnDurable = std::function<void(const SessionId&, const absl::StatusOr<std::int64_t>&)>;

  // `store` must outlive this. Starts at once.
  GroupCommit(boost::asio::any_io_executor executor, Store* store, OnDurable on_durable,
              const GroupCommitOptions& options = {});
  ~GroupCommit();  // Stop()

  // No further sync begins; returns when none is running. Not on the executor's own thread.
  void Stop();

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace soundmap::storage
