#pragma once

#include <boost/asio/any_io_executor.hpp>

#include "api/access.h"
#include "pipeline/sites.h"
#include "soundmap/v1/watch_service.grpc.pb.h"

namespace soundmap::api {

class WatchService : public v1::WatchService::CallbackService {
 public:
  // `server_id` differs between two runs of the server: a resume token of another run starts anew.
  WatchService(pipeline::Sites* sites, Access* access, boost::asio::any_io_executor executor,
               std::string server_id)
      : sites_(sites),
        access_(access),
        executor_(std::move(executor)),
        server_id_(std::move(server_id)) {}

  grpc::ServerWriteReactor<v1::WatchEvent>* Watch(grpc::CallbackServerContext* context,
                                                  const v1::WatchRequest* request) override;

 private:
  class Stream;

  pipeline::Sites* const sites_;
  Access* const access_;
  const boost::asio::any_io_executor executor_;
  const std::string server_id_;
};

}  // namespace soundmap::api
