#pragma once

#include <string>
#include <utility>

#include "api/access.h"
#include "pipeline/operations.h"
#include "soundmap/v1/backup_service.grpc.pb.h"
#include "storage/store.h"

namespace soundmap::api {

class BackupService : public v1::BackupService::CallbackService {
 public:
  // `folder` takes the backups; empty: none are made.
  BackupService(const storage::Store* store, pipeline::Operations* operations, Access* access,
                std::string folder)
      : store_(store), operations_(operations), access_(access), folder_(std::move(folder)) {}

  grpc::ServerUnaryReactor* CreateBackup(grpc::CallbackServerContext* context,
                                         const v1::CreateBackupRequest* request,
                                         v1::Operation* response) override;

 private:
  const storage::Store* const store_;
  pipeline::Operations* const operations_;
  Access* const access_;
  const std::string folder_;
};

}  // namespace soundmap::api
