#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "api/access.h"
#include "api/tls.h"

namespace soundmap::web_gateway {

// The HTTP port, with TLS 1.3 where a certificate is given: `GET /livez` (200 while the process
// runs), `GET /readyz` (200 while it serves, else 503) and `GET /metrics` (for Prometheus; needs a
// credential that may read, else 401, 403 or 429). Other paths are 404, other methods 405; a
// request is at most 16 KiB and must arrive within 30 s; 512 connections at a time.
class HttpGateway {
 public:
  // Where answers come from; any thread calls.
  struct Source {
    std::function<bool()> is_ready;
    std::function<std::string()> metrics;
    api::Access* access = nullptr;
  };

  // `address` is HOST:PORT, port 0 for any. InvalidArgument: not an address, the TLS files;
  // Unavailable: the port cannot be bound.
  static absl::StatusOr<std::unique_ptr<HttpGateway>> Start(
      const boost::asio::any_io_executor& executor, const std::string& address,
      const api::TlsFiles& tls, Source source);
  // Stops listening and closes the connections.
  ~HttpGateway();

  // HOST:PORT as bound.
  const std::string& address() const { return address_; }

 private:
  class Listener;
  HttpGateway() = default;

  std::shared_ptr<Listener> listener_;
  std::string address_;
};

}  // namespace soundmap::web_gateway
