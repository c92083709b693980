#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "api/access.h"
#include "api/tls.h"
#include "pipeline/operations.h"
#include "pipeline/sites.h"
#include "storage/store.h"

namespace soundmap::api {

// The gRPC services of soundmap.v1, with health checking and reflection.
class Server {
 public:
  struct Parts {
    pipeline::Sites* sites = nullptr;
    pipeline::Operations* operations = nullptr;
    Access* access = nullptr;
    const storage::Store* store = nullptr;
    boost::asio::any_io_executor executor;
    std::function<std::int64_t()> now_ns;
    std::string backup_dir;  // takes backups; empty: none are made
    std::string server_id;   // of this run of the server
    // An upload that stalls for so long is ended.
    std::chrono::milliseconds import_patience = std::chrono::seconds(30);
  };

  // Serves at once. Unavailable: the address cannot be bound. InvalidArgument: the TLS files.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const std::string& address,
                                                       const TlsFiles& tls, const Parts& parts);
  virtual ~Server() = default;

  // HOST:PORT as bound.
  virtual std::string address() const = 0;
  // Health says NOT_SERVING, robots are told to go, calls that run get two seconds. Once.
  virtual void Shutdown() = 0;
};

}  // namespace soundmap::api
