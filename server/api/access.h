#pragma once

#include <grpcpp/grpcpp.h>

#include <array>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "api/grant.h"
#include "api/rate_limit.h"
#include "api/token_file.h"

namespace spdlog {
class logger;
}

namespace soundmap::api {

// Who asks, and what they may do.
struct Caller {
  Grant grant;
  std::string peer;          // address, without the port
  std::string token_sha256;  // empty: none was shown
};

// Knows the callers: apps by the token that they show, robots by their certificate. Without a token
// file and without robots' certificates anybody may do anything. Thread safe.
class Access {
 public:
  struct Options {
    std::string token_file;  // read again when it changes; empty: no tokens
    bool robots_by_certificate = false;
    double calls_per_s = 500.0;  // of one client, in the long run; twice as many at once
    std::string audit_log;       // file; empty: standard error
  };
  // What a connection and a call show.
  struct Shown {
    std::string authorization;                  // the header's value
    std::vector<std::string> certificate_uris;  // of a certificate that was verified
    std::string peer;
  };
  enum class Refusal { kUnauthenticated, kDenied, kTooOften };
  static constexpr int kRefusals = 3;

  // InvalidArgument, NotFound: the token file; Unavailable: the audit log cannot be written.
  static absl::StatusOr<std::unique_ptr<Access>> Create(const Options& options,
                                                        std::function<std::int64_t()> now_ns);

  // Unauthenticated; ResourceExhausted: the client calls too often.
  absl::StatusOr<Caller> CallerOf(const Shown& shown);
  absl::StatusOr<Caller> CallerOf(const grpc::CallbackServerContext& context);

  // CallerOf() and Grant::Check().
  absl::StatusOr<Caller> Check(const grpc::CallbackServerContext& context, Right right,
                               const std::string& site, const std::string& robot = {});
  // Grant::Check(), counted.
  absl::Status Check(const Caller& caller, Right right, const std::string& site,
                     const std::string& robot = {});

  // For long streams. Unauthenticated: the caller's token or robot is not what it was, or its time
  // is over.
  absl::Status Recheck(const Caller& caller);

  // Writes a line of the audit log: who asked for `deed` on `what`, and what came of it. Returns
  // `result`.
  absl::Status Audit(const grpc::CallbackServerContext& context, const char* deed,
                     const std::string& what, const absl::Status& result);

  std::int64_t refusals(Refusal kind) const { return refusals_[static_cast<std::size_t>(kind)]; }

 private:
  Access(const Options& options, std::function<std::int64_t()> now_ns);
  absl::StatusOr<Caller> Identify(const Shown& shown);
  std::shared_ptr<const TokenFile> Tokens();
  absl::Status Count(const absl::Status& status);

  const Options options_;
  const std::function<std::int64_t()> now_ns_;
  std::shared_ptr<spdlog::logger> audit_;
  RateLimit calls_;
  RateLimit failures_;
  std::array<std::atomic<std::int64_t>, kRefusals> refusals_ = {};

  std::mutex mutex_;
  // Guarded by mutex_.
  std::shared_ptr<const TokenFile> tokens_;
  std::string token_stamp_;  // of the file that tokens_ was read from
  std::int64_t looked_ns_ = 0;
};

// What a call asks for, see find.h.
struct Ask {
  Access* access;
  const grpc::CallbackServerContext* context;
  Right right;
};

}  // namespace soundmap::api
