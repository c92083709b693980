#include "uplink/uploader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include "recording/foxglove_messages.h"
#include "recording/frame_coding.h"
#include "tests/uplink/scripted_server.h"
#include "uplink/channel.h"
#include "uplink/chunk_builder.h"

namespace soundmap::uplink {
namespace {

using sources::Sensor;
using sources::SensorFrame;
using std::chrono::milliseconds;
using testing::AllOf;
using testing::ElementsAreArray;
using testing::HasSubstr;
using testing::IsEmpty;

class MemorySource : public sources::FrameSource {
 public:
  explicit MemorySource(std::vector<SensorFrame> frames) : frames_(std::move(frames)) {}
  absl::Status Seek(std::int64_t offset) override {
    if (offset > static_cast<std::int64_t>(frames_.size())) return absl::OutOfRangeError("far");
    next_ = static_cast<std::size_t>(offset);
    return absl::OkStatus();
  }
  absl::StatusOr<std::optional<SensorFrame>> Next() override {
    if (next_ == frames_.size()) return std::nullopt;
    return frames_[next_++];
  }

 private:
  std::vector<SensorFrame> frames_;
  std::size_t next_ = 0;
};

// Many small frames, some of them empty, and a few larger than a chunk.
std::vector<SensorFrame> SomeFrames(int count) {
  std::mt19937 random(11);
  std::vector<SensorFrame> frames;
  for (int i = 0; i < count; ++i) {
    std::size_t bytes = random() % 5000;
    if (i % 50 == 7) bytes = 0;
    if (i % 100 == 33) bytes = 200'000 + random() % 900'000;
    if (i == 20) bytes = 2 * (256 << 10);  // whole parts
    SensorFrame frame;
    frame.sensor = static_cast<Sensor>(random() % 4);
    frame.log_time_ns = 1'000'000'000 + 1'000'000ll * i;
    for (std::size_t b = 0; b < bytes; ++b) frame.payload.push_back(static_cast<char>(random()));
    frames.push_back(frame);
  }
  return frames;
}

std::vector<ReceivedFrame> AsReceived(const std::vector<SensorFrame>& frames) {
  std::vector<ReceivedFrame> received;
  for (const SensorFrame& frame : frames) {
    const v1::Sensor sensor = frame.sensor == Sensor::kAudio   ? v1::SENSOR_AUDIO
                              : frame.sensor == Sensor::kLidar ? v1::SENSOR_LIDAR
                              : frame.sensor == Sensor::kLaser ? v1::SENSOR_LASER
                                                               : v1::SENSOR_ODOMETRY;
    received.push_back({sensor, frame.log_time_ns, frame.payload});
  }
  return received;
}

UploadOptions Options() {
  UploadOptions options;
  options.server = "the test";
  options.session.set_site("sites/s");
  options.session.set_robot("robots/r");
  options.session.set_session_id("r-1");
  options.give_up_after = milliseconds(20'000);
  options.first_backoff = milliseconds(5);
  options.max_backoff = milliseconds(20);
  return options;
}

absl::StatusOr<UploadResult> Upload(const std::string& address, const UploadOptions& options,
                                    const std::vector<SensorFrame>& frames,
                                    UploadProgress* last = nullptr) {
  auto channel = OpenChannel({.address = address, .token = options.token}).value();
  Uploader uploader(channel, options, &std::chrono::steady_clock::now, std::mt19937_64(3));
  MemorySource source(frames);
  return uploader.Upload(source, [last](const UploadProgress& progress) {
    if (last != nullptr) *last = progress;
  });
}

TEST(Crc32c, HasItsCheckValue) {
  EXPECT_EQ(ExtendCrc32c(0, "123456789"), 0xe3069283u);
  EXPECT_EQ(ExtendCrc32c(ExtendCrc32c(0, "1234"), "56789"), 0xe3069283u);
  EXPECT_EQ(ExtendCrc32c(0, ""), 0u);
}

TEST(Uploader, BringsEveryFrameWithinTheCredit) {
  const std::vector<SensorFrame> frames = SomeFrames(400);
  for (const std::int64_t credit_bytes : {256 << 10, 300'000, 8 << 20}) {
    ScriptedServer server(credit_bytes, {{}});
    server.Start();
    UploadProgress last;
    UploadOptions options = Options();
    options.token = "secret";
    const auto result = Upload(server.address(), options, frames, &last);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->frame_count, 400);
    EXPECT_EQ(result->sent_count, 400);
    EXPECT_EQ(result->session, "sites/s/sessions/r-1");
    EXPECT_EQ(last.next_offset, 400);
    EXPECT_EQ(last.watermarks.processed, 400);
    EXPECT_EQ(server.authorization(), "Bearer secret");
    EXPECT_THAT(server.complaints(), IsEmpty());
    EXPECT_TRUE(server.frames() == AsReceived(frames));

    // Again: the server has everything.
    const auto again = Upload(server.address(), options, frames);
    ASSERT_TRUE(again.ok()) << again.status();
    EXPECT_EQ(again->frame_count, 400);
    EXPECT_EQ(again->sent_count, 0);
    EXPECT_THAT(server.complaints(), IsEmpty());
  }
}

// Audio of several sizes, that of silence far beyond a chunk; points; noise that no coding
// shortens.
std::vector<SensorFrame> CodableFrames() {
  std::mt19937 random(2);
  std::vector<SensorFrame> frames;
  for (int i = 0; i < 60; ++i) {
    SensorFrame frame;
    frame.log_time_ns = 1'000'000'000 + 1'000'000ll * i;
    const int samples = i % 20 == 3 ? 60'000 : 100 * i;
    std::vector<std::int16_t> audio(static_cast<std::size_t>(16 * samples));
    if (i % 20 != 3) {
      for (auto& sample : audio) sample = static_cast<std::int16_t>(random() % 500);
    }
    frame.payload = recording::MakeRawAudio(1'000'000, 16'000, 16, audio).SerializeAsString();
    if (i % 3 == 1) {
      std::vector<Eigen::Vector3f> points(static_cast<std::size_t>(i * 200));
      for (auto& point : points) point = 0.001f * Eigen::Vector3f(random() % 99, 2000, 50);
      frame.sensor = Sensor::kLidar;
      frame.payload = recording::SnapFrame(
          "foxglove.PointCloud", recording::MakePointCloud(1, points).SerializeAsString(), 0.001);
    }
    if (i % 20 == 17) {
      for (char& byte : frame.payload) byte = static_cast<char>(random());
    }
    frames.push_back(frame);
  }
  return frames;
}

TEST(Uploader, CodesWhatTheServerDecodes) {
  const std::vector<SensorFrame> frames = CodableFrames();
  UploadOptions options = Options();
  options.lidar_resolution_m = 0.001;
  for (const std::int64_t credit_bytes : {256 << 10, 8 << 20}) {
    // The second connection, to which an older server has come back, has fewer codings.
    ScriptedServer server(
        credit_bytes,
        {{.fail_at_offset = 30, .codings = {v1::CODING_FLAC, v1::CODING_POINTS, v1::CODING_ZSTD}},
         {.fail_at_offset = 45, .codings = {v1::CODING_FLAC}},
         {}});
    server.Start();
    const auto result = Upload(server.address(), options, frames);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_THAT(server.complaints(), IsEmpty());
    EXPECT_TRUE(server.frames() == AsReceived(frames));
    EXPECT_LT(result->payload_bytes, result->message_bytes * 3 / 4);
    EXPECT_GE(result->payload_bytes, server.payload_bytes());  // some was lost on its way
  }
  options.coded = false;
  ScriptedServer server(8 << 20, {{.codings = {v1::CODING_FLAC}}});
  server.Start();
  const auto result = Upload(server.address(), options, frames);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->payload_bytes, result->message_bytes);
  EXPECT_TRUE(server.frames() == AsReceived(frames));
}

TEST(Uploader, GoesOnAfterLostConnectionsDrainAndRewind) {
  const std::vector<SensorFrame> frames = SomeFrames(400);
  const grpc::Status reset(grpc::StatusCode::UNAVAILABLE, "Connection reset by peer");
  std::vector<Connection> connections = {
      {.fail_at_offset = 0},
      {.fail_at_offset = 34, .failure = reset},
      {.fail_at_offset = 120, .rewind_at_offset = 90, .rewind_to = 40},
      {.drain_at_offset = 150},
      {.rewind_at_offset = 399, .rewind_to = 200}};
  ScriptedServer scripted(1 << 20, connections);
  scripted.Start();
  const auto result = Upload(scripted.address(), Options(), frames);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(scripted.connection_count(), 5);
  EXPECT_THAT(scripted.complaints(), IsEmpty());
  EXPECT_TRUE(scripted.frames() == AsReceived(frames));
}

TEST(Uploader, WaitsForAServerThatComesLate) {
  const std::vector<SensorFrame> frames = SomeFrames(10);
  ScriptedServer server(1 << 20, {{}});
  server.Start();
  const int port = server.port();
  server.Stop();
  UploadProgress last;
  absl::StatusOr<UploadResult> result = absl::UnknownError("");
  bool started = false;
  auto channel = OpenChannel({.address = server.address()}).value();
  Uploader uploader(channel, Options(), &std::chrono::steady_clock::now, std::mt19937_64(3));
  MemorySource source(frames);
  result = uploader.Upload(source, [&](const UploadProgress& progress) {
    if (progress.trouble.empty() || started) return;
    EXPECT_THAT(progress.trouble, HasSubstr("cannot reach the server the test"));
    started = true;
    server.Start(port);
  });
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_TRUE(started);
  EXPECT_TRUE(server.frames() == AsReceived(frames));
}

TEST(Uploader, GivesUpWhenNobodyIsThere) {
  ScriptedServer server(1 << 20, {{}});
  server.Start();
  server.Stop();
  UploadOptions options = Options();
  options.give_up_after = milliseconds(100);
  const auto result = Upload(server.address(), options, SomeFrames(1));
  EXPECT_EQ(result.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(result.status().message()),
              AllOf(HasSubstr("cannot reach the server the test: connection refused"),
                    HasSubstr("given up")));
}

TEST(Uploader, GivesUpOnAServerThatNeverTakesAFrame) {
  ScriptedServer server(1 << 20, {{.fail_at_offset = 0}});
  server.Start();
  UploadOptions options = Options();
  options.give_up_after = milliseconds(100);
  EXPECT_EQ(Upload(server.address(), options, SomeFrames(1)).status().code(),
            absl::StatusCode::kUnavailable);
}

TEST(Uploader, TakesTheServersOtherErrorsAsFinal) {
  google::rpc::Status details;
  details.add_details()->PackFrom(google::rpc::ErrorInfo());
  for (const auto& [code, expected] :
       {std::make_pair(grpc::StatusCode::ABORTED, absl::StatusCode::kAborted),
        std::make_pair(grpc::StatusCode::DATA_LOSS, absl::StatusCode::kDataLoss),
        std::make_pair(grpc::StatusCode::INVALID_ARGUMENT, absl::StatusCode::kInvalidArgument),
        std::make_pair(grpc::StatusCode::RESOURCE_EXHAUSTED,
                       absl::StatusCode::kResourceExhausted)}) {
    const grpc::Status failure(code, "site 'x' says no", details.SerializeAsString());
    for (const Connection& connection : {Connection{.fail_at_offset = 5, .failure = failure},
                                         Connection{.refuse_session = failure}}) {
      ScriptedServer server(1 << 20, {connection});
      server.Start();
      const auto result = Upload(server.address(), Options(), SomeFrames(10));
      EXPECT_EQ(result.status().code(), expected);
      EXPECT_EQ(std::string(result.status().message()), "site 'x' says no");
      EXPECT_EQ(server.connection_count(), 1);
    }
  }
}

TEST(Uploader, TriesAgainWhenTheServerSaysWhen) {
  google::rpc::RetryInfo retry;
  retry.mutable_retry_delay()->set_nanos(1'000'000);
  google::rpc::Status details;
  details.add_details()->PackFrom(retry);
  const grpc::Status busy(grpc::StatusCode::RESOURCE_EXHAUSTED, "busy",
                          details.SerializeAsString());
  ScriptedServer server(1 << 20,
                        {{.refuse_session = busy}, {.fail_at_offset = 3, .failure = busy}, {}});
  server.Start();
  const std::vector<SensorFrame> frames = SomeFrames(10);
  ASSERT_TRUE(Upload(server.address(), Options(), frames).ok());
  EXPECT_EQ(server.connection_count(), 3);
  EXPECT_TRUE(server.frames() == AsReceived(frames));
}

TEST(Uploader, RefusesAFrameThatTheServerWouldNotTake) {
  std::vector<SensorFrame> frames = SomeFrames(3);
  frames[1].payload.assign((16 << 20) + 1, 'x');
  ScriptedServer server(32 << 20, {{}});
  server.Start();
  const auto result = Upload(server.address(), Options(), frames);
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(result.status().message()), HasSubstr("frame 1 "));
}

TEST(Uploader, SendsNoFrameBeforeItsTime) {
  const std::vector<SensorFrame> frames = SomeFrames(100);  // 1 ms apart
  ScriptedServer server(8 << 20, {{}});
  server.Start();
  UploadOptions options = Options();
  options.speed = 0.5;
  auto channel = OpenChannel({.address = server.address()}).value();
  Uploader uploader(channel, options, &std::chrono::steady_clock::now, std::mt19937_64(3));
  MemorySource source(frames);
  std::vector<std::chrono::steady_clock::time_point> sent_at;
  const auto result = uploader.Upload(source, [&](const UploadProgress& progress) {
    while (static_cast<std::int64_t>(sent_at.size()) < progress.next_offset) {
      sent_at.push_back(std::chrono::steady_clock::now());
    }
  });
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_EQ(sent_at.size(), 100u);
  // The first frame's own time is known only as no later than `sent_at[0]`, hence the slack.
  const auto slack = milliseconds(50);
  for (int i = 0; i < 100; ++i)
    EXPECT_GE(sent_at[i] - sent_at[0] + slack, milliseconds(2 * i)) << i;
  EXPECT_TRUE(server.frames() == AsReceived(frames));
}

TEST(OpenChannel, SendsNoTokenInTheClear) {
  EXPECT_FALSE(OpenChannel({.address = "example.org:7443", .token = "t"}).ok());
  EXPECT_TRUE(OpenChannel({.address = "127.0.0.1:7443", .token = "t"}).ok());
  EXPECT_TRUE(OpenChannel({.address = "localhost:7443", .token = "t"}).ok());
  EXPECT_TRUE(OpenChannel({.address = "[::1]:7443", .token = "t"}).ok());
  EXPECT_TRUE(OpenChannel({.address = "example.org:7443"}).ok());
}

}  // namespace
}  // namespace soundmap::uplink
