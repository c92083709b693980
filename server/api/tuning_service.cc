#include "api/tuning_service.h"

#include "api/convert.h"
#include "api/find.h"
#include "api/reactors.h"

namespace soundmap::api {

grpc::ServerUnaryReactor* TuningService::TryParameters(grpc::CallbackServerContext* context,
                                                       const v1::TryParametersRequest* request,
                                                       v1::Operation* response) {
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kWrite});
  if (!site.ok()) return Finish(context, site.status());
  const std::string site_name = (*site)->record().site;
  auto sessions =
      ParseSessionsOf(site_name, {request->sessions().begin(), request->sessions().end()});
  if (!sessions.ok()) return Finish(context, sessions.status());
  const pipeline::TrialRequest trial{
      *std::move(sessions), {request->parameters_toml().begin(), request->parameters_toml().end()}};
  const auto operation =
      operations_->Start("try_parameters", site_name, request->request_id(),
                         [site = *site, trial](pipeline::OperationContext& operation_context) {
                           return site->TryParameters(trial, operation_context);
                         });
  if (!operation.ok()) return Finish(context, operation.status());
  *response = ToProto(*operation);
  return Finish(context, absl::OkStatus());
}

}  // namespace soundmap::api
