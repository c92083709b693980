#pragma once

#include <atomic>
#include <boost/asio/any_io_executor.hpp>
#include <memory>
#include <mutex>
#include <set>

#include "api/access.h"
#include "pipeline/sites.h"
#include "soundmap/v1/ingest_service.grpc.pb.h"

namespace soundmap::api {

class IngestService : public v1::IngestService::CallbackService {
 public:
  // `executor` runs what the pipeline wakes.
  IngestService(pipeline::Sites* sites, Access* access, boost::asio::any_io_executor executor);
  ~IngestService() override;

  grpc::ServerBidiReactor<v1::IngestRequest, v1::IngestResponse>* Ingest(
      grpc::CallbackServerContext* context) override;

  // Tells every robot to send no more, and ends its stream.
  void Drain();

 private:
  class Stream;

  pipeline::Sites* const sites_;
  Access* const access_;
  const boost::asio::any_io_executor executor_;
  std::mutex mutex_;
  std::set<Stream*> streams_;  // guarded by mutex_
  bool draining_ = false;      // guarded by mutex_
};

}  // namespace soundmap::api
