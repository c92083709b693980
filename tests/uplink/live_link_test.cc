#include "uplink/live_link.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

#include "recording/foxglove_messages.h"

namespace soundmap::uplink {
namespace {

using std::chrono::milliseconds;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr std::int64_t kHour_ns = 3'600'000'000'000;

sources::SensorFrame Odometry(std::int64_t stamp_ns, double x_m, double yaw_rad) {
  Eigen::Isometry3d odom_from_base = Eigen::Isometry3d::Identity();
  odom_from_base.rotate(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
  odom_from_base.translation().x() = x_m;
  return {sources::Sensor::kOdometry, stamp_ns,
          recording::MakeOdometry(stamp_ns, odom_from_base).SerializeAsString()};
}

sources::SensorFrame Laser(std::int64_t stamp_ns, const std::vector<double>& range_m) {
  return {sources::Sensor::kLaser, stamp_ns,
          recording::MakeLaserScan(stamp_ns, -1.0, 1.0, range_m).SerializeAsString()};
}

TEST(LiveScene, TheNewestOdometryAndAScanOnce) {
  LiveScene scene;
  EXPECT_FALSE(scene.Take().has_odom_from_base());
  scene.Note(Odometry(1, 1.0, 0.1));
  scene.Note(Odometry(2, 2.0, -3.0));
  scene.Note(Laser(3, {1.0, 2.0}));
  scene.Note(Laser(4, {3.0, 4.0}));
  scene.Note({sources::Sensor::kAudio, 5, "sound"});
  const v1::LiveReport first = scene.Take();
  EXPECT_EQ(first.odometry_time_ns(), 2);
  EXPECT_EQ(first.odom_from_base().x_m(), 2.0);
  EXPECT_NEAR(first.odom_from_base().yaw_rad(), -3.0, 1e-12);
  EXPECT_EQ(first.laser().time_ns(), 4);
  EXPECT_THAT(first.laser().range_m(), ElementsAre(3.0f, 4.0f));
  const v1::LiveReport second = scene.Take();
  EXPECT_EQ(second.odometry_time_ns(), 2);
  EXPECT_FALSE(second.has_laser());
}

TEST(LiveScene, ScansAreThinned) {
  for (const int beams : {2, 180, 181, 271, 1081, 40'000}) {
    std::vector<double> range_m(static_cast<std::size_t>(beams));
    for (int i = 0; i < beams; ++i) range_m[static_cast<std::size_t>(i)] = 1.0 + i;
    LiveScene scene;
    scene.Note(Laser(1, range_m));
    const v1::LiveReport report = scene.Take();
    const v1::LaserView& laser = report.laser();
    ASSERT_LE(laser.range_m_size(), 180);
    EXPECT_GE(laser.range_m_size(), std::min(beams, 90));
    for (int i = 0; i < laser.range_m_size(); ++i) {
      // The beam that stands at this angle.
      const double angle_rad = laser.start_angle_rad() + i * laser.angle_increment_rad();
      EXPECT_NEAR(laser.range_m(i), 1.0 + (angle_rad + 1.0) / 2.0 * (beams - 1), 1e-2) << beams;
    }
    EXPECT_LT(report.ByteSizeLong(), 8u << 10);
  }
}

TEST(LiveScene, WhatIsNoNumberIsNoReturn) {
  const double nan = std::nan("");
  LiveScene scene;
  scene.Note(Laser(1, {nan, -1.0, 0.0, std::numeric_limits<double>::infinity(), 1e300, 2.0}));
  scene.Note(Odometry(1, nan, 0.0));
  const v1::LiveReport report = scene.Take();
  EXPECT_THAT(report.laser().range_m(), ElementsAre(0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 2.0f));
  EXPECT_FALSE(report.has_odom_from_base());
  scene.Note({sources::Sensor::kLaser, 1, "garbage"});
  scene.Note({sources::Sensor::kOdometry, 1, "garbage"});
  EXPECT_FALSE(scene.Take().has_laser());
}

// The robot's clocks, of the test's making. The monotonic one moves by 1 us with each look.
struct FakeClocks {
  std::atomic<std::int64_t> monotonic_ns = kHour_ns;
  std::atomic<std::int64_t> wall_minus_monotonic_ns = 100 * kHour_ns;

  RobotClocks View() {
    return {[this] { return monotonic_ns += 1000; },
            [this] { return monotonic_ns + wall_minus_monotonic_ns; }};
  }
};

// A server that keeps what robots say; `act` is asked before each answer whether to give it, or
// ends the stream.
class LiveServer final : public v1::LiveService::Service {
 public:
  using Act = std::function<grpc::Status(int stream, const v1::LiveRequest&)>;

  LiveServer(FakeClocks* clocks, Act act) : clocks_(clocks), act_(std::move(act)) {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
  }
  ~LiveServer() override { server_->Shutdown(std::chrono::system_clock::now()); }

  std::string address() const { return "127.0.0.1:" + std::to_string(port_); }

  grpc::Status Live(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::LiveResponse, v1::LiveRequest>* stream) override {
    int number = 0;
    {
      std::lock_guard lock(mutex_);
      number = streams_++;
      const auto shown = context->client_metadata().find("authorization");
      if (shown != context->client_metadata().end()) {
        authorization_.assign(shown->second.data(), shown->second.size());
      }
    }
    v1::LiveRequest request;
    while (stream->Read(&request)) {
      {
        std::lock_guard lock(mutex_);
        if (request.has_open()) opens_.push_back(request.open());
        if (request.has_report()) reports_.push_back(request.report());
        changed_.notify_all();
      }
      if (grpc::Status status = act_(number, request); !status.ok()) return status;
      v1::LiveResponse response;
      if (request.has_open()) {
        response.mutable_welcome()->set_epoch(42);
      } else {
        v1::LiveAnswer& answer = *response.mutable_answer();
        answer.set_sent_ns(request.report().sent_ns());
        answer.set_server_receive_ns(clocks_->monotonic_ns + server_minus_monotonic_ns);
        answer.set_server_send_ns(clocks_->monotonic_ns + server_minus_monotonic_ns);
      }
      stream->Write(response);
    }
    return grpc::Status::OK;
  }

  // The first report, from now on, of which `what` is true.
  v1::LiveReport Await(const std::function<bool(const v1::LiveReport&)>& what) {
    std::unique_lock lock(mutex_);
    std::size_t next = reports_.size();
    while (true) {
      for (; next < reports_.size(); ++next) {
        if (what(reports_[next])) return reports_[next];
      }
      changed_.wait(lock);
    }
  }
  void AwaitOpens(std::size_t count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return opens_.size() >= count; });
  }
  // Whether so many come in this time.
  bool OpensWithin(std::size_t count, milliseconds time) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, time, [&] { return opens_.size() >= count; });
  }
  std::string authorization() {
    std::lock_guard lock(mutex_);
    return authorization_;
  }
  std::vector<v1::LiveOpen> opens() {
    std::lock_guard lock(mutex_);
    return opens_;
  }

  std::atomic<std::int64_t> server_minus_monotonic_ns = 50 * kHour_ns;

 private:
  FakeClocks* const clocks_;
  const Act act_;
  int port_ = 0;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<v1::LiveOpen> opens_;
  std::vector<v1::LiveReport> reports_;
  int streams_ = 0;
  std::string authorization_;
  std::unique_ptr<grpc::Server> server_;
};

LiveOptions Options() {
  LiveOptions options;
  options.robot = "robots/r";
  options.session = "sites/s/sessions/d";
  options.interval = milliseconds(1);
  options.answer_timeout = milliseconds(300);
  options.max_backoff = milliseconds(10);
  options.hold = milliseconds(100'000);
  return options;
}

struct Sentences {
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<std::string> all;

  std::function<void(const std::string&)> Taker() {
    return [this](const std::string& sentence) {
      std::lock_guard lock(mutex);
      all.push_back(sentence);
      changed.notify_all();
    };
  }
};

std::unique_ptr<LiveLink> Link(const LiveServer& server, FakeClocks& clocks, Sentences& said,
                               const LiveOptions& options = Options()) {
  return std::make_unique<LiveLink>(
      options,
      [address = server.address()] {
        grpc::ChannelArguments arguments;
        arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
        return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
      },
      clocks.View(), std::mt19937_64(1), said.Taker());
}

const LiveServer::Act kAnswer = [](int, const v1::LiveRequest&) { return grpc::Status::OK; };

TEST(LiveLink, ReportsWhatWasNotedLast) {
  FakeClocks clocks;
  Sentences said;
  LiveServer server(&clocks, kAnswer);
  const auto link = Link(server, clocks, said);
  server.Await([](const auto& report) { return !report.has_odom_from_base(); });
  link->Note(Odometry(7, 3.0, 0.0));
  link->SetDrive(v1::DRIVE_STATE_RECORDED, 99);
  const v1::LiveReport report =
      server.Await([](const auto& report) { return report.odometry_time_ns() == 7; });
  EXPECT_EQ(report.odom_from_base().x_m(), 3.0);
  const v1::LiveReport later =
      server.Await([](const auto& report) { return report.recorded_frames() == 99; });
  EXPECT_EQ(later.drive_state(), v1::DRIVE_STATE_RECORDED);
  ASSERT_EQ(server.opens().size(), 1u);
  EXPECT_EQ(server.opens()[0].robot(), "robots/r");
  EXPECT_EQ(server.opens()[0].session(), "sites/s/sessions/d");
  EXPECT_EQ(server.opens()[0].epoch(), 0);
}

TEST(LiveLink, TellsTheOffsetOfTheClockThatFramesHaveAndFollowsWhenOneIsSet) {
  FakeClocks clocks;
  Sentences said;
  LiveServer server(&clocks, kAnswer);
  const auto link = Link(server, clocks, said);
  const auto await = [&] {
    const std::int64_t truth_ns = server.server_minus_monotonic_ns - clocks.wall_minus_monotonic_ns;
    const auto report = server.Await([&](const v1::LiveReport& report) {
      const v1::ClockOffset& offset = report.clock_offset();
      return report.has_clock_offset() &&
             std::abs(offset.server_minus_robot_ns() - truth_ns) < kHour_ns / 2;
    });
    EXPECT_LE(std::abs(report.clock_offset().server_minus_robot_ns() - truth_ns),
              report.clock_offset().uncertainty_ns());
    EXPECT_LT(report.clock_offset().uncertainty_ns(), 1'000'000);
    EXPECT_EQ(report.clock_offset().drift_ppm(), 100.0);
  };
  await();
  for (const std::int64_t jump_ns : {kHour_ns, -2 * kHour_ns}) {
    clocks.wall_minus_monotonic_ns += jump_ns;
    await();
    server.server_minus_monotonic_ns += jump_ns / 3 * 2;
    await();
  }
}

TEST(LiveLink, ASilentServerIsGivenUpForAnotherConnection) {
  FakeClocks clocks;
  Sentences said;
  std::mutex mutex;
  std::condition_variable done;
  bool over = false;
  // The first stream hangs at its third report, as on a link that is cut without a word.
  int reports = 0;
  LiveServer server(&clocks, [&](int stream, const v1::LiveRequest& request) {
    if (stream == 0 && request.has_report() && ++reports == 3) {
      std::unique_lock lock(mutex);
      done.wait(lock, [&] { return over; });
    }
    return grpc::Status::OK;
  });
  const auto link = Link(server, clocks, said);
  server.AwaitOpens(2);
  server.Await([](const auto&) { return true; });
  EXPECT_EQ(server.opens()[1].epoch(), 42);  // the same agent
  EXPECT_TRUE(said.all.empty());
  std::lock_guard lock(mutex);
  over = true;
  done.notify_all();
}

TEST(LiveLink, AServerThatGoesIsTriedAgain) {
  FakeClocks clocks;
  Sentences said;
  LiveServer server(&clocks, [](int stream, const v1::LiveRequest& request) {
    return stream < 3 && request.has_report()
               ? grpc::Status(grpc::StatusCode::UNAVAILABLE, "the server is stopping")
               : grpc::Status::OK;
  });
  const auto link = Link(server, clocks, said);
  server.AwaitOpens(4);
  server.Await([](const auto&) { return true; });
  EXPECT_TRUE(said.all.empty());
}

TEST(LiveLink, ARefusalIsSaidOnceAndHeldTo) {
  FakeClocks clocks;
  Sentences said;
  LiveOptions options = Options();
  options.hold = milliseconds(30);
  LiveServer server(&clocks, [](int, const v1::LiveRequest& request) {
    return request.has_open() ? grpc::Status::OK
                              : grpc::Status(grpc::StatusCode::ABORTED, "newer agent");
  });
  const auto link = Link(server, clocks, said, options);
  server.AwaitOpens(3);
  // After a newer agent was heard, this one comes as a new one.
  for (const v1::LiveOpen& open : server.opens()) EXPECT_EQ(open.epoch(), 0);
  std::lock_guard lock(said.mutex);
  EXPECT_THAT(said.all, ElementsAre(HasSubstr("newer agent")));
}

TEST(LiveLink, ShowsItsTokenAndDoesNotComeAgainWhileItHolds) {
  FakeClocks clocks;
  Sentences said;
  LiveOptions options = Options();
  options.token = "secret";
  LiveServer server(&clocks, [](int, const v1::LiveRequest&) {
    return grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "no");
  });
  const auto link = Link(server, clocks, said, options);
  {
    std::unique_lock lock(said.mutex);
    said.changed.wait(lock, [&] { return !said.all.empty(); });
  }
  EXPECT_EQ(server.authorization(), "Bearer secret");
  // Ten times as long as it waits where it does not hold.
  EXPECT_FALSE(server.OpensWithin(2, 10 * options.max_backoff));
}

TEST(LiveLink, EndsWhileItConnectsWaitsOrHolds) {
  FakeClocks clocks;
  Sentences said;
  LiveOptions options = Options();
  options.answer_timeout = milliseconds(1'000'000);
  for (const bool hangs : {true, false}) {
    std::mutex mutex;
    std::condition_variable done;
    bool over = false;
    LiveServer server(&clocks, [&](int, const v1::LiveRequest&) {
      if (!hangs) return grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "no");
      std::unique_lock lock(mutex);
      done.wait(lock, [&] { return over; });
      return grpc::Status::OK;
    });
    auto link = Link(server, clocks, said, options);
    server.AwaitOpens(1);
    if (!hangs) {
      std::unique_lock lock(said.mutex);
      said.changed.wait(lock, [&] { return !said.all.empty(); });
    }
    link.reset();
    std::lock_guard lock(mutex);
    over = true;
    done.notify_all();
  }
  // Nobody listens there.
  const auto link = std::make_unique<LiveLink>(
      options,
      [] { return grpc::CreateChannel("127.0.0.1:1", grpc::InsecureChannelCredentials()); },
      clocks.View(), std::mt19937_64(1), said.Taker());
}

}  // namespace
}  // namespace soundmap::uplink
