#pragma once

#include "pipeline/operations.h"
#include "soundmap/v1/operation_service.grpc.pb.h"

namespace soundmap::api {

class OperationService : public v1::OperationService::CallbackService {
 public:
  explicit OperationService(pipeline::Operations* operations) : operations_(operations) {}

  grpc::ServerUnaryReactor* GetOperation(grpc::CallbackServerContext* context,
                                         const v1::GetOperationRequest* request,
                                         v1::Operation* response) override;
  grpc::ServerUnaryReactor* ListOperations(grpc::CallbackServerContext* context,
                                           const v1::ListOperationsRequest* request,
                                           v1::ListOperationsResponse* response) override;
  grpc::ServerUnaryReactor* WaitOperation(grpc::CallbackServerContext* context,
                                          const v1::WaitOperationRequest* request,
                                          v1::Operation* response) override;
  grpc::ServerUnaryReactor* CancelOperation(grpc::CallbackServerContext* context,
                                            const v1::CancelOperationRequest* request,
                                            v1::Operation* response) override;

 private:
  pipeline::Operations* const operations_;
};

}  // namespace soundmap::api
