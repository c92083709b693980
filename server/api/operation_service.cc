#include "api/operation_service.h"

#include <algorithm>

#include "api/convert.h"
#include "api/paging.h"
#include "api/reactors.h"
#include "api/resource_names.h"

namespace soundmap::api {
namespace {

constexpr int kMaxWait_ms = 60'000;

}  // namespace

absl::StatusOr<pipeline::OperationInfo> OperationService::Find(
    const std::string& name, const grpc::CallbackServerContext& context, Right right) {
  const auto caller = access_->CallerOf(context);
  if (!caller.ok()) return caller.status();
  const auto id = ParseOperation(name);
  if (!id.ok()) return id.status();
  auto operation = operations_->Get(*id);
  if (!operation.ok()) return operation;
  const absl::Status allowed = access_->Check(*caller, right, operation->site);
  if (!allowed.ok()) return allowed;
  return operation;
}

grpc::ServerUnaryReactor* OperationService::GetOperation(grpc::CallbackServerContext* context,
                                                         const v1::GetOperationRequest* request,
                                                         v1::Operation* response) {
  const auto operation = Find(request->name(), *context, Right::kRead);
  if (!operation.ok()) return Finish(context, operation.status());
  *response = ToProto(*operation);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* OperationService::ListOperations(grpc::CallbackServerContext* context,
                                                           const v1::ListOperationsRequest* request,
                                                           v1::ListOperationsResponse* response) {
  const auto caller = access_->CallerOf(*context);
  if (!caller.ok()) return Finish(context, caller.status());
  std::string site;
  if (!request->site().empty()) {
    const auto name = ParseSite(request->site());
    if (!name.ok()) return Finish(context, name.status());
    site = *name;
    const absl::Status allowed = access_->Check(*caller, Right::kRead, site);
    if (!allowed.ok()) return Finish(context, allowed);
  }
  auto operations = operations_->List(site);
  std::erase_if(operations, [&](const pipeline::OperationInfo& operation) {
    return !caller->grant.Reaches(operation.site);
  });
  const auto page = PageOf(operations.size(), request->page_size(), request->page_token());
  if (!page.ok()) return Finish(context, page.status());
  for (std::size_t i = page->begin; i < page->end; ++i) {
    *response->add_operations() = ToProto(operations[i]);
  }
  response->set_next_page_token(page->next_token);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* OperationService::WaitOperation(grpc::CallbackServerContext* context,
                                                          const v1::WaitOperationRequest* request,
                                                          v1::Operation* response) {
  const auto found = Find(request->name(), *context, Right::kRead);
  if (!found.ok()) return Finish(context, found.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status waiting = operations_->Wait(
      found->id, absl::Milliseconds(std::clamp(request->timeout_ms(), 0, kMaxWait_ms)),
      [reactor, response](const pipeline::OperationInfo& operation) {
        *response = ToProto(operation);
        reactor->Finish(grpc::Status::OK);
      });
  if (!waiting.ok()) reactor->Finish(ToGrpcStatus(waiting));
  return reactor;
}

grpc::ServerUnaryReactor* OperationService::CancelOperation(
    grpc::CallbackServerContext* context, const v1::CancelOperationRequest* request,
    v1::Operation* response) {
  const AuditedFinish finish(access_, context, "cancel operation", request->name());
  const auto found = Find(request->name(), *context, Right::kWrite);
  if (!found.ok()) return finish(found.status());
  const auto operation = operations_->Cancel(found->id);
  if (!operation.ok()) return finish(operation.status());
  *response = ToProto(*operation);
  return finish(absl::OkStatus());
}

}  // namespace soundmap::api
