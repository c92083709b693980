#include <arpa/inet.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <latch>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "pipeline/events.h"
#include "soundmap/v1/site_service.grpc.pb.h"
#include "soundmap/v1/watch_service.grpc.pb.h"
#include "tests/api/test_server.h"

namespace soundmap::api {
namespace {

// Speaks HTTP/2 (RFC 9113) as far as a ping goes, without gRPC: what gRPC's clients of this process
// do would look after the server's connections too.
class PingingPeer {
 public:
  explicit PingingPeer(const std::string& address) {
    int port = 0;
    EXPECT_TRUE(absl::SimpleAtoi(address.substr(address.rfind(':') + 1), &port));
    sockaddr_in to = {};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const timeval give_up = {20, 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &give_up, sizeof(give_up));
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof(to)), 0);
  }
  ~PingingPeer() { ::close(socket_); }

  // Greets and pings; whether the answer to the ping comes.
  bool IsAnswered() {
    Send("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n");
    Send(std::string("\0\0\0\4\0\0\0\0\0", 9));                // SETTINGS, none
    Send(std::string("\0\0\x8\6\0\0\0\0\0", 9) + "whistles");  // PING
    while (true) {
      const std::string header = Take(9);
      if (header.size() < 9) return false;
      const auto byte = [&header](int i) { return static_cast<unsigned char>(header[i]); };
      const std::string payload =
          Take(static_cast<std::size_t>(byte(0) << 16 | byte(1) << 8 | byte(2)));
      if (byte(3) == 6 && byte(4) == 1) return payload == "whistles";
    }
  }

 private:
  void Send(const std::string& bytes) {
    EXPECT_EQ(::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(bytes.size()));
  }
  std::string Take(std::size_t size) {
    std::string bytes(size, '\0');
    const ssize_t got = ::recv(socket_, bytes.data(), size, MSG_WAITALL);
    bytes.resize(static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
    return bytes;
  }

  const int socket_ = ::socket(AF_INET, SOCK_STREAM, 0);
};

class BusyServerTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    // Otherwise a client looks after the server's connections every five seconds.
    setenv("GRPC_CLIENT_CHANNEL_BACKUP_POLL_INTERVAL_MS", "0", /*overwrite=*/1);
  }

  BusyServerTest() {
    TestServer::Options options;
    options.folder = absl::StrCat(::testing::TempDir(), "/",
                                  ::testing::UnitTest::GetInstance()->current_test_info()->name());
    options.profile = [this](const std::string& name) {
      ++asked_;
      if (name == "slow") go_on_.wait();
      return pipeline::ProfileByName("default");
    };
    server_.emplace(options);
    channel_ = server_->Channel();
  }

  std::atomic<int> asked_ = 0;
  std::latch go_on_{1};
  std::optional<TestServer> server_;
  std::shared_ptr<grpc::Channel> channel_;
};

TEST_F(BusyServerTest, PeersAreAnsweredWhileEveryCallTakesLong) {
  ASSERT_TRUE(
      channel_->WaitForConnected(std::chrono::system_clock::now() + std::chrono::seconds(20)));
  const auto stub = v1::SiteService::NewStub(channel_);
  // So many threads run calls in gRPC 1.51.
  const int threads = std::clamp(static_cast<int>(std::thread::hardware_concurrency()) / 2, 2, 16);
  struct Call {
    grpc::ClientContext context;
    v1::Site site;
    grpc::Status status;
    std::unique_ptr<grpc::ClientAsyncResponseReader<v1::Site>> reader;
  };
  std::vector<Call> calls(static_cast<std::size_t>(threads));
  grpc::CompletionQueue queue;
  for (std::size_t i = 0; i < calls.size(); ++i) {
    v1::CreateSiteRequest request;
    request.set_site_id(absl::StrCat("s", i));
    request.set_profile("slow");
    calls[i].reader = stub->AsyncCreateSite(&calls[i].context, request, &queue);
    calls[i].reader->Finish(&calls[i].site, &calls[i].status, &calls[i]);
  }
  while (asked_ < threads) std::this_thread::yield();

  EXPECT_TRUE(PingingPeer(server_->address()).IsAnswered());

  go_on_.count_down();
  for (std::size_t i = 0; i < calls.size(); ++i) {
    void* tag = nullptr;
    bool ok = false;
    ASSERT_TRUE(queue.Next(&tag, &ok));
    EXPECT_TRUE(static_cast<Call*>(tag)->status.ok());
  }
}

// A watcher is told the newest state of a robot, not all states that it had in between.
TEST_F(BusyServerTest, AWatcherGetsTheNewestStateOfARobotAndEveryScan) {
  constexpr int kScans = 100;
  const auto site = server_->sites().Create("hall", "", "").value();
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(30));
  v1::WatchRequest request;
  request.set_site("sites/hall");
  const auto watch = v1::WatchService::NewStub(channel_)->Watch(&context, request);
  v1::WatchEvent event;
  while (watch->Read(&event) && !event.has_snapshot_complete()) {
  }
  ASSERT_TRUE(event.has_snapshot_complete());

  const auto lease = site->live().Open("r1", 0, 1).value();
  for (int i = 1; i <= kScans; ++i) {
    pipeline::LiveView view{.session = "drive"};
    view.report.recorded_frames = i;
    ASSERT_TRUE(site->live().Report("r1", lease, std::move(view)).ok());
    for (const char* name : {"r1", "r2"}) {
      pipeline::RobotInfo robot;
      robot.robot = name;
      robot.last_seen_ns = i;
      site->region().events().Publish(robot);
    }
    pipeline::AudioScanInfo scan;
    scan.robot = "r1";
    scan.time_ns = i;
    site->region().events().Publish(scan);
  }
  int states = 0;
  int live_states = 0;
  std::int64_t live_frames = 0;
  std::int64_t last_scan_ns = 0;
  std::map<std::string, std::int64_t> last_seen_ns;
  while (last_scan_ns < kScans || live_frames < kScans || last_seen_ns["robots/r1"] < kScans ||
         last_seen_ns["robots/r2"] < kScans) {
    ASSERT_TRUE(watch->Read(&event));
    if (event.has_audio_scan()) {
      EXPECT_EQ(event.audio_scan().time_ns(), ++last_scan_ns);
    }
    if (event.has_live_robot()) {
      ++live_states;
      EXPECT_GE(event.live_robot().live().recorded_frames(), live_frames);
      live_frames = event.live_robot().live().recorded_frames();
    }
    if (event.has_robot()) {
      ++states;
      std::int64_t& seen_ns = last_seen_ns[event.robot().name()];
      EXPECT_GT(event.robot().last_seen_ns(), seen_ns);
      seen_ns = event.robot().last_seen_ns();
    }
  }
  EXPECT_LT(states, 2 * kScans);
  EXPECT_LT(live_states, kScans);
  context.TryCancel();
}

// Whether its connection is used for anything else or not.
TEST_F(BusyServerTest, AWatcherThatComesBackGetsWhatItMissedAtOnce) {
  const auto site = server_->sites().Create("hall", "", "").value();
  const auto stub = v1::WatchService::NewStub(channel_);
  // The server's next ping, which takes along what lies unsent, is 20 s away.
  const auto deadline = std::chrono::system_clock::now() + std::chrono::seconds(15);
  v1::WatchRequest request;
  request.set_site("sites/hall");
  v1::WatchEvent event;
  {
    grpc::ClientContext context;
    context.set_deadline(deadline);
    const auto watch = stub->Watch(&context, request);
    while (watch->Read(&event) && !event.has_snapshot_complete()) {
    }
    request.set_resume_token(event.resume_token());
    context.TryCancel();
  }
  constexpr int kScans = 5;
  for (int i = 0; i < kScans; ++i) {
    pipeline::AudioScanInfo scan;
    scan.time_ns = i;
    site->region().events().Publish(scan);
  }
  for (int again = 0; again < 20; ++again) {
    grpc::ClientContext context;
    context.set_deadline(deadline);
    const auto watch = stub->Watch(&context, request);
    for (int i = 0; i < kScans; ++i) {
      ASSERT_TRUE(watch->Read(&event)) << "time " << again << ", event " << i;
      EXPECT_EQ(event.audio_scan().time_ns(), i);
    }
    context.TryCancel();
  }
}

}  // namespace
}  // namespace soundmap::api
