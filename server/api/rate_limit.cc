#include "api/rate_limit.h"

#include <algorithm>

namespace soundmap::api {
namespace {

constexpr std::size_t kMaxClients = 4096;
constexpr double kBurst_s = 2.0;

}  // namespace

bool RateLimit::Take(const std::string& client, std::int64_t now_ns) {
  const std::lock_guard lock(mutex_);
  if (buckets_.size() >= kMaxClients && buckets_.count(client) == 0) Forget(now_ns);
  const auto [found, is_new] = buckets_.try_emplace(client);
  Bucket& bucket = found->second;
  const double full = kBurst_s * per_s_;
  const double since_s =
      1e-9 * static_cast<double>(std::max<std::int64_t>(now_ns - bucket.filled_ns, 0));
  bucket.left = is_new ? full : std::min(full, bucket.left + per_s_ * since_s);
  bucket.filled_ns = now_ns;
  if (bucket.left < 1.0) return false;
  bucket.left -= 1.0;
  return true;
}

// With mutex_ held. Who was silent for so long has a full bucket again, known or not.
void RateLimit::Forget(std::int64_t now_ns) {
  const auto silent_ns = static_cast<std::int64_t>(kBurst_s * 1e9);
  std::erase_if(buckets_,
                [&](const auto& entry) { return now_ns - entry.second.filled_ns >= silent_ns; });
  // So many at once are one client with many addresses.
  if (buckets_.size() >= kMaxClients) buckets_.clear();
}

}  // namespace soundmap::api
