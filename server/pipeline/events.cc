#include "pipeline/events.h"

#include <algorithm>

namespace soundmap::pipeline {

void EventRing::Publish(Event event) {
  std::lock_guard lock(mutex_);
  events_.push_back(std::move(event));
  if (events_.size() > capacity_) {
    events_.pop_front();
    ++first_;
  }
  for (const auto& [subscription, wake] : wakes_) wake();
}

EventRing::Batch EventRing::Read(std::int64_t from, std::size_t max_events) const {
  std::lock_guard lock(mutex_);
  const std::int64_t end = first_ + static_cast<std::int64_t>(events_.size());
  Batch batch;
  batch.lost = from < first_ || from > end;
  const std::int64_t begin = batch.lost ? first_ : from;
  batch.next = std::min<std::int64_t>(end, begin + static_cast<std::int64_t>(max_events));
  batch.events.assign(events_.begin() + (begin - first_), events_.begin() + (batch.next - first_));
  return batch;
}

std::int64_t EventRing::next() const {
  std::lock_guard lock(mutex_);
  return first_ + static_cast<std::int64_t>(events_.size());
}

int EventRing::Subscribe(std::function<void()> wake) {
  std::lock_guard lock(mutex_);
  wakes_[++subscriptions_] = std::move(wake);
  return subscriptions_;
}

void EventRing::Unsubscribe(int subscription) {
  std::lock_guard lock(mutex_);
  wakes_.erase(subscription);
}

}  // namespace soundmap::pipeline
