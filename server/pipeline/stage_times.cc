#include "pipeline/stage_times.h"

#include <ctime>
#include <numeric>

namespace soundmap::pipeline {
namespace {

std::chrono::nanoseconds ThreadCpuTime() {
  timespec time = {};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

}  // namespace

const char* NameOf(Stage stage) {
  static constexpr std::array<const char*, kStages> kNames = {
      "receive", "log",    "localize", "spectra", "power",   "evidence",
      "cast",    "commit", "map",      "state",   "session", "sources"};
  return kNames[static_cast<std::size_t>(stage)];
}

void StageClock::Start() {
  if (times_ == nullptr) return;
  running_ = true;
  laps_.fill({});
  cpu_at_start_ = ThreadCpuTime();
  lap_ = std::chrono::steady_clock::now();
}

void StageClock::Lap(Stage stage) {
  if (!running_) return;
  const auto now = std::chrono::steady_clock::now();
  laps_[static_cast<std::size_t>(stage)] += now - lap_;
  lap_ = now;
}

void StageClock::Stop(Stage stage) {
  if (!running_) return;
  Lap(stage);
  running_ = false;
  const std::chrono::nanoseconds cpu = ThreadCpuTime() - cpu_at_start_;
  const auto all = std::accumulate(laps_.begin(), laps_.end(), std::chrono::nanoseconds(0));
  if (all.count() <= 0) return;
  const double scale = static_cast<double>(cpu.count()) / static_cast<double>(all.count());
  for (int i = 0; i < kStages; ++i) {
    if (laps_[i].count() == 0) continue;
    times_->Add(static_cast<Stage>(i), std::chrono::nanoseconds(static_cast<std::int64_t>(
                                           static_cast<double>(laps_[i].count()) * scale)));
  }
}

}  // namespace soundmap::pipeline
