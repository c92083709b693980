#pragma once

#include <atomic>
#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <functional>

#include "api/access.h"
#include "api/rate_limit.h"
#include "pipeline/sites.h"
#include "soundmap/v1/live_service.grpc.pb.h"

namespace soundmap::api {

class LiveService : public v1::LiveService::CallbackService {
 public:
  // `executor` runs the watchdogs, which end a stream after `silence`; `now_ns` is the server's
  // clock, also that of the time exchange.
  LiveService(pipeline::Sites* sites, Access* access, boost::asio::any_io_executor executor,
              std::function<std::int64_t()> now_ns,
              std::chrono::milliseconds silence = std::chrono::seconds(10));

  grpc::ServerBidiReactor<v1::LiveRequest, v1::LiveResponse>* Live(
      grpc::CallbackServerContext* context) override;

  // Streams end with their next report.
  void Drain() { draining_ = true; }

 private:
  class Stream;

  pipeline::Sites* const sites_;
  Access* const access_;
  const boost::asio::any_io_executor executor_;
  const std::function<std::int64_t()> now_ns_;
  const std::chrono::milliseconds silence_;
  RateLimit reports_;
  std::atomic<bool> draining_ = false;
};

}  // namespace soundmap::api
