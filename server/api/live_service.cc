#include "api/live_service.h"

#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "api/convert.h"
#include "api/find.h"
#include "api/status.h"
#include "storage/names.h"

namespace soundmap::api {
namespace {

constexpr std::size_t kMaxRequestBytes = 8 << 10;
constexpr double kReportsPerSecond = 20.0;

}  // namespace

// One robot's stream: a report is read, its answer written, then the next one is read.
class LiveService::Stream : public grpc::ServerBidiReactor<v1::LiveRequest, v1::LiveResponse>,
                            public std::enable_shared_from_this<LiveService::Stream> {
 public:
  Stream(LiveService* service, Caller caller)
      : service_(service), caller_(std::move(caller)), watchdog_(service->executor_) {
    ++service_->sites_->meters().live_streams;
  }

  void Start() {
    alive_ = shared_from_this();
    Read();
  }

  void OnReadDone(bool ok) override {
    const std::int64_t received_ns = service_->now_ns_();
    const absl::Status handled = ok ? Handle(received_ns) : absl::OkStatus();
    std::lock_guard lock(mutex_);
    if (!ok || !handled.ok() || end_status_) {
      End(handled);
      return;
    }
    if (response_.has_answer()) response_.mutable_answer()->set_server_send_ns(service_->now_ns_());
    writing_ = true;
    StartWrite(&response_);
  }

  void OnWriteDone(bool ok) override {
    {
      std::lock_guard lock(mutex_);
      writing_ = false;
      if (!ok) End(absl::CancelledError("the robot is gone"));
      if (end_status_) {
        FinishOnce();
        return;
      }
    }
    Read();
  }

  void OnCancel() override {
    std::lock_guard lock(mutex_);
    End(absl::CancelledError("the robot is gone"));
  }

  void OnDone() override {
    if (lease_) site_->live().Close(robot_, *lease_);
    --service_->sites_->meters().live_streams;
    {
      std::lock_guard lock(mutex_);
      watchdog_.cancel();
    }
    alive_.reset();  // deletes this, unless the watchdog still holds it
  }

 private:
  void Read() {
    {
      std::lock_guard lock(mutex_);
      watchdog_.expires_after(service_->silence_);
      watchdog_.async_wait([weak = weak_from_this()](boost::system::error_code cancelled) {
        const auto self = weak.lock();
        if (cancelled || !self) return;
        std::lock_guard lock(self->mutex_);
        self->End(absl::DeadlineExceededError("the robot has said nothing for too long"));
      });
    }
    StartRead(&request_);
  }

  // Makes the response.
  absl::Status Handle(std::int64_t received_ns) {
    if (service_->draining_) return absl::UnavailableError("the server is stopping");
    const absl::Status known = service_->access_->Recheck(caller_);
    if (!known.ok()) return known;
    const std::size_t bytes = request_.ByteSizeLong();
    if (bytes > kMaxRequestBytes) {
      return absl::InvalidArgumentError(absl::StrCat("the live report has ", bytes, " bytes; ",
                                                     kMaxRequestBytes, " are the limit"));
    }
    response_.Clear();
    if (request_.has_open()) return HandleOpen(request_.open(), received_ns);
    if (request_.has_report()) return HandleReport(request_.report(), received_ns);
    return absl::InvalidArgumentError("a live message is empty");
  }

  absl::Status HandleOpen(const v1::LiveOpen& open, std::int64_t now_ns) {
    if (lease_) return absl::FailedPreconditionError("`open` came twice");
    const auto robot = ParseRobot(open.robot());
    if (!robot.ok()) return robot.status();
    const auto session = ParseSession(open.session());
    if (!session.ok()) return session.status();
    absl::Status valid = storage::ValidateName("robot", *robot);
    if (valid.ok()) valid = storage::ValidateName("session", session->session);
    if (!valid.ok()) return valid;
    const absl::Status allowed =
        service_->access_->Check(caller_, Right::kStream, session->site, *robot);
    if (!allowed.ok()) return allowed;
    auto site = service_->sites_->Get(session->site);
    if (!site.ok()) return site.status();
    const auto lease = (*site)->live().Open(*robot, open.epoch(), now_ns);
    if (!lease.ok()) return lease.status();
    site_ = *std::move(site);
    robot_ = *robot;
    session_ = session->session;
    who_ = absl::StrCat(session->site, "/", robot_);
    lease_ = *lease;
    response_.mutable_welcome()->set_epoch(lease->epoch);
    return absl::OkStatus();
  }

  absl::Status HandleReport(const v1::LiveReport& proto, std::int64_t now_ns) {
    if (!lease_) return absl::FailedPreconditionError("the first message must be `open`");
    if (!service_->reports_.Take(who_, now_ns)) {
      return absl::ResourceExhaustedError(absl::StrCat("robot '", robot_, "' reports too often"));
    }
    auto report = FromProto(proto, now_ns);
    if (!report.ok()) return report.status();
    response_.mutable_answer()->set_sent_ns(proto.sent_ns());
    response_.mutable_answer()->set_server_receive_ns(now_ns);
    return site_->TakeLiveReport(robot_, session_, *lease_, *std::move(report));
  }

  // With mutex_ held. The first status counts; a write that is under way ends first.
  void End(const absl::Status& status) {
    if (!end_status_) end_status_ = status;
    if (!writing_) FinishOnce();
  }
  void FinishOnce() {
    if (std::exchange(finished_, true)) return;
    Finish(ToGrpcStatus(*end_status_));
  }

  LiveService* const service_;
  const Caller caller_;
  std::shared_ptr<Stream> alive_;
  v1::LiveRequest request_;
  v1::LiveResponse response_;  // the reading side's own until it is written

  // Set by `open`.
  std::shared_ptr<pipeline::Site> site_;
  std::string robot_;
  std::string session_;
  std::string who_;
  std::optional<pipeline::LiveRobots::Lease> lease_;

  std::mutex mutex_;
  // Guarded by mutex_.
  bool writing_ = false;
  bool finished_ = false;
  std::optional<absl::Status> end_status_;
  boost::asio::steady_timer watchdog_;
};

LiveService::LiveService(pipeline::Sites* sites, Access* access,
                         boost::asio::any_io_executor executor,
                         std::function<std::int64_t()> now_ns, std::chrono::milliseconds silence)
    : sites_(sites),
      access_(access),
      executor_(std::move(executor)),
      now_ns_(std::move(now_ns)),
      silence_(silence),
      reports_(kReportsPerSecond) {}

grpc::ServerBidiReactor<v1::LiveRequest, v1::LiveResponse>* LiveService::Live(
    grpc::CallbackServerContext* context) {
  auto caller = access_->CallerOf(*context);
  if (!caller.ok()) {
    class Refusal : public grpc::ServerBidiReactor<v1::LiveRequest, v1::LiveResponse> {
     public:
      explicit Refusal(const absl::Status& status) { Finish(ToGrpcStatus(status)); }
      void OnDone() override { delete this; }
    };
    return new Refusal(caller.status());
  }
  auto stream = std::make_shared<Stream>(this, *std::move(caller));
  stream->Start();
  return stream.get();
}

}  // namespace soundmap::api
