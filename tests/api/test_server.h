#pragma once

#include <grpcpp/grpcpp.h>

#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "api/access.h"
#include "api/server.h"
#include "pipeline/operations.h"
#include "pipeline/sites.h"
#include "storage/store.h"

namespace soundmap::api {

// A whole gRPC server in this process on a free port of loopback, put together as soundmap-server
// does.
class TestServer {
 public:
  struct Options {
    std::string folder;  // the store's; it stays
    std::function<std::int64_t()> now_ns = [] { return std::int64_t{1}; };
    std::function<absl::StatusOr<pipeline::Profile>(const std::string&)> profile =
        pipeline::ProfileByName;
    Access::Options access;
    TlsFiles tls;
    std::chrono::milliseconds import_patience = std::chrono::seconds(30);
  };

  explicit TestServer(const Options& options);
  ~TestServer();  // Shutdown(), unless that was
  // Ends its calls.
  void Shutdown();

  const std::string& address() const { return address_; }
  // In plain text.
  std::shared_ptr<grpc::Channel> Channel() const;
  storage::Store& store() { return *store_; }
  pipeline::Sites& sites() { return *sites_; }
  pipeline::Operations& operations() { return *operations_; }
  Access& access() { return *access_; }

 private:
  boost::asio::thread_pool pool_{2};
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<pipeline::Sites> sites_;
  std::unique_ptr<pipeline::Operations> operations_;
  std::unique_ptr<Access> access_;
  std::unique_ptr<Server> server_;
  std::string address_;
};

}  // namespace soundmap::api
