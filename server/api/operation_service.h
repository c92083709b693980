#pragma once

#include "api/access.h"
#include "pipeline/operations.h"
#include "soundmap/v1/operation_service.grpc.pb.h"

namespace soundmap::api {

class OperationService : public v1::OperationService::CallbackService {
 public:
  OperationService(pipeline::Operations* operations, Access* access)
      : operations_(operations), access_(access) {}

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
  // Unauthenticated, PermissionDenied, InvalidArgument, NotFound.
  absl::StatusOr<pipeline::OperationInfo> Find(const std::string& name,
                                               const grpc::CallbackServerContext& context,
                                               Right right);

  pipeline::Operations* const operations_;
  Access* const access_;
};

}  // namespace soundmap::api
