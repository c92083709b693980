#pragma once

#include "api/access.h"
#include "pipeline/operations.h"
#include "pipeline/sites.h"
#include "soundmap/v1/tuning_service.grpc.pb.h"

namespace soundmap::api {

class TuningService : public v1::TuningService::CallbackService {
 public:
  TuningService(pipeline::Sites* sites, Access* access, pipeline::Operations* operations)
      : sites_(sites), access_(access), operations_(operations) {}

  grpc::ServerUnaryReactor* TryParameters(grpc::CallbackServerContext* context,
                                          const v1::TryParametersRequest* request,
                                          v1::Operation* response) override;

 private:
  pipeline::Sites* const sites_;
  Access* const access_;
  pipeline::Operations* const operations_;
};

}  // namespace soundmap::api
