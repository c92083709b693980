#include "tests/api/test_server.h"

#include "api/decode_message.h"

namespace soundmap::api {

TestServer::TestServer(const Options& options)
    : store_(storage::Store::Open(options.folder).value()) {
  pipeline::Sites::Options sites;
  sites.executor = pool_.get_executor();
  sites.decode = DecodeMessage;
  sites.profile = options.profile;
  sites.now_ns = options.now_ns;
  sites_ = pipeline::Sites::Open(store_.get(), std::move(sites)).value();
  operations_ = std::make_unique<pipeline::Operations>(options.now_ns, pool_.get_executor());
  access_ = Access::Create(options.access, options.now_ns).value();
  Server::Parts parts;
  parts.sites = sites_.get();
  parts.operations = operations_.get();
  parts.access = access_.get();
  parts.store = store_.get();
  parts.executor = pool_.get_executor();
  parts.now_ns = options.now_ns;
  parts.server_id = "test";
  parts.import_patience = options.import_patience;
  server_ = Server::Start("127.0.0.1:0", options.tls, parts).value();
  address_ = server_->address();
}

TestServer::~TestServer() {
  if (server_) Shutdown();
  operations_.reset();
  sites_.reset();
  pool_.join();
}

void TestServer::Shutdown() {
  server_->Shutdown();
  server_.reset();
}

std::shared_ptr<grpc::Channel> TestServer::Channel() const {
  return grpc::CreateChannel(address_, grpc::InsecureChannelCredentials());
}

}  // namespace soundmap::api
