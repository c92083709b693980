#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/strand.hpp>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "pipeline/meters.h"
#include "pipeline/site.h"
#include "storage/group_commit.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// All sites of a server. Thread safe.
class Sites {
 public:
  struct Options {
    boost::asio::any_io_executor executor;
    Session::FrameDecoder decode;
    // The parameters that a new site gets, by the profile's name.
    std::function<absl::StatusOr<Profile>(const std::string& name)> profile;
    std::function<std::int64_t()> now_ns;
    std::shared_ptr<Meters> meters = std::make_shared<Meters>();
    // Syncs and removes session logs, so that a sync need not wait behind the work on frames; none:
    // as all else.
    boost::asio::any_io_executor sync_executor;
  };

  // Opens every site that the store knows and brings its sessions to where they were. `store`
  // outlives this.
  static absl::StatusOr<std::unique_ptr<Sites>> Open(storage::Store* store, Options options);
  // Stop().
  ~Sites();

  // The same request again gives the site that it created. AlreadyExists; InvalidArgument: not a
  // name, an unknown profile, as ValidateBands().
  absl::StatusOr<std::shared_ptr<Site>> Create(const std::string& site, const std::string& profile,
                                               const std::string& request_id,
                                               const std::vector<Band>& bands = {});
  absl::StatusOr<std::shared_ptr<Site>> Get(const std::string& site) const;
  std::vector<std::shared_ptr<Site>> List() const;  // by name
  // With its map, sessions and recordings. FailedPrecondition: a robot is streaming to it.
  absl::Status Delete(const std::string& site);

  // Of all sites; others add what they do for robots.
  Meters& meters() { return *options_.meters; }

  // Nothing more is processed; what is in the logs is processed after the next Open(). Idempotent.
  // Not on the executor's own threads.
  void Stop();

 private:
  Sites(storage::Store* store, Options options);
  void WatchSources();
  boost::asio::any_io_executor SyncExecutor() const;

  storage::Store* const store_;
  const Options options_;
  mutable std::mutex mutex_;
  std::map<std::string, std::shared_ptr<Site>> sites_;  // guarded by mutex_
  std::unique_ptr<storage::GroupCommit> group_commit_;
  boost::asio::strand<boost::asio::any_io_executor> timer_strand_;
  boost::asio::steady_timer source_timer_;                         // on timer_strand_
  std::chrono::steady_clock::time_point dropped_at_;               // on timer_strand_
  boost::asio::strand<boost::asio::any_io_executor> drop_strand_;  // it waits for the disk
};

}  // namespace soundmap::pipeline
