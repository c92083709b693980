#include "pipeline/operations.h"

#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace soundmap::pipeline {
namespace {

constexpr std::size_t kMaxRemembered = 1000;
constexpr int kMaxWaiting = 100;

}  // namespace

struct Operations::Running : OperationContext {
  Operations* owner = nullptr;
  OperationInfo info;  // guarded by owner->mutex_
  std::string request_id;
  std::vector<std::shared_ptr<boost::asio::steady_timer>> waiting;  // guarded by owner->mutex_
  std::atomic<bool> cancel_requested = false;

  void Report(double progress, const std::string& text) override {
    std::lock_guard lock(owner->mutex_);
    info.progress = progress;
    info.progress_text = text;
  }
  bool cancelled() const override { return cancel_requested; }
};

Operations::~Operations() {
  {
    std::lock_guard lock(mutex_);
    for (auto& [id, running] : operations_) running->cancel_requested = true;
  }
  pool_.join();
}

absl::StatusOr<OperationInfo> Operations::Start(const std::string& kind, const std::string& site,
                                                const std::string& request_id, Work work) {
  auto running = std::make_shared<Running>();
  {
    std::lock_guard lock(mutex_);
    if (const auto known = id_of_request_.find(request_id);
        !request_id.empty() && known != id_of_request_.end()) {
      return operations_.at(known->second)->info;
    }
    int waiting = 0;
    for (const auto& [id, other] : operations_) waiting += other->info.done ? 0 : 1;
    if (waiting >= kMaxWaiting) {
      return absl::ResourceExhaustedError(
          absl::StrCat(kMaxWaiting, " operations are waiting already"));
    }
    for (auto it = operations_.begin();
         operations_.size() >= kMaxRemembered && it != operations_.end();) {
      if (it->second->info.done) {
        id_of_request_.erase(it->second->request_id);
        it = operations_.erase(it);
      } else {
        ++it;
      }
    }
    running->owner = this;
    running->request_id = request_id;
    running->info.id = absl::StrFormat("%08d", ++started_);
    running->info.kind = kind;
    running->info.site = site;
    running->info.create_time_ns = now_ns_();
    operations_[running->info.id] = running;
    if (!request_id.empty()) id_of_request_[request_id] = running->info.id;
  }
  const OperationInfo info = running->info;
  boost::asio::post(pool_, [this, running, work = std::move(work)] {
    absl::StatusOr<std::string> report =
        running->cancelled() ? absl::CancelledError("the operation was cancelled before it started")
                             : work(*running);
    {
      std::lock_guard lock(mutex_);
      running->info.done = true;
      running->info.status = report.status();
      if (report.ok()) {
        running->info.report_json = *std::move(report);
        running->info.progress = 1.0;
      }
      running->info.end_time_ns = now_ns_();
      for (const auto& timer : running->waiting) timer->cancel();
      running->waiting.clear();
    }
  });
  return info;
}

absl::StatusOr<OperationInfo> Operations::Get(const std::string& id) const {
  std::lock_guard lock(mutex_);
  const auto found = operations_.find(id);
  if (found == operations_.end()) {
    return absl::NotFoundError(absl::StrCat("operation '", id, "' does not exist"));
  }
  return found->second->info;
}

std::vector<OperationInfo> Operations::List(const std::string& site) const {
  std::lock_guard lock(mutex_);
  std::vector<OperationInfo> infos;
  for (const auto& [id, running] : operations_) {
    if (site.empty() || running->info.site == site) infos.push_back(running->info);
  }
  return infos;
}

absl::Status Operations::Wait(const std::string& id, absl::Duration timeout, Waiter waiter) {
  std::unique_lock lock(mutex_);
  const auto found = operations_.find(id);
  if (found == operations_.end()) {
    return absl::NotFoundError(absl::StrCat("operation '", id, "' does not exist"));
  }
  const std::shared_ptr<Running> running = found->second;
  if (running->info.done) {
    const OperationInfo info = running->info;
    lock.unlock();
    waiter(info);
    return absl::OkStatus();
  }
  // The end of the work cancels the timer; either way it fires once.
  auto timer = std::make_shared<boost::asio::steady_timer>(timers_);
  timer->expires_after(absl::ToChronoMilliseconds(timeout));
  running->waiting.push_back(timer);
  timer->async_wait([this, running, timer, waiter = std::move(waiter)](boost::system::error_code) {
    std::unique_lock lock(mutex_);
    std::erase(running->waiting, timer);
    const OperationInfo info = running->info;
    lock.unlock();
    waiter(info);
  });
  return absl::OkStatus();
}

absl::StatusOr<OperationInfo> Operations::Cancel(const std::string& id) {
  std::lock_guard lock(mutex_);
  const auto found = operations_.find(id);
  if (found == operations_.end()) {
    return absl::NotFoundError(absl::StrCat("operation '", id, "' does not exist"));
  }
  found->second->cancel_requested = true;
  return found->second->info;
}

}  // namespace soundmap::pipeline
