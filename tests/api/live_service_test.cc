#include "api/live_service.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
#include <cmath>
#include <filesystem>
#include <limits>
#include <thread>

#include "api/convert.h"
#include "api/decode_message.h"
#include "api/watch_service.h"
#include "google/rpc/status_details.pb.h"

namespace soundmap::api {
namespace {

using ::testing::HasSubstr;

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kHour_ns = 3600 * kSecond_ns;

v1::LiveReport Report(double x_m) {
  v1::LiveReport report;
  report.set_sent_ns(12345);
  report.set_drive_state(v1::DRIVE_STATE_RECORDING);
  report.set_recorded_frames(17);
  report.set_odometry_time_ns(7 * kSecond_ns);
  report.mutable_odom_from_base()->set_x_m(x_m);
  return report;
}

v1::LiveReport WithOffset(std::int64_t offset_ns, std::int64_t uncertainty_ns) {
  v1::LiveReport report = Report(1.0);
  report.mutable_clock_offset()->set_server_minus_robot_ns(offset_ns);
  report.mutable_clock_offset()->set_uncertainty_ns(uncertainty_ns);
  report.mutable_clock_offset()->set_drift_ppm(100.0);
  return report;
}

// A robot's stream, a message and its answer at a time.
class Call {
 public:
  explicit Call(v1::LiveService::Stub& stub) {
    context_.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(30));
    stream_ = stub.Live(&context_);
  }
  // None: the stream has ended.
  std::optional<v1::LiveResponse> Ask(const v1::LiveRequest& request) {
    v1::LiveResponse response;
    if (!stream_->Write(request) || !stream_->Read(&response)) return std::nullopt;
    return response;
  }
  std::int64_t Open(std::int64_t epoch = 0, const std::string& robot = "r",
                    const std::string& session = "sites/hall/sessions/d") {
    v1::LiveRequest request;
    request.mutable_open()->set_robot("robots/" + robot);
    request.mutable_open()->set_session(session);
    request.mutable_open()->set_epoch(epoch);
    const auto response = Ask(request);
    return response ? response->welcome().epoch() : -1;
  }
  std::optional<v1::LiveAnswer> Send(const v1::LiveReport& report) {
    v1::LiveRequest request;
    *request.mutable_report() = report;
    const auto response = Ask(request);
    if (!response) return std::nullopt;
    return response->answer();
  }
  grpc::Status End() {
    v1::LiveResponse response;
    while (stream_->Read(&response)) {
    }
    return stream_->Finish();
  }
  grpc::Status Close() {
    stream_->WritesDone();
    return End();
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::LiveRequest, v1::LiveResponse>> stream_;
};

class LiveServiceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) /
              ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::remove_all(folder_);
    Start();
    site_ = sites_->Create("hall", "", "").value();
    request_.session = "d";
    request_.robot = "r";
    request_.purpose = pipeline::Purpose::kMapping;
  }
  void TearDown() override {
    Stop();
    std::filesystem::remove_all(folder_);
  }

  void Start() {
    store_ = storage::Store::Open(folder_.string()).value();
    const auto now_ns = [this] { return now_ns_.load(); };
    sites_ = pipeline::Sites::Open(store_.get(), {pool_.get_executor(), DecodeMessage,
                                                  pipeline::ProfileByName, now_ns})
                 .value();
    access_ = Access::Create({}, now_ns).value();
    live_ = std::make_unique<LiveService>(sites_.get(), access_.get(), pool_.get_executor(), now_ns,
                                          silence_);
    watches_ =
        std::make_unique<WatchService>(sites_.get(), access_.get(), pool_.get_executor(), "test");
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(live_.get());
    builder.RegisterService(watches_.get());
    server_ = builder.BuildAndStart();
    const auto channel = grpc::CreateChannel("127.0.0.1:" + std::to_string(port),
                                             grpc::InsecureChannelCredentials());
    stub_ = v1::LiveService::NewStub(channel);
    watch_stub_ = v1::WatchService::NewStub(channel);
  }
  void Stop() {
    server_->Shutdown(std::chrono::system_clock::now());
    server_->Wait();
    server_.reset();
    site_.reset();
    sites_.reset();
    store_.reset();
  }

  v1::Robot Robot() const {
    for (const pipeline::RobotInfo& robot : site_->Robots()) {
      if (robot.robot == "r") return ToProto(robot);
    }
    return {};
  }

  std::filesystem::path folder_;
  std::chrono::milliseconds silence_ = std::chrono::seconds(30);
  std::atomic<std::int64_t> now_ns_ = 500'000 * kHour_ns;
  boost::asio::thread_pool pool_{2};
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<pipeline::Sites> sites_;
  std::unique_ptr<Access> access_;
  std::unique_ptr<LiveService> live_;
  std::unique_ptr<WatchService> watches_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<v1::LiveService::Stub> stub_;
  std::unique_ptr<v1::WatchService::Stub> watch_stub_;
  std::shared_ptr<pipeline::Site> site_;
  pipeline::SessionRequest request_;
};

TEST_F(LiveServiceTest, ShowsARobotWhoseSessionIsNotHereYet) {
  Call call(*stub_);
  EXPECT_GT(call.Open(), 0);
  v1::LiveReport report = Report(2.0);
  report.mutable_laser()->set_angle_increment_rad(0.5);
  report.mutable_laser()->add_range_m(3.0f);
  const auto answer = call.Send(report);
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->sent_ns(), 12345u);
  EXPECT_EQ(answer->server_receive_ns(), now_ns_);
  EXPECT_EQ(answer->server_send_ns(), now_ns_);
  v1::Robot robot = Robot();
  EXPECT_EQ(robot.name(), "robots/r");
  EXPECT_EQ(robot.site(), "sites/hall");
  EXPECT_EQ(robot.session(), "");
  EXPECT_EQ(robot.live().session(), "sites/hall/sessions/d");
  EXPECT_EQ(robot.live().drive_state(), v1::DRIVE_STATE_RECORDING);
  EXPECT_EQ(robot.live().recorded_frames(), 17);
  EXPECT_EQ(robot.live().odometry_time_ns(), 7 * kSecond_ns);
  EXPECT_EQ(robot.live().odom_from_base().x_m(), 2.0);
  EXPECT_FALSE(robot.live().has_map_from_base());
  EXPECT_EQ(robot.live().laser().range_m(0), 3.0f);
  EXPECT_GE(robot.live().age_ns(), 0);
  ASSERT_TRUE(call.Send(Report(4.0)));
  robot = Robot();
  EXPECT_EQ(robot.live().odom_from_base().x_m(), 4.0);
  EXPECT_EQ(robot.live().laser().range_m(0), 3.0f);  // the newest there was
  EXPECT_EQ(sites_->meters().live_streams, 1);
  EXPECT_TRUE(call.Close().ok());
  // OnDone() may run after the client has its status.
  while (sites_->meters().live_streams != 0) std::this_thread::yield();
  EXPECT_EQ(Robot().name(), "");  // it has never had a session
}

TEST_F(LiveServiceTest, WatchersSeeItComeMoveAndGo) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(30));
  v1::WatchRequest request;
  request.set_site("sites/hall");
  request.set_robots(true);
  const auto watch = watch_stub_->Watch(&context, request);
  // The next of `robots/r`; what comes twice is passed over.
  const auto next = [&](const std::function<bool(const v1::LiveRobot&)>& what) {
    v1::WatchEvent event;
    while (watch->Read(&event)) {
      if (event.has_live_robot() && what(event.live_robot())) return true;
    }
    return false;
  };
  Call call(*stub_);
  call.Open();
  call.Send(Report(1.0));
  EXPECT_TRUE(next([](const auto& robot) {
    return robot.robot() == "robots/r" && robot.live().odom_from_base().x_m() == 1.0;
  }));
  call.Send(WithOffset(5, 6));
  EXPECT_TRUE(
      next([](const auto& robot) { return robot.clock_offset().server_minus_robot_ns() == 5; }));
  call.Close();
  EXPECT_TRUE(next([](const auto& robot) { return !robot.has_live(); }));
  context.TryCancel();
}

TEST_F(LiveServiceTest, TheOffsetOfTheClockIsKeptWithTheSession) {
  ASSERT_TRUE(site_->CreateSession(request_, 1).ok());
  const auto offsets = [this] { return (*site_->GetSession("d"))->record().clock_offsets; };
  const std::vector<pipeline::ClockOffset> kept = {
      {3 * kSecond_ns, kSecond_ns / 100, now_ns_ + kSecond_ns, 100.0},
      {3 * kSecond_ns + kHour_ns, kSecond_ns / 100, now_ns_ + 3 * kSecond_ns, 100.0}};
  {
    Call call(*stub_);
    call.Open();
    ASSERT_TRUE(call.Send(WithOffset(3 * kSecond_ns, kSecond_ns / 50)));
    now_ns_ += kSecond_ns;
    ASSERT_TRUE(call.Send(WithOffset(3 * kSecond_ns, kSecond_ns / 100)));
    EXPECT_EQ(offsets(), std::vector{kept[0]});
    // The robot's clock is set.
    now_ns_ += 2 * kSecond_ns;
    ASSERT_TRUE(call.Send(WithOffset(3 * kSecond_ns + kHour_ns, kSecond_ns / 100)));
    EXPECT_EQ(offsets(), kept);
    EXPECT_TRUE(call.Close().ok());
  }
  EXPECT_EQ(Robot().clock_offset().server_minus_robot_ns(), 3 * kSecond_ns + kHour_ns);
  Stop();
  Start();
  site_ = sites_->Get("hall").value();
  EXPECT_EQ(offsets(), kept);
  EXPECT_EQ(Robot().clock_offset().server_minus_robot_ns(), 3 * kSecond_ns + kHour_ns);
  EXPECT_FALSE(Robot().has_live());
}

TEST_F(LiveServiceTest, AnAgentOfAnOldEpochIsFencedOff) {
  Call old(*stub_);
  const std::int64_t old_epoch = old.Open();
  ASSERT_TRUE(old.Send(Report(1.0)));
  Call young(*stub_);
  EXPECT_GT(young.Open(), old_epoch);
  ASSERT_TRUE(young.Send(Report(2.0)));
  EXPECT_FALSE(old.Send(Report(1.0)));
  EXPECT_EQ(old.End().error_code(), grpc::StatusCode::ABORTED);
  Call again(*stub_);
  EXPECT_EQ(again.Open(old_epoch), -1);
  EXPECT_EQ(again.End().error_code(), grpc::StatusCode::ABORTED);
  EXPECT_EQ(Robot().live().odom_from_base().x_m(), 2.0);
  ASSERT_TRUE(young.Send(Report(3.0)));
  EXPECT_EQ(Robot().live().odom_from_base().x_m(), 3.0);
}

TEST_F(LiveServiceTest, WhatIsNoReportIsRefusedAndShowsNothing) {
  const auto refused = [&](const v1::LiveReport& report, const std::string& says) {
    Call call(*stub_);
    call.Open();
    EXPECT_FALSE(call.Send(report)) << says;
    const grpc::Status end = call.End();
    EXPECT_EQ(end.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << says;
    EXPECT_THAT(end.error_message(), HasSubstr(says));
    EXPECT_FALSE(Robot().has_live());
  };
  const double nan = std::nan("");
  refused(Report(nan), "not finite");
  refused(Report(std::numeric_limits<double>::infinity()), "not finite");
  refused(Report(1e9), "odometry is out of range");
  v1::LiveReport report = Report(1.0);
  report.set_odometry_time_ns(-1);
  refused(report, "time of the odometry");
  report = Report(1.0);
  report.set_recorded_frames(-1);
  refused(report, "count of frames");
  report = Report(1.0);
  for (int i = 0; i < 181; ++i) report.mutable_laser()->add_range_m(1.0f);
  refused(report, "181 beams");
  report = Report(1.0);
  report.mutable_laser()->add_range_m(static_cast<float>(nan));
  refused(report, "laser");
  report = Report(1.0);
  report.mutable_laser()->set_angle_increment_rad(nan);
  refused(report, "laser");
  report = Report(1.0);
  for (int i = 0; i < 100'000; ++i) report.mutable_laser()->add_range_m(1.0f);
  refused(report, "8192 are the limit");
  refused(WithOffset(0, -1), "clock offset");
  refused(WithOffset(std::numeric_limits<std::int64_t>::min(), 1), "clock offset");
  refused(WithOffset(0, std::numeric_limits<std::int64_t>::max()), "clock offset");
  report = WithOffset(0, 1);
  report.mutable_clock_offset()->set_drift_ppm(nan);
  refused(report, "clock offset");
}

TEST_F(LiveServiceTest, WhatIsOutOfOrderIsRefused) {
  const auto end_of = [&](const std::function<void(Call&)>& deed) {
    Call call(*stub_);
    deed(call);
    return call.End().error_code();
  };
  using enum grpc::StatusCode;
  EXPECT_EQ(end_of([](Call& call) { call.Send(Report(1.0)); }), FAILED_PRECONDITION);
  EXPECT_EQ(end_of([](Call& call) { call.Ask({}); }), INVALID_ARGUMENT);
  EXPECT_EQ(end_of([](Call& call) {
              call.Open();
              call.Open();
            }),
            FAILED_PRECONDITION);
  EXPECT_EQ(end_of([](Call& call) { call.Open(0, "../r"); }), INVALID_ARGUMENT);
  EXPECT_EQ(end_of([](Call& call) { call.Open(0, "r", "d"); }), INVALID_ARGUMENT);
  EXPECT_EQ(end_of([](Call& call) { call.Open(0, "r", "sites/hall/sessions/D"); }),
            INVALID_ARGUMENT);
  EXPECT_EQ(end_of([](Call& call) { call.Open(0, "r", "sites/elsewhere/sessions/d"); }), NOT_FOUND);
  // The session of another robot.
  ASSERT_TRUE(site_->CreateSession(request_, 1).ok());
  EXPECT_EQ(end_of([](Call& call) {
              call.Open(0, "r2");
              call.Send(WithOffset(1, 1));
            }),
            INVALID_ARGUMENT);
  EXPECT_TRUE((*site_->GetSession("d"))->record().clock_offsets.empty());
}

TEST_F(LiveServiceTest, ARobotThatFloodsIsEndedWithATimeToTryAgain) {
  Call call(*stub_);
  call.Open();
  int answered = 0;
  while (call.Send(Report(answered))) ++answered;
  EXPECT_EQ(answered, 40);  // two seconds' worth at once
  const grpc::Status end = call.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  google::rpc::Status details;
  ASSERT_TRUE(details.ParseFromString(end.error_details()));
  google::rpc::RetryInfo retry;
  bool has_retry = false;
  for (const auto& detail : details.details()) has_retry |= detail.UnpackTo(&retry);
  EXPECT_TRUE(has_retry);
  // Nor on another stream; others are not held up, nor is it later.
  Call again(*stub_);
  again.Open();
  EXPECT_FALSE(again.Send(Report(1.0)));
  Call other(*stub_);
  other.Open(0, "r2");
  EXPECT_TRUE(other.Send(Report(1.0)));
  now_ns_ += kSecond_ns;
  Call later(*stub_);
  later.Open();
  EXPECT_TRUE(later.Send(Report(1.0)));
}

TEST_F(LiveServiceTest, ASilentRobotIsLiveNoMore) {
  Stop();
  silence_ = std::chrono::milliseconds(200);
  Start();
  site_ = sites_->Get("hall").value();
  Call call(*stub_);
  call.Open();
  call.Send(Report(1.0));
  EXPECT_EQ(call.End().error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  while (sites_->meters().live_streams != 0) std::this_thread::yield();
  EXPECT_FALSE(Robot().has_live());
}

TEST_F(LiveServiceTest, AStoppingServerEndsTheStreams) {
  Call call(*stub_);
  call.Open();
  EXPECT_TRUE(call.Send(Report(1.0)));
  live_->Drain();
  EXPECT_FALSE(call.Send(Report(1.0)));
  EXPECT_EQ(call.End().error_code(), grpc::StatusCode::UNAVAILABLE);
}

}  // namespace
}  // namespace soundmap::api
