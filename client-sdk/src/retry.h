#pragma once

#include <chrono>

#include "absl/random/bit_gen_ref.h"
#include "soundmap/options.h"

namespace soundmap::internal {

// Full-jitter exponential back-off (RetryOptions).
class Backoff {
 public:
  explicit Backoff(const RetryOptions& options);

  // How long to wait before the next attempt: uniform in [0, limit]; the limit then doubles up to
  // max_backoff.
  std::chrono::milliseconds Next(absl::BitGenRef random);
  // The next wait is the first one again.
  void Reset();

 private:
  RetryOptions options_;
  std::chrono::milliseconds limit_;
};

}  // namespace soundmap::internal
