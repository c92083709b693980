#include "pipeline/live_robots.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "pipeline/events.h"

namespace soundmap::pipeline {
namespace {

// Closed ones included, whose agents are known.
constexpr std::size_t kMaxRobots = 4096;

}  // namespace

absl::StatusOr<LiveRobots::Lease> LiveRobots::Open(const std::string& robot, std::int64_t epoch,
                                                   std::int64_t now_ns) {
  std::lock_guard lock(mutex_);
  if (robots_.size() >= kMaxRobots && robots_.count(robot) == 0) {
    std::erase_if(robots_, [](const auto& entry) { return !entry.second.open; });
    if (robots_.size() >= kMaxRobots) {
      return absl::ResourceExhaustedError(
          absl::StrCat("more than ", kMaxRobots, " robots report live"));
    }
  }
  Robot& known = robots_[robot];
  // Epochs are times at which they were given, so that those that a server gave before it was
  // started again keep their order. One of the future was given by nobody.
  const bool given = epoch > 0 && epoch <= std::max(known.lease.epoch, now_ns);
  if (given && epoch < known.lease.epoch) {
    return absl::AbortedError(
        absl::StrCat("a newer agent of robot '", robot, "' reports live in place of this one"));
  }
  known.lease.epoch = given ? epoch : std::max(known.lease.epoch + 1, now_ns);
  known.lease.stream = ++streams_;
  known.open = true;
  return known.lease;
}

absl::Status LiveRobots::Report(const std::string& robot, const Lease& lease, LiveView view) {
  {
    std::lock_guard lock(mutex_);
    const auto known = robots_.find(robot);
    if (known == robots_.end() || known->second.lease.stream != lease.stream) {
      return absl::AbortedError(
          absl::StrCat("a later live stream of robot '", robot, "' is heard in place of this one"));
    }
    std::optional<LiveView>& last = known->second.view;
    if (!view.report.laser && last && last->session == view.session) {
      view.report.laser = last->report.laser;
    }
    last = std::move(view);
  }
  events_->Publish(LiveChanged{robot});
  return absl::OkStatus();
}

void LiveRobots::Close(const std::string& robot, const Lease& lease) {
  {
    std::lock_guard lock(mutex_);
    const auto known = robots_.find(robot);
    if (known == robots_.end() || known->second.lease.stream != lease.stream) return;
    known->second.open = false;
    known->second.view.reset();
  }
  events_->Publish(LiveChanged{robot});
}

std::optional<LiveView> LiveRobots::Find(const std::string& robot) const {
  std::lock_guard lock(mutex_);
  const auto known = robots_.find(robot);
  return known == robots_.end() ? std::nullopt : known->second.view;
}

std::vector<std::pair<std::string, LiveView>> LiveRobots::List() const {
  std::lock_guard lock(mutex_);
  std::vector<std::pair<std::string, LiveView>> list;
  for (const auto& [name, robot] : robots_) {
    if (robot.view) list.emplace_back(name, *robot.view);
  }
  return list;
}

}  // namespace soundmap::pipeline
