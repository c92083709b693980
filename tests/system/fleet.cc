// fleet SERVER SITE DRIVE POSE ROBOTS: so many robots that send the frames of a recorded drive as
// they fall due, and again once the server has all in its map, until standard input ends. They
// speak the protocol of the real agent and cost next to nothing: frames are coded once for all, and
// kept in memory. Prints a JSON line when it begins, and one at the end: how long after they were
// due frames were said to be durable.
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <future>
#include <iostream>
#include <limits>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "recording/frame_coding.h"
#include "soundmap/v1/ingest_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "sources/replay/replay.h"
#include "sources/sensor_format.h"
#include "uplink/chunk_builder.h"
#include "uplink/drive_session.h"
#include "uplink/ingest_stream.h"

namespace soundmap {
namespace {

using std::chrono::nanoseconds;
using std::chrono::steady_clock;

constexpr double kLidarResolution_m = 0.001;
constexpr std::int64_t kMaxChunkBytes = 256 << 10;

struct Drive {
  v1::CreateSessionRequest session;
  std::vector<uplink::OutgoingFrame> frames;

  nanoseconds DueAfter(std::size_t offset) const {
    return nanoseconds(frames[offset].frame.log_time_ns - frames[0].frame.log_time_ns);
  }
};

absl::StatusOr<Drive> ReadDrive(const std::string& path, const uplink::DriveSession& of) {
  auto replay = sources::Replay::Open(path);
  if (!replay.ok()) return replay.status();
  recording::FrameCoding coding;
  coding.allowed = {v1::CODING_FLAC, v1::CODING_POINTS, v1::CODING_ZSTD};
  coding.lidar_resolution_m = kLidarResolution_m;
  Drive drive{uplink::SessionRequest(of, **replay), {}};
  while (true) {
    auto next = (*replay)->Next();
    if (!next.ok()) return next.status();
    if (!next->has_value()) return drive;
    uplink::OutgoingFrame frame{**std::move(next)};
    const std::string_view schema = sources::FormatOf(frame.frame.sensor).schema;
    frame.frame.payload =
        recording::SnapFrame(schema, std::move(frame.frame.payload), kLidarResolution_m);
    frame.message_bytes = frame.payload_bytes();
    recording::CodedFrame coded = recording::CodeFrame(schema, frame.frame.payload, coding);
    if (coded.coding != v1::CODING_UNSPECIFIED) {
      frame.coding = coded.coding;
      frame.frame.payload = std::move(coded.bytes);
    }
    if (frame.payload_bytes() > kMaxChunkBytes) {
      return absl::InvalidArgumentError("a frame of the drive is larger than a chunk");
    }
    drive.frames.push_back(std::move(frame));
  }
}

// What all robots count.
class Tally {
 public:
  void Add(const std::vector<float>& lags_s, nanoseconds throttled) {
    const std::lock_guard lock(mutex_);
    lags_s_.insert(lags_s_.end(), lags_s.begin(), lags_s.end());
    throttled_ += throttled;
  }
  void Fail(const std::string& error) {
    const std::lock_guard lock(mutex_);
    if (failed_ == 0) serving_at_first_failure_ = serving_;
    ++failed_;
    if (error_.empty()) error_ = error;
  }
  void NoteHealth(bool serving) {
    const std::lock_guard lock(mutex_);
    serving_ = serving;
  }
  nlohmann::json ToJson() {
    const std::lock_guard lock(mutex_);
    std::sort(lags_s_.begin(), lags_s_.end());
    const auto quantile = [this](double share) {
      return lags_s_.empty() ? 0.0F
                             : lags_s_[static_cast<std::size_t>(
                                   share * static_cast<double>(lags_s_.size() - 1))];
    };
    return {{"event", "end"},
            {"ended_early", failed_},
            {"error", error_},
            {"warned_first", failed_ > 0 && serving_at_first_failure_ == false},
            {"drives", drives.load()},
            {"frames", lags_s_.size()},
            {"throttled_s", std::chrono::duration<double>(throttled_).count()},
            {"p50_s", quantile(0.5)},
            {"p99_s", quantile(0.99)},
            {"most_s", quantile(1.0)}};
  }

  std::atomic<int> drives = 0;  // that are processed whole
  std::atomic<bool> stop = false;

 private:
  std::mutex mutex_;
  std::vector<float> lags_s_;
  nanoseconds throttled_{};  // a frame was due and the robot had no credit, all robots together
  int failed_ = 0;
  std::string error_;
  std::optional<bool> serving_;  // none: nothing was heard of it yet
  std::optional<bool> serving_at_first_failure_;
};

// Hears of the server's health: grpc.health.v1, whose generated code no package has.
class HealthWatch : public grpc::ClientBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer> {
 public:
  HealthWatch(const std::string& server, Tally& tally)
      : stub_(grpc::CreateChannel(server, grpc::InsecureChannelCredentials())), tally_(tally) {
    stub_.PrepareBidiStreamingCall(&context_, "/grpc.health.v1.Health/Watch", {}, this);
    StartWriteLast(&whole_server_, {});
    StartRead(&answer_);
    StartCall();
  }
  ~HealthWatch() override {
    context_.TryCancel();
    ended_.get_future().wait();
  }
  void OnReadDone(bool ok) override {
    if (!ok) return;
    grpc::Slice bytes;
    if (answer_.DumpToSingleSlice(&bytes).ok()) {
      // HealthCheckResponse: field 1 is the status, 1 means serving.
      tally_.NoteHealth(bytes.size() == 2 && bytes.begin()[0] == 8 && bytes.begin()[1] == 1);
    }
    StartRead(&answer_);
  }
  void OnDone(const grpc::Status&) override { ended_.set_value(); }

 private:
  grpc::GenericStub stub_;
  Tally& tally_;
  grpc::ClientContext context_;
  grpc::Slice nothing_;
  grpc::ByteBuffer whole_server_{&nothing_, 1};  // a HealthCheckRequest without a service
  grpc::ByteBuffer answer_;
  std::promise<void> ended_;
};

// One drive of one robot.
class Journey {
 public:
  Journey(const Drive& drive, uplink::IngestStream& stream, Tally& tally)
      : drive_(drive), stream_(stream), tally_(tally) {}

  // False: the stream ended early.
  bool Run() {
    while (!stream_.state().welcome && !stream_.state().ended) Wait(std::chrono::seconds(1));
    begin_ = steady_clock::now();
    std::size_t offset = 0;
    while (offset < drive_.frames.size() && Goes()) {
      const nanoseconds early = begin_ + drive_.DueAfter(offset) - steady_clock::now();
      if (early > nanoseconds(0)) {
        Wait(early);
      } else if (drive_.frames[offset].message_bytes > stream_.state().credit_bytes) {
        const auto since = steady_clock::now();
        Wait(std::chrono::seconds(1));
        throttled_ += steady_clock::now() - since;
      } else if (!SendDue(offset)) {
        break;
      }
    }
    if (offset == drive_.frames.size()) {
      v1::IngestRequest finish;
      finish.mutable_finish()->set_frame_count(static_cast<std::int64_t>(offset));
      stream_.Write(finish);
      while (Goes()) Wait(std::chrono::seconds(1));
    }
    tally_.Add(lags_s_, throttled_);
    return offset == drive_.frames.size() || tally_.stop;
  }

 private:
  bool Goes() const { return !stream_.state().ended && !tally_.stop; }

  bool SendDue(std::size_t& offset) {
    uplink::ChunkBuilder chunk(static_cast<std::int64_t>(offset));
    const std::int64_t credit = stream_.state().credit_bytes;
    do {
      chunk.Add(drive_.frames[offset++]);
    } while (offset < drive_.frames.size() &&
             begin_ + drive_.DueAfter(offset) <= steady_clock::now() &&
             chunk.payload_bytes() + drive_.frames[offset].payload_bytes() <= kMaxChunkBytes &&
             chunk.credit_bytes() + drive_.frames[offset].message_bytes <= credit);
    stream_.SpendCredit(chunk.credit_bytes());
    return stream_.Write(chunk.Finish());
  }

  // Until the server says something, `time` at most.
  void Wait(nanoseconds time) {
    stream_.WaitForNews(seen_, time);
    seen_ = stream_.state();
    const auto now = steady_clock::now();
    const auto durable =
        std::min(static_cast<std::size_t>(seen_.watermarks.durable), drive_.frames.size());
    for (; durable_ < durable; ++durable_) {
      lags_s_.push_back(
          std::chrono::duration<float>(now - begin_ - drive_.DueAfter(durable_)).count());
    }
  }

  const Drive& drive_;
  uplink::IngestStream& stream_;
  Tally& tally_;
  steady_clock::time_point begin_;
  uplink::IngestStream::State seen_;
  std::size_t durable_ = 0;
  std::vector<float> lags_s_;
  nanoseconds throttled_{};
};

void RunRobot(const std::string& server, const Drive& drive, int index, Tally& tally) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // a connection of its own
  const auto channel =
      grpc::CreateCustomChannel(server, grpc::InsecureChannelCredentials(), arguments);
  const auto sessions = v1::SessionService::NewStub(channel);
  const auto ingest = v1::IngestService::NewStub(channel);
  for (int count = 0; !tally.stop; ++count) {
    v1::CreateSessionRequest request = drive.session;
    request.set_robot(absl::StrCat("robots/fleet", index));
    request.set_session_id(absl::StrCat("fleet", index, "-", count));
    v1::Session session;
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    context.set_wait_for_ready(true);  // a robot's program connects again, too
    const grpc::Status made = sessions->CreateSession(&context, request, &session);
    if (!made.ok()) return tally.stop ? void() : tally.Fail(made.error_message());
    uplink::IngestStream stream(*ingest, std::make_unique<grpc::ClientContext>());
    v1::IngestRequest open;
    open.mutable_open()->set_session(session.name());
    open.mutable_open()->set_epoch(session.epoch());
    stream.Write(open);
    const bool whole = Journey(drive, stream, tally).Run();
    if (tally.stop) return;
    const grpc::Status end = stream.Finish();
    if (!whole || !end.ok()) return tally.stop ? void() : tally.Fail(end.error_message());
    ++tally.drives;
  }
}

int Fail(const std::string& what) {
  std::cerr << "fleet: " << what << '\n';
  return 1;
}

int Main(int argc, char** argv) {
  int count = 0;
  if (argc != 6 || !absl::SimpleAtoi(argv[5], &count)) {
    return Fail("usage: fleet SERVER SITE DRIVE POSE ROBOTS");
  }
  uplink::DriveSession of;
  of.site = argv[2];
  of.robot = "fleet";
  for (const absl::string_view number : absl::StrSplit(argv[4], ',')) {
    if (!absl::SimpleAtod(number, &of.initial_pose.emplace_back())) {
      return Fail("the pose is not x_m,y_m,yaw_rad");
    }
  }
  if (of.initial_pose.size() != 3) return Fail("the pose is not x_m,y_m,yaw_rad");
  const auto drive = ReadDrive(argv[3], of);
  if (!drive.ok()) return Fail(std::string(drive.status().message()));
  Tally tally;
  const HealthWatch health(argv[1], tally);
  std::vector<std::thread> robots;
  for (int i = 0; i < count; ++i) {
    robots.emplace_back([&, i] { RunRobot(argv[1], *drive, i, tally); });
  }
  std::cout << nlohmann::json{{"event", "ready"}} << std::endl;
  std::cin.ignore(std::numeric_limits<std::streamsize>::max());
  tally.stop = true;
  for (std::thread& robot : robots) robot.join();
  std::cout << tally.ToJson() << std::endl;
  return 0;
}

}  // namespace
}  // namespace soundmap

int main(int argc, char** argv) { return soundmap::Main(argc, argv); }
