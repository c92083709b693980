#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <chrono>

#include "api/access.h"
#include "pipeline/operations.h"
#include "pipeline/sites.h"
#include "soundmap/v1/map_service.grpc.pb.h"

namespace soundmap::api {

class MapService : public v1::MapService::CallbackService {
 public:
  // An import of which too little arrives in `import_patience` is ended.
  MapService(pipeline::Sites* sites, Access* access, pipeline::Operations* operations,
             boost::asio::any_io_executor executor, std::chrono::milliseconds import_patience)
      : sites_(sites),
        access_(access),
        operations_(operations),
        executor_(std::move(executor)),
        import_patience_(import_patience) {}

  grpc::ServerUnaryReactor* BuildMap(grpc::CallbackServerContext* context,
                                     const v1::BuildMapRequest* request,
                                     v1::Operation* response) override;
  grpc::ServerReadReactor<v1::ImportMapRequest>* ImportMap(grpc::CallbackServerContext* context,
                                                           v1::Operation* response) override;
  grpc::ServerWriteReactor<v1::ExportMapResponse>* ExportMap(
      grpc::CallbackServerContext* context, const v1::ExportMapRequest* request) override;

 private:
  class Import;

  pipeline::Sites* const sites_;
  Access* const access_;
  pipeline::Operations* const operations_;
  const boost::asio::any_io_executor executor_;
  const std::chrono::milliseconds import_patience_;
  // Shared by the imports that hold a file in memory, and so their count.
  const std::shared_ptr<const int> imports_ = std::make_shared<const int>(0);
};

}  // namespace soundmap::api
