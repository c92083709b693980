#include "retry.h"

#include <algorithm>

#include "absl/random/distributions.h"

namespace soundmap::internal {

Backoff::Backoff(const RetryOptions& options) : options_(options) { Reset(); }

std::chrono::milliseconds Backoff::Next(absl::BitGenRef random) {
  const auto wait = absl::Uniform(absl::IntervalClosed, random, std::int64_t{0},
                                  static_cast<std::int64_t>(limit_.count()));
  limit_ = std::min(limit_ * 2, options_.max_backoff);
  return std::chrono::milliseconds(wait);
}

void Backoff::Reset() { limit_ = std::min(options_.initial_backoff, options_.max_backoff); }

}  // namespace soundmap::internal
