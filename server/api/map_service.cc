#include "api/map_service.h"

#include <boost/asio/steady_timer.hpp>
#include <memory>
#include <mutex>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "api/convert.h"
#include "api/find.h"
#include "api/map_files.h"
#include "api/reactors.h"
#include "building/files.h"

namespace soundmap::api {
namespace {

constexpr std::size_t kExportChunkBytes = 256 << 10;
constexpr std::size_t kMaxImportBytes = std::size_t{1} << 30;
constexpr long kMaxImports = 2;  // at a time, with those that wait to be read
// Of an import, in the time that it has patience: 20 kbit/s with 30 s.
constexpr std::size_t kMinImportBytes = 64 << 10;

}  // namespace

grpc::ServerUnaryReactor* MapService::BuildMap(grpc::CallbackServerContext* context,
                                               const v1::BuildMapRequest* request,
                                               v1::Operation* response) {
  const AuditedFinish finish(access_, context, "build map", request->site());
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kWrite});
  if (!site.ok()) return finish(site.status());
  const std::string site_name = (*site)->record().site;
  pipeline::MapRequest map_request;
  map_request.extend = request->extend();
  auto sessions =
      ParseSessionsOf(site_name, {request->sessions().begin(), request->sessions().end()});
  if (!sessions.ok()) return finish(sessions.status());
  map_request.sessions = *std::move(sessions);
  for (const v1::SurveyedPose& proto : request->surveyed_poses()) {
    const auto pose = FromProto(proto.map_from_base());
    if (!pose.ok()) return finish(pose.status());
    map_request.surveyed_poses.push_back({proto.time_ns(), *pose});
  }
  const auto operation = operations_->Start(
      "build_map", site_name, request->request_id(),
      [site = *site, map_request](pipeline::OperationContext& operation_context) {
        return site->BuildMap(map_request, operation_context);
      });
  if (!operation.ok()) return finish(operation.status());
  *response = ToProto(*operation);
  return finish(absl::OkStatus());
}

// Collects the file, then starts the operation that reads it. A client that stalls keeps no slot.
class MapService::Import : public grpc::ServerReadReactor<v1::ImportMapRequest>,
                           public std::enable_shared_from_this<MapService::Import> {
 public:
  Import(MapService* service, grpc::CallbackServerContext* context, v1::Operation* response)
      : service_(service),
        context_(context),
        response_(response),
        stall_timer_(service->executor_) {}

  void Start() {
    alive_ = shared_from_this();
    const std::lock_guard lock(mutex_);
    auto caller = service_->access_->CallerOf(*context_);
    if (!caller.ok()) {
      End(caller.status());
      return;
    }
    caller_ = *std::move(caller);
    if (service_->imports_.use_count() > 1 + kMaxImports) {
      End(absl::ResourceExhaustedError(
          absl::StrCat(kMaxImports, " maps are being imported already")));
      return;
    }
    StartRead(&request_);
    AwaitMore();
  }

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    if (ended_) return;
    if (!ok) {
      End(StartOperation());
      return;
    }
    const absl::Status taken = Take();
    if (!taken.ok()) {
      End(taken);
      return;
    }
    StartRead(&request_);
  }
  void OnDone() override {
    {
      const std::lock_guard lock(mutex_);
      stall_timer_.cancel();
    }
    alive_.reset();  // deletes this, unless the timer still holds it
  }

 private:
  // All with mutex_ held.
  void AwaitMore() {
    stall_timer_.expires_after(service_->import_patience_);
    stall_timer_.async_wait(
        [weak = weak_from_this(), had = data_.size()](boost::system::error_code cancelled) {
          const auto self = weak.lock();
          if (cancelled || !self) return;
          const std::lock_guard lock(self->mutex_);
          if (self->ended_) return;
          if (self->data_.size() - had < kMinImportBytes) {
            self->End(absl::DeadlineExceededError(absl::StrCat(
                "the import stalls: ", self->data_.size() - had, " bytes arrived in ",
                absl::ToInt64Seconds(absl::FromChrono(self->service_->import_patience_)), " s, ",
                kMinImportBytes, " are the least")));
          } else {
            self->AwaitMore();
          }
        });
  }

  absl::Status Take() {
    if (request_.has_header()) {
      if (site_) return absl::InvalidArgumentError("the import has two headers");
      header_ = request_.header();
      auto site =
          FindSite(*service_->sites_, header_.site(), Right::kWrite, *service_->access_, caller_);
      if (!site.ok()) return site.status();
      site_ = *std::move(site);
    } else if (!site_) {
      return absl::InvalidArgumentError("the import does not begin with its header");
    }
    data_.append(request_.data());
    if (data_.size() <= kMaxImportBytes) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("the map file is larger than ", kMaxImportBytes, " bytes"));
  }

  void End(const absl::Status& status) {
    ended_ = true;
    Finish(ToGrpcStatus(service_->access_->Audit(*context_, "import map", header_.site(), status)));
  }

  absl::Status StartOperation() {
    if (!site_) return absl::InvalidArgumentError("the import has no header");
    const auto format = building::MapFormatOfPath(absl::StrCat("map.", header_.format()));
    if (!format) {
      return absl::InvalidArgumentError(
          absl::StrCat("a map of the format '", header_.format(),
                       "' cannot be imported; bt, ot, ply, pcd and yaml can"));
    }
    std::string picture;
    if (*format == building::MapFormat::kRosYaml) {
      if (header_.image_offset() < 0 ||
          header_.image_offset() > static_cast<std::int64_t>(data_.size())) {
        return absl::InvalidArgumentError("image_offset lies outside the data");
      }
      picture = data_.substr(static_cast<std::size_t>(header_.image_offset()));
      data_.resize(static_cast<std::size_t>(header_.image_offset()));
    }
    const auto operation = service_->operations_->Start(
        "import_map", site_->record().site, header_.request_id(),
        [slot = slot_, site = site_, format = *format, data = std::move(data_),
         picture = std::move(picture)](pipeline::OperationContext&) -> absl::StatusOr<std::string> {
          auto building = building::ImportBuilding(format, data, picture, site->profile().import);
          if (!building.ok()) return building.status();
          const absl::Status activated = site->ActivateBuilding(*std::move(building), {});
          if (!activated.ok()) return activated;
          return std::string("{}");
        });
    if (!operation.ok()) return operation.status();
    *response_ = ToProto(*operation);
    return absl::OkStatus();
  }

  MapService* const service_;
  std::shared_ptr<Import> alive_;

  std::mutex mutex_;
  // Guarded by mutex_.
  std::shared_ptr<const int> slot_ = service_->imports_;
  grpc::CallbackServerContext* const context_;
  v1::Operation* const response_;
  Caller caller_;
  v1::ImportMapRequest request_;
  v1::ImportMapHeader header_;
  std::shared_ptr<pipeline::Site> site_;  // of the header
  std::string data_;
  bool ended_ = false;
  boost::asio::steady_timer stall_timer_;
};

grpc::ServerReadReactor<v1::ImportMapRequest>* MapService::ImportMap(
    grpc::CallbackServerContext* context, v1::Operation* response) {
  const auto import = std::make_shared<Import>(this, context, response);
  import->Start();
  return import.get();
}

grpc::ServerWriteReactor<v1::ExportMapResponse>* MapService::ExportMap(
    grpc::CallbackServerContext* context, const v1::ExportMapRequest* request) {
  using Reactor = StreamReactor<v1::ExportMapResponse>;
  const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kRead});
  if (!site.ok()) return new Reactor(site.status());
  auto files = ExportMapFiles(**site, *request);
  if (!files.ok()) return new Reactor(files.status());
  return new Reactor([files = *std::move(files), file = std::size_t{0}, sent = std::size_t{0}](
                         v1::ExportMapResponse& response) mutable -> absl::StatusOr<bool> {
    if (file == files.files.size()) return false;
    const ExportFile& from = files.files[file];
    response.set_revision(files.revision);
    response.set_as_of_ns(files.as_of_ns);
    if (sent == 0) response.set_file_suffix(from.suffix);
    response.set_data(from.bytes.substr(sent, kExportChunkBytes));
    sent += response.data().size();
    if (sent >= from.bytes.size()) {
      ++file;
      sent = 0;
    }
    return true;
  });
}

}  // namespace soundmap::api
