#include "uplink/live_link.h"

#include <Eigen/Geometry>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "recording/foxglove_messages.h"

namespace soundmap::uplink {
namespace {

using std::chrono::milliseconds;

constexpr int kMaxBeams = 180;

bool SetOdometry(const std::string& message, v1::LiveReport& report) {
  foxglove::Odometry odometry;
  if (!odometry.ParseFromString(message)) return false;
  const auto time_ns = recording::NsFromTimestamp(odometry.timestamp());
  if (!time_ns) return false;
  const auto& p = odometry.pose().position();
  const auto& q = odometry.pose().orientation();
  const double yaw_rad = std::atan2(2.0 * (q.w() * q.z() + q.x() * q.y()),
                                    1.0 - 2.0 * (q.y() * q.y() + q.z() * q.z()));
  if (!std::isfinite(p.x()) || !std::isfinite(p.y()) || !std::isfinite(yaw_rad)) return false;
  report.set_odometry_time_ns(*time_ns);
  report.mutable_odom_from_base()->set_x_m(p.x());
  report.mutable_odom_from_base()->set_y_m(p.y());
  report.mutable_odom_from_base()->set_yaw_rad(yaw_rad);
  return true;
}

void SetLaser(const std::string& message, v1::LiveReport& report) {
  foxglove::LaserScan scan;
  if (!scan.ParseFromString(message) || scan.ranges_size() < 2) return;
  const auto time_ns = recording::NsFromTimestamp(scan.timestamp());
  if (!time_ns || !std::isfinite(scan.start_angle()) || !std::isfinite(scan.end_angle())) return;
  const int step = (scan.ranges_size() + kMaxBeams - 1) / kMaxBeams;
  v1::LaserView& laser = *report.mutable_laser();
  laser.set_time_ns(*time_ns);
  laser.set_start_angle_rad(scan.start_angle());
  laser.set_angle_increment_rad(step * (scan.end_angle() - scan.start_angle()) /
                                (scan.ranges_size() - 1));
  for (int beam = 0; beam < scan.ranges_size(); beam += step) {
    const auto range_m = static_cast<float>(scan.ranges(beam));
    laser.add_range_m(std::isfinite(range_m) && range_m > 0.0f ? range_m : 0.0f);
  }
}

// One call, an operation at a time, each with a time limit.
class LiveCall {
 public:
  LiveCall(v1::LiveService::Stub& stub, grpc::ClientContext* context, milliseconds timeout)
      : context_(context), timeout_(timeout) {
    stream_ = stub.PrepareAsyncLive(context_, &queue_);
    stream_->StartCall(this);
    Await();
  }
  ~LiveCall() {
    queue_.Shutdown();
    void* tag = nullptr;
    bool ok = false;
    while (queue_.Next(&tag, &ok)) {
    }
  }
  bool Write(const v1::LiveRequest& request) {
    if (over_) return false;
    stream_->Write(request, this);
    return Await();
  }
  bool Read(v1::LiveResponse& response) {
    if (over_) return false;
    stream_->Read(&response, this);
    return Await();
  }
  grpc::Status Finish() {
    if (!over_) context_->TryCancel();
    grpc::Status status;
    stream_->Finish(&status, this);
    Await();
    return status;
  }

 private:
  bool Await() {
    void* tag = nullptr;
    bool ok = false;
    // Clocks may be set meanwhile.
    const gpr_timespec limit = gpr_time_add(gpr_now(GPR_CLOCK_MONOTONIC),
                                            gpr_time_from_millis(timeout_.count(), GPR_TIMESPAN));
    if (queue_.AsyncNext(&tag, &ok, limit) == grpc::CompletionQueue::TIMEOUT) {
      context_->TryCancel();
      queue_.Next(&tag, &ok);
      ok = false;
    }
    over_ = !ok;
    return ok;
  }

  grpc::ClientContext* const context_;
  const milliseconds timeout_;
  grpc::CompletionQueue queue_;
  std::unique_ptr<grpc::ClientAsyncReaderWriter<v1::LiveRequest, v1::LiveResponse>> stream_;
  bool over_ = false;  // an operation has failed
};

// The server's own answer, not what gRPC says of a connection that is not there.
bool IsRefusal(const grpc::Status& status) {
  switch (status.error_code()) {
    case grpc::StatusCode::OK:
    case grpc::StatusCode::UNAVAILABLE:
    case grpc::StatusCode::CANCELLED:
    case grpc::StatusCode::DEADLINE_EXCEEDED:
    case grpc::StatusCode::INTERNAL:
    case grpc::StatusCode::UNKNOWN:
      return false;
    default:
      return true;
  }
}

}  // namespace

void LiveScene::Note(const sources::SensorFrame& frame) {
  const bool is_laser = frame.sensor == sources::Sensor::kLaser;
  if (!is_laser && frame.sensor != sources::Sensor::kOdometry) return;
  std::lock_guard lock(mutex_);
  (is_laser ? laser_ : odometry_) = frame.payload;
}

v1::LiveReport LiveScene::Take() {
  std::string odometry;
  std::string laser;
  {
    std::lock_guard lock(mutex_);
    odometry = odometry_;
    laser = std::exchange(laser_, {});
  }
  v1::LiveReport report;
  if (!odometry.empty()) SetOdometry(odometry, report);
  if (!laser.empty()) SetLaser(laser, report);
  return report;
}

LiveLink::LiveLink(LiveOptions options, OpenChannel open, RobotClocks clocks,
                   std::mt19937_64 random, std::function<void(const std::string&)> say)
    : options_(std::move(options)),
      open_(std::move(open)),
      clocks_(std::move(clocks)),
      say_(std::move(say)),
      random_(random),
      thread_([this] { Run(); }) {}

LiveLink::~LiveLink() {
  {
    std::lock_guard lock(mutex_);
    stopped_ = true;
    if (context_ != nullptr) context_->TryCancel();
    stop_.notify_all();
  }
  thread_.join();
}

void LiveLink::SetDrive(v1::DriveState state, std::int64_t recorded_frames) {
  std::lock_guard lock(mutex_);
  drive_state_ = state;
  recorded_frames_ = recorded_frames;
}

void LiveLink::Run() {
  while (!Stopped(milliseconds(0))) {
    const grpc::Status status = Talk();
    if (Stopped(milliseconds(0))) return;
    if (IsRefusal(status)) {
      if (status.error_message() != said_) {
        said_ = status.error_message();
        say_(absl::StrCat("the live view: ", said_));
      }
      epoch_ = 0;
      if (Stopped(options_.hold)) return;
    }
    std::uniform_int_distribution<std::int64_t> jitter(0, options_.max_backoff.count());
    if (Stopped(milliseconds(jitter(random_)))) return;
  }
}

grpc::Status LiveLink::Talk() {
  const std::shared_ptr<grpc::Channel> channel = open_();
  const auto stub = v1::LiveService::NewStub(channel);
  grpc::ClientContext context;
  if (!options_.token.empty()) {
    context.AddMetadata("authorization", absl::StrCat("Bearer ", options_.token));
  }
  SetContext(&context);
  LiveCall call(*stub, &context, options_.answer_timeout);
  v1::LiveRequest request;
  v1::LiveResponse response;
  request.mutable_open()->set_robot(options_.robot);
  request.mutable_open()->set_session(options_.session);
  request.mutable_open()->set_epoch(epoch_);
  if (call.Write(request) && call.Read(response)) {
    epoch_ = response.welcome().epoch();
    while (true) {
      *request.mutable_report() = MakeReport();
      if (!call.Write(request) || !call.Read(response)) break;
      clock_filter_.Add({static_cast<std::int64_t>(response.answer().sent_ns()),
                         response.answer().server_receive_ns(), response.answer().server_send_ns(),
                         clocks_.monotonic_ns()});
      if (Stopped(options_.interval)) break;
    }
  }
  const grpc::Status end = call.Finish();
  SetContext(nullptr);
  return end;
}

v1::LiveReport LiveLink::MakeReport() {
  v1::LiveReport report = scene_.Take();
  {
    std::lock_guard lock(mutex_);
    report.set_drive_state(drive_state_);
    report.set_recorded_frames(recorded_frames_);
  }
  // The clock that frames have may be set at any time; it is compared anew with the other one,
  // which is read before and after it.
  const std::int64_t before_ns = clocks_.monotonic_ns();
  const std::int64_t wall_ns = clocks_.wall_ns();
  const std::int64_t after_ns = clocks_.monotonic_ns();
  const std::int64_t half_ns = (after_ns - before_ns + 1) / 2;
  if (const auto offset = clock_filter_.At(after_ns)) {
    v1::ClockOffset& clock_offset = *report.mutable_clock_offset();
    clock_offset.set_server_minus_robot_ns(offset->server_minus_robot_ns + before_ns + half_ns -
                                           wall_ns);
    clock_offset.set_uncertainty_ns(offset->uncertainty_ns + half_ns);
    clock_offset.set_drift_ppm(ClockFilter::kDrift_ppm);
  }
  report.set_sent_ns(static_cast<std::uint64_t>(clocks_.monotonic_ns()));
  return report;
}

bool LiveLink::Stopped(milliseconds time) {
  std::unique_lock lock(mutex_);
  return stop_.wait_for(lock, time, [this] { return stopped_; });
}

void LiveLink::SetContext(grpc::ClientContext* context) {
  std::lock_guard lock(mutex_);
  context_ = context;
  if (stopped_ && context != nullptr) context->TryCancel();
}

}  // namespace soundmap::uplink
