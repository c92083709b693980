#include "api/backup_service.h"

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "api/convert.h"
#include "api/reactors.h"
#include "storage/backup.h"
#include "storage/names.h"

namespace soundmap::api {

grpc::ServerUnaryReactor* BackupService::CreateBackup(grpc::CallbackServerContext* context,
                                                      const v1::CreateBackupRequest* request,
                                                      v1::Operation* response) {
  const AuditedFinish finish(access_, context, "create backup", request->backup_id());
  const auto caller = access_->Check(*context, Right::kAdmin, /*site=*/"");
  if (!caller.ok()) return finish(caller.status());
  const absl::Status valid = storage::ValidateName("backup", request->backup_id());
  if (!valid.ok()) return finish(valid);
  if (folder_.empty()) {
    return finish(absl::FailedPreconditionError(
        "the server has no folder for backups: it was started without --backup-dir"));
  }
  const std::string folder = absl::StrCat(folder_, "/", request->backup_id());
  const auto operation = operations_->Start(
      "backup", /*site=*/"", request->request_id(),
      [store = store_, folder](pipeline::OperationContext& work) -> absl::StatusOr<std::string> {
        const auto size = storage::BackUp(*store, folder, [&work](double share) {
          work.Report(share, "copying");
          return !work.cancelled();
        });
        if (!size.ok()) return size.status();
        return nlohmann::ordered_json{
            {"folder", folder}, {"files", size->files}, {"bytes", size->bytes}}
            .dump();
      });
  if (!operation.ok()) return finish(operation.status());
  *response = ToProto(*operation);
  return finish(absl::OkStatus());
}

}  // namespace soundmap::api
