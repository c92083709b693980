#pragma once

#include "pipeline/operations.h"
#include "pipeline/sites.h"
#include "soundmap/v1/tuning_service.grpc.pb.h"

namespace soundmap::api {

class TuningService : public v1::TuningService::CallbackService {
 public:
  TuningService(pipeline::Sites* sites, pipeline::Operations* operations)
      : sites_(sites), operations_(operations) {}

  grpc::ServerUnaryReactor* TryParameters(grpc::CallbackServerContext* context,
                                          const v1::TryParametersRequest* request,
                                          v1::Operation* response) override;

 private:
  pipeline::Sites* const sites_;
  pipeline::Operations* const operations_;
};

}  // namespace soundmap::api
