#include "api/ingest_service.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
#include <filesystem>
#include <random>

#include "api/decode_message.h"
#include "foxglove/KeyValuePair.pb.h"
#include "google/rpc/status_details.pb.h"
#include "recording/foxglove_messages.h"
#include "recording/frame_coding.h"
#include "storage/crc32c.h"

namespace soundmap::api {
namespace {

using ::testing::HasSubstr;

constexpr int kMicrophones = 12;
constexpr int kRate_hz = 16000;

struct Sent {
  v1::Sensor sensor;
  std::string message;
};

Sent Audio(std::int64_t block) {
  std::vector<std::int16_t> samples(kMicrophones * 800);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    samples[i] = static_cast<std::int16_t>((i * 7 + static_cast<std::size_t>(block)) % 300);
  }
  return {v1::SENSOR_AUDIO, recording::MakeRawAudio(1'000'000'000 + block * 50'000'000, kRate_hz,
                                                    kMicrophones, samples)
                                .SerializeAsString()};
}

Sent Points() {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 3000; ++i) {
    points.push_back({std::cos(0.002f * i), std::sin(0.002f * i), 0.5f});
  }
  return {v1::SENSOR_LIDAR,
          recording::SnapFrame("foxglove.PointCloud",
                               recording::MakePointCloud(5, points).SerializeAsString(), 0.001)};
}

v1::Frame FrameOf(const Sent& sent, bool coded) {
  v1::Frame frame;
  frame.set_sensor(sent.sensor);
  frame.set_log_time_ns(1'000'000'000);
  frame.set_payload(sent.message);
  if (!coded) return frame;
  const recording::CodedFrame made = recording::CodeFrame(
      sent.sensor == v1::SENSOR_AUDIO ? "foxglove.RawAudio" : "foxglove.PointCloud", sent.message,
      {{v1::CODING_FLAC, v1::CODING_POINTS}, 0.001});
  frame.set_coding(made.coding);
  frame.set_message_bytes(static_cast<std::uint32_t>(sent.message.size()));
  frame.set_payload(made.bytes);
  return frame;
}

v1::IngestRequest ChunkOf(std::int64_t offset, const std::vector<v1::Frame>& frames) {
  v1::IngestRequest request;
  request.mutable_chunk()->set_first_offset(offset);
  std::uint32_t crc = 0;
  for (const v1::Frame& frame : frames) {
    crc = storage::Crc32c(frame.payload(), crc);
    *request.mutable_chunk()->add_frames() = frame;
  }
  request.mutable_chunk()->set_crc32c(crc);
  return request;
}

// One robot's call. What the server says is read as it is asked for.
class Call {
 public:
  Call(v1::IngestService::Stub& stub, std::int64_t epoch, const std::string& session = "d") {
    context_.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(30));
    stream_ = stub.Ingest(&context_);
    v1::IngestRequest open;
    open.mutable_open()->set_session("sites/hall/sessions/" + session);
    open.mutable_open()->set_epoch(epoch);
    stream_->Write(open);
  }
  void Send(const v1::IngestRequest& request) { stream_->Write(request); }
  void Send(std::int64_t offset, const std::vector<v1::Frame>& frames) {
    Send(ChunkOf(offset, frames));
  }
  // Until the robot may send.
  std::optional<v1::IngestResponse> AwaitWelcome() {
    auto welcome = Await(v1::IngestResponse::kWelcome);
    if (welcome) Await(v1::IngestResponse::kCredit);
    return welcome;
  }
  // The next answer of the kind; none when the call ends before.
  std::optional<v1::IngestResponse> Await(v1::IngestResponse::MessageCase kind) {
    v1::IngestResponse response;
    while (stream_->Read(&response)) {
      if (response.message_case() == kind) return response;
    }
    return std::nullopt;
  }
  void AwaitReceived(std::int64_t count) {
    v1::IngestResponse response;
    while (stream_->Read(&response)) {
      if (response.ack().received() >= count) return;
    }
  }
  void Finish(std::int64_t count) {
    v1::IngestRequest finish;
    finish.mutable_finish()->set_frame_count(count);
    Send(finish);
  }
  grpc::Status End() {
    v1::IngestResponse response;
    while (stream_->Read(&response)) {
    }
    return stream_->Finish();
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::IngestRequest, v1::IngestResponse>> stream_;
};

class IngestServiceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) /
              ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::remove_all(folder_);
    store_ = storage::Store::Open(folder_.string()).value();
    sites_ = pipeline::Sites::Open(store_.get(), {pool_.get_executor(), DecodeMessage,
                                                  pipeline::ProfileByName, [] { return 1; }})
                 .value();
    access_ = Access::Create({}, [] { return 1; }).value();
    service_ = std::make_unique<IngestService>(sites_.get(), access_.get(), pool_.get_executor());
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(service_.get());
    server_ = builder.BuildAndStart();
    stub_ = v1::IngestService::NewStub(grpc::CreateChannel("127.0.0.1:" + std::to_string(port),
                                                           grpc::InsecureChannelCredentials()));
    site_ = sites_->Create("hall", "", "").value();
    request_.session = "d";
    request_.robot = "r";
    request_.purpose = pipeline::Purpose::kMapping;
    for (int mic = 0; mic < kMicrophones; ++mic) {
      request_.calibration.mic_in_array_m.push_back({0.1 * mic, 0.0, 0.0});
    }
    request_.calibration.audio_sample_rate_hz = kRate_hz;
    NextEpoch();
  }
  void TearDown() override {
    server_->Shutdown();
    server_.reset();
    sites_.reset();
    store_.reset();
    std::filesystem::remove_all(folder_);
  }

  // As when the robot connects again.
  std::int64_t NextEpoch() { return (*site_->CreateSession(request_, 1))->record().epoch; }
  std::int64_t epoch() { return (*site_->GetSession("d"))->record().epoch; }

  std::vector<std::string> Logged() {
    std::vector<std::string> messages;
    auto reader = store_->OpenSession({"hall", "d"}).value()->Read(0).value();
    while (auto message = reader->Next().value()) {
      if (message->topic != "/session/end") messages.push_back(message->data);
    }
    return messages;
  }

  std::filesystem::path folder_;
  boost::asio::thread_pool pool_{2};
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<pipeline::Sites> sites_;
  std::unique_ptr<Access> access_;
  std::unique_ptr<IngestService> service_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<v1::IngestService::Stub> stub_;
  std::shared_ptr<pipeline::Site> site_;
  pipeline::SessionRequest request_;
};

TEST_F(IngestServiceTest, CodedFramesAreLoggedAsTheMessagesThatTheyStandFor) {
  Call call(*stub_, epoch());
  const auto welcome = call.AwaitWelcome();
  ASSERT_TRUE(welcome);
  EXPECT_THAT(welcome->welcome().codings(),
              ::testing::UnorderedElementsAre(v1::CODING_FLAC, v1::CODING_POINTS, v1::CODING_ZSTD));
  std::vector<std::string> messages;
  std::int64_t offset = 0;
  for (const bool coded : {true, false}) {
    for (const Sent& sent : {Audio(offset), Points()}) {
      call.Send(offset++, {FrameOf(sent, coded)});
      messages.push_back(sent.message);
    }
  }
  // In parts, after coding.
  const Sent whole = Audio(99);
  const v1::Frame frame = FrameOf(whole, true);
  const std::size_t half = frame.payload().size() / 2;
  for (const std::uint32_t part : {0, 1}) {
    v1::Frame piece = frame;
    piece.set_part(part);
    piece.set_part_count(2);
    piece.set_payload(part == 0 ? frame.payload().substr(0, half) : frame.payload().substr(half));
    call.Send(offset, {piece});
  }
  messages.push_back(whole.message);
  call.Finish(++offset);
  const grpc::Status end = call.End();
  ASSERT_TRUE(end.ok()) << end.error_message();
  EXPECT_TRUE(Logged() == messages);
}

TEST_F(IngestServiceTest, AFrameSentAgainMayBeCodedOtherwiseButNotDiffer) {
  {
    Call call(*stub_, epoch());
    call.AwaitWelcome();
    call.Send(0, {FrameOf(Audio(1), true)});
    call.AwaitReceived(1);
    call.Send(0, {FrameOf(Audio(1), false), FrameOf(Audio(2), false)});
    call.AwaitReceived(2);
    call.Send(1, {FrameOf(Audio(2), true)});
    call.Finish(2);
    EXPECT_TRUE(call.End().ok());
  }
  request_.session = "e";
  const std::int64_t epoch = NextEpoch();
  Call call(*stub_, epoch, "e");
  call.AwaitWelcome();
  call.Send(0, {FrameOf(Audio(1), true)});
  call.Send(0, {FrameOf(Audio(2), true)});
  EXPECT_EQ(call.End().error_code(), grpc::StatusCode::DATA_LOSS);
}

TEST_F(IngestServiceTest, WhatDoesNotDecodeIsRefusedAndTheSessionGoesOn) {
  const auto refused = [&](const v1::Frame& frame, const std::string& says) {
    Call call(*stub_, NextEpoch());
    call.Await(v1::IngestResponse::kCredit);
    call.Send(0, {frame});
    const grpc::Status end = call.End();
    EXPECT_EQ(end.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << says;
    EXPECT_THAT(end.error_message(), HasSubstr(says));
    EXPECT_THAT(end.error_message(), HasSubstr("frame 0"));
  };
  const v1::Frame good = FrameOf(Audio(1), true);
  v1::Frame bad = good;
  bad.set_coding(static_cast<v1::Coding>(99));
  refused(bad, "coding 99");
  bad = good;
  bad.set_message_bytes(good.message_bytes() + 1);
  refused(bad, "not the");
  bad.set_message_bytes(0xffffffff);
  refused(bad, "larger than");
  bad = good;
  bad.mutable_payload()->resize(good.payload().size() - 7);
  refused(bad, "");
  bad = good;
  bad.set_coding(v1::CODING_POINTS);
  refused(bad, "");
  // A message of other channels than the calibration, well coded.
  bad = FrameOf(
      {v1::SENSOR_AUDIO, recording::MakeRawAudio(1, kRate_hz, 2, std::vector<std::int16_t>(2000, 1))
                             .SerializeAsString()},
      true);
  refused(bad, "2 channels");

  Call call(*stub_, NextEpoch());
  call.AwaitWelcome();
  call.Send(0, {good});
  call.Finish(1);
  EXPECT_TRUE(call.End().ok());
}

TEST_F(IngestServiceTest, MoreThanTheCreditIsRefusedWithATimeToTryAgain) {
  Call call(*stub_, epoch());
  const auto credit = call.Await(v1::IngestResponse::kCredit);
  ASSERT_TRUE(credit);
  // Each is a few hundred bytes on the wire.
  v1::Frame bomb;
  bomb.set_sensor(v1::SENSOR_LASER);
  const std::string zeros(static_cast<std::size_t>(credit->credit().bytes() / 2 + 1), '\0');
  const recording::CodedFrame coded =
      recording::CodeFrame("foxglove.LaserScan", zeros, {{v1::CODING_ZSTD}, 0.0});
  bomb.set_coding(coded.coding);
  bomb.set_message_bytes(static_cast<std::uint32_t>(zeros.size()));
  bomb.set_payload(coded.bytes);
  call.Send(0, {bomb, bomb});
  const grpc::Status end = call.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED) << end.error_message();
  google::rpc::Status details;
  ASSERT_TRUE(details.ParseFromString(end.error_details()));
  google::rpc::RetryInfo retry;
  bool has_retry = false;
  for (const auto& detail : details.details()) has_retry |= detail.UnpackTo(&retry);
  EXPECT_TRUE(has_retry);
}

TEST_F(IngestServiceTest, AGapIsAskedForOnce) {
  Call call(*stub_, epoch());
  call.AwaitWelcome();
  call.Send(2, {FrameOf(Audio(2), true)});
  call.Send(3, {FrameOf(Audio(3), true)});
  const auto rewind = call.Await(v1::IngestResponse::kRewind);
  ASSERT_TRUE(rewind);
  EXPECT_EQ(rewind->rewind().offset(), 0);
  for (int i = 0; i < 4; ++i) call.Send(i, {FrameOf(Audio(i), true)});
  call.Finish(4);
  EXPECT_FALSE(call.Await(v1::IngestResponse::kRewind));
  EXPECT_TRUE(call.End().ok());
  EXPECT_EQ(Logged().size(), 4u);
}

TEST_F(IngestServiceTest, WhatTheRobotHasLostIsKept) {
  const auto lost = [](std::int64_t frames, std::int64_t from_ns, std::int64_t to_ns) {
    foxglove::KeyValuePair pair;
    pair.set_key("gap");
    pair.set_value("{\"frames\":" + std::to_string(frames) +
                   ",\"from_ns\":" + std::to_string(from_ns) +
                   ",\"to_ns\":" + std::to_string(to_ns) + ",\"reason\":\"full\"}");
    return FrameOf({v1::SENSOR_GAP, pair.SerializeAsString()}, false);
  };
  const std::vector<pipeline::Gap> gaps = {{1, 40, 10, 20, "full"}, {3, 2, 30, 40, "full"}};
  {
    Call call(*stub_, epoch());
    call.AwaitWelcome();
    call.Send(0, {FrameOf(Audio(0), true), lost(40, 10, 20), FrameOf(Audio(5), true)});
    call.Send(3, {lost(2, 30, 40)});
    call.Send(3, {lost(2, 30, 40)});  // a duplicate is not another one
    while (const auto ack = call.Await(v1::IngestResponse::kAck)) {
      if (ack->ack().processed() == 4) break;
    }
  }
  const auto check = [&] {
    EXPECT_EQ((*site_->GetSession("d"))->record().gaps, gaps);
    const auto robots = site_->Robots();
    ASSERT_EQ(robots.size(), 1u);
    EXPECT_EQ(robots[0].lost_frames, 42);
    EXPECT_EQ(sites_->meters().lost_frames, 42);
  };
  check();
  // What is stored says the same.
  const auto stored = store_->GetRecord(storage::Table::kSession, "hall/d");
  ASSERT_TRUE(stored.ok());
  EXPECT_EQ(pipeline::SessionRecordFromJson(**stored)->gaps, gaps);
  Call call(*stub_, NextEpoch());
  call.AwaitWelcome();
  call.Send(4, {FrameOf(Audio(6), true)});
  call.Finish(5);
  EXPECT_TRUE(call.End().ok());
  check();

  request_.session = "e";
  Call bad(*stub_, NextEpoch(), "e");
  bad.AwaitWelcome();
  bad.Send(0, {lost(0, 10, 20)});
  EXPECT_EQ(bad.End().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(IngestServiceTest, ANewerEpochFencesTheOlderOne) {
  Call old(*stub_, epoch());
  old.AwaitWelcome();
  old.Send(0, {FrameOf(Audio(0), true)});
  old.AwaitReceived(1);
  const std::int64_t newer = NextEpoch();
  Call young(*stub_, newer);
  const auto welcome = young.AwaitWelcome();
  ASSERT_TRUE(welcome);
  EXPECT_EQ(welcome->welcome().resume_offset(), 1);
  old.Send(1, {FrameOf(Audio(7), true)});
  EXPECT_EQ(old.End().error_code(), grpc::StatusCode::ABORTED);
  EXPECT_EQ(Call(*stub_, newer - 1).End().error_code(), grpc::StatusCode::ABORTED);
  young.Send(1, {FrameOf(Audio(1), true)});
  young.Finish(2);
  EXPECT_TRUE(young.End().ok());
  EXPECT_TRUE(Logged() == (std::vector<std::string>{Audio(0).message, Audio(1).message}));
}

TEST_F(IngestServiceTest, AStoppingServerSaysDrainAndEndsTheStream) {
  Call call(*stub_, epoch());
  call.AwaitWelcome();
  service_->Drain();
  EXPECT_TRUE(call.Await(v1::IngestResponse::kDrain));
  EXPECT_EQ(call.End().error_code(), grpc::StatusCode::UNAVAILABLE);
  Call late(*stub_, NextEpoch());
  EXPECT_EQ(late.End().error_code(), grpc::StatusCode::UNAVAILABLE);
}

}  // namespace
}  // namespace soundmap::api
