#include "run_agent.h"

#include <pthread.h>
#include <signal.h>
#include <time.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <map>
#include <mutex>
#include <random>
#include <thread>

#include "absl/strings/str_cat.h"
#include "run_config.h"
#include "sources/replay/replay.h"
#include "sources/snapped_source.h"
#include "spool/spool.h"
#include "uplink/channel.h"
#include "uplink/drive_session.h"
#include "uplink/live_link.h"
#include "uplink/uploader.h"

namespace soundmap {
namespace {

using std::chrono::steady_clock;

// A session that the server refuses for a reason of its own is left alone so long.
constexpr std::chrono::seconds kHold{30};
constexpr std::chrono::hours kForEver{24 * 365 * 100};
constexpr std::chrono::milliseconds kLook{200};

std::int64_t NowNs(clockid_t clock) {
  timespec now = {};
  clock_gettime(clock, &now);
  return std::int64_t{1'000'000'000} * now.tv_sec + now.tv_nsec;
}

void Say(const std::string& what) { std::fprintf(stderr, "soundmap-robot: %s\n", what.c_str()); }

class Agent {
 public:
  Agent(const RunConfig& config, uplink::ServerOptions server, spool::Spool* spool,
        sources::Replay* replay)
      : config_(config), server_(std::move(server)), spool_(spool), replay_(replay) {}

  // Until everything is delivered, or Stop().
  absl::Status Run() {
    auto channel = uplink::OpenChannel(server_);
    if (!channel.ok()) return channel.status();
    std::unique_ptr<uplink::LiveLink> live;
    if (config_.live) live = ShowLive();
    live_ = live.get();
    std::thread recorder([this] {
      const absl::Status recorded = Record();
      std::lock_guard lock(mutex_);
      recorded_ = true;
      if (!absl::IsCancelled(recorded)) record_status_ = recorded;
      changed_.notify_all();
    });
    Deliver(*channel);
    recorder.join();
    return record_status_;
  }

  void Stop() {
    spool_->Stop();
    std::lock_guard lock(mutex_);
    stopped_ = true;
    if (uploader_ != nullptr) uploader_->Stop();
    changed_.notify_all();
  }

 private:
  std::unique_ptr<uplink::LiveLink> ShowLive() const {
    const v1::CreateSessionRequest request = uplink::SessionRequest(config_.session, *replay_);
    uplink::LiveOptions options;
    options.token = server_.token;
    options.robot = request.robot();
    options.session = absl::StrCat(request.site(), "/sessions/", request.session_id());
    return std::make_unique<uplink::LiveLink>(
        options, [this] { return *uplink::OpenChannel(server_, /*own_connection=*/true); },
        uplink::RobotClocks{[] { return NowNs(CLOCK_BOOTTIME); },
                            [] { return NowNs(CLOCK_REALTIME); }},
        std::mt19937_64(std::random_device()()), Say);
  }

  absl::Status Record() {
    const auto begun = spool_->Begin(uplink::SessionRequest(config_.session, *replay_));
    if (!begun.ok()) return begun.status();
    std::int64_t recorded = begun->position;
    const auto show = [&](v1::DriveState state) {
      if (live_ != nullptr) live_->SetDrive(state, recorded);
    };
    if (begun->ended) {
      show(v1::DRIVE_STATE_RECORDED);
      return absl::OkStatus();
    }
    sources::SnappedSource source(replay_, config_.lidar_resolution_m);
    if (absl::Status found = source.Seek(begun->position); !found.ok()) return found;
    const auto start = steady_clock::now();
    std::optional<std::int64_t> start_ns;
    while (true) {
      auto frame = source.Next();
      if (!frame.ok()) return frame.status();
      if (!*frame) {
        show(v1::DRIVE_STATE_RECORDED);
        return spool_->End();
      }
      if (!start_ns) start_ns = (*frame)->log_time_ns;
      if (config_.speed > 0.0) {
        const double due_s =
            static_cast<double>((*frame)->log_time_ns - *start_ns) * 1e-9 / config_.speed;
        std::unique_lock lock(mutex_);
        changed_.wait_until(lock,
                            start + std::chrono::duration_cast<steady_clock::duration>(
                                        std::chrono::duration<double>(due_s)),
                            [this] { return stopped_; });
        if (stopped_) return absl::CancelledError("stopped");
      }
      if (live_ != nullptr) live_->Note(**frame);
      if (absl::Status kept = spool_->Append(**std::move(frame)); !kept.ok()) return kept;
      ++recorded;
      show(v1::DRIVE_STATE_RECORDING);
    }
  }

  void Deliver(const std::shared_ptr<grpc::Channel>& channel) {
    std::map<std::string, steady_clock::time_point> held_until;
    while (true) {
      bool waiting = false;
      for (const std::string& session : spool_->Waiting()) {
        waiting = true;
        if (const auto held = held_until.find(session);
            held != held_until.end() && steady_clock::now() < held->second) {
          continue;
        }
        const absl::Status delivered = DeliverSession(channel, session);
        if (delivered.ok()) continue;
        if (absl::IsCancelled(delivered)) break;
        Say(absl::StrCat("session ", session, ": ", std::string(delivered.message()),
                         "; trying again later"));
        held_until[session] = steady_clock::now() + kHold;
      }
      std::unique_lock lock(mutex_);
      if (stopped_ || (recorded_ && !waiting)) return;
      changed_.wait_for(lock, kLook, [this] { return stopped_; });
    }
  }

  absl::Status DeliverSession(const std::shared_ptr<grpc::Channel>& channel,
                              const std::string& session) {
    auto request = spool_->RequestOf(session);
    if (!request.ok()) return request.status();
    uplink::UploadOptions options;
    options.server = server_.address;
    options.token = server_.token;
    options.session = *std::move(request);
    options.coded = config_.coded;
    options.lidar_resolution_m = config_.lidar_resolution_m;
    options.give_up_after = kForEver;
    uplink::Uploader uploader(channel, options, &steady_clock::now,
                              std::mt19937_64(std::random_device()()));
    SetUploader(&uploader);
    const auto source = spool_->Read(session);
    std::string trouble;
    const auto result = uploader.Upload(*source, [&](const uplink::UploadProgress& progress) {
      spool_->Free(session, progress.watermarks.durable);
      if (progress.trouble.empty() == trouble.empty()) return;
      trouble = progress.trouble;
      Say(trouble.empty() ? "the server is there again" : trouble + "; trying again");
    });
    SetUploader(nullptr);
    if (!result.ok()) return result.status();
    if (absl::Status done = spool_->SetDelivered(session); !done.ok()) return done;
    std::printf("%s: %lld frames delivered\n", result->session.c_str(),
                static_cast<long long>(result->frame_count));
    std::fflush(stdout);
    return absl::OkStatus();
  }

  void SetUploader(uplink::Uploader* uploader) {
    std::lock_guard lock(mutex_);
    uploader_ = uploader;
    if (stopped_ && uploader != nullptr) uploader->Stop();
  }

  const RunConfig& config_;
  const uplink::ServerOptions server_;
  spool::Spool* const spool_;
  sources::Replay* const replay_;
  uplink::LiveLink* live_ = nullptr;  // while it runs, if it is wanted

  std::mutex mutex_;
  std::condition_variable changed_;
  // Guarded by mutex_.
  bool stopped_ = false;
  bool recorded_ = false;
  absl::Status record_status_;
  uplink::Uploader* uploader_ = nullptr;
};

}  // namespace

absl::Status RunAgent(const std::string& config_path) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  // Before any thread: they all inherit it.
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);

  const auto config = RunConfig::Read(config_path);
  if (!config.ok()) return config.status();
  auto server = ReadServerOptions(config->server);
  if (!server.ok()) return server.status();
  const auto replay = sources::Replay::Open(config->drive);
  if (!replay.ok()) return replay.status();
  const auto spool =
      spool::Spool::Open(config->spool_folder, config->spool, [] { return NowNs(CLOCK_REALTIME); });
  if (!spool.ok()) return spool.status();
  for (const std::string& warning : (*spool)->warnings()) Say("warning: " + warning);

  Agent agent(*config, *std::move(server), spool->get(), replay->get());
  std::atomic<bool> done = false;
  std::thread watch([&] {
    const timespec look{0, 100'000'000};
    while (!done) {
      if (sigtimedwait(&signals, nullptr, &look) > 0) agent.Stop();
    }
  });
  const absl::Status status = agent.Run();
  done = true;
  watch.join();
  return status.ok() ? (*replay)->survey().damage : status;
}

}  // namespace soundmap
