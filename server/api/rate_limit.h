#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>

namespace soundmap::api {

// How often each of many clients may do something: `per_s` in the long run, twice as many at once.
// Knows 4096 clients at a time; thread safe.
class RateLimit {
 public:
  explicit RateLimit(double per_s) : per_s_(per_s) {}

  // False: too often.
  bool Take(const std::string& client, std::int64_t now_ns);

 private:
  struct Bucket {
    double left = 0.0;
    std::int64_t filled_ns = 0;
  };
  void Forget(std::int64_t now_ns);

  const double per_s_;
  std::mutex mutex_;
  std::map<std::string, Bucket> buckets_;  // guarded by mutex_
};

}  // namespace soundmap::api
