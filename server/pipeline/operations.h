#pragma once

#include <atomic>
#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"

namespace soundmap::pipeline {

struct OperationInfo {
  std::string id;
  std::string kind;  // "build_map", "import_map", "backup"
  std::string site;  // empty: it concerns all
  bool done = false;
  double progress = 0.0;  // 0 .. 1
  std::string progress_text;
  absl::Status status;      // of the finished work
  std::string report_json;  // figures of the finished work
  std::int64_t create_time_ns = 0;
  std::int64_t end_time_ns = 0;
};

// What running work sees of its operation.
class OperationContext {
 public:
  virtual ~OperationContext() = default;
  virtual void Report(double progress, const std::string& text) = 0;
  virtual bool cancelled() const = 0;
};

// Long-running work, one thread's worth at a time so that robots keep theirs. Remembers the last
// 1000 operations. Thread safe.
class Operations {
 public:
  // Returns the report as JSON, or why it failed; Cancelled when it stopped because it was asked
  // to.
  using Work = std::function<absl::StatusOr<std::string>(OperationContext&)>;
  using Clock = std::function<std::int64_t()>;
  using Waiter = std::function<void(const OperationInfo&)>;

  // `timers` runs the time-outs of Wait().
  Operations(Clock now_ns, boost::asio::any_io_executor timers)
      : now_ns_(std::move(now_ns)), timers_(std::move(timers)), pool_(1) {}
  // Cancels what runs and waits for it.
  ~Operations();

  // A `request_id` that was used before returns the operation that it started. ResourceExhausted:
  // 100 are waiting.
  absl::StatusOr<OperationInfo> Start(const std::string& kind, const std::string& site,
                                      const std::string& request_id, Work work);
  absl::StatusOr<OperationInfo> Get(const std::string& id) const;
  // Oldest first; an empty site lists all.
  std::vector<OperationInfo> List(const std::string& site) const;
  // Calls `waiter` once, when the operation is done or the time is over, perhaps before this
  // returns.
  absl::Status Wait(const std::string& id, absl::Duration timeout, Waiter waiter);
  absl::StatusOr<OperationInfo> Cancel(const std::string& id);

 private:
  struct Running;

  const Clock now_ns_;
  const boost::asio::any_io_executor timers_;
  mutable std::mutex mutex_;
  std::map<std::string, std::shared_ptr<Running>>
      operations_;                                    // guarded by mutex_; ids sort by age
  std::map<std::string, std::string> id_of_request_;  // guarded by mutex_
  std::int64_t started_ = 0;                          // guarded by mutex_
  boost::asio::thread_pool pool_;
};

}  // namespace soundmap::pipeline
