// crowd SERVER SITE SESSIONS WATCHERS: opens so many sessions whose robots send nothing and so many
// watches, each on a connection of its own, and keeps them until its standard input ends. Prints a
// JSON line when all are open, and one at the end.
#include <grpcpp/grpcpp.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <iostream>
#include <limits>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "soundmap/v1/ingest_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "soundmap/v1/watch_service.grpc.pb.h"

namespace {

using soundmap::v1::CreateSessionRequest;
using soundmap::v1::IngestRequest;
using soundmap::v1::IngestResponse;
using soundmap::v1::WatchEvent;
using soundmap::v1::WatchRequest;

// Counts of all calls; wakes who waits for them.
class Tally {
 public:
  void Opened() {
    Change([this] { ++opened_; });
  }
  void Ended(const grpc::Status& status) {
    Change([&] {
      ++ended_;
      if (status.error_code() != grpc::StatusCode::CANCELLED && error_.empty()) {
        error_ = status.error_message();
      }
    });
  }
  // False: some have ended before.
  bool AwaitOpened(int count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return opened_ >= count || ended_ > 0; });
    return ended_ == 0;
  }
  void AwaitEnded(int count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return ended_ >= count; });
  }
  int ended() const {
    const std::lock_guard lock(mutex_);
    return ended_;
  }
  std::string error() const {
    const std::lock_guard lock(mutex_);
    return error_;
  }

  std::atomic<std::int64_t> events = 0;
  std::atomic<std::int64_t> resyncs = 0;

 private:
  template <typename Work>
  void Change(const Work& work) {
    const std::lock_guard lock(mutex_);
    work();
    changed_.notify_all();
  }

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  int opened_ = 0;
  int ended_ = 0;
  std::string error_;
};

class IdleSession : public grpc::ClientBidiReactor<IngestRequest, IngestResponse> {
 public:
  IdleSession(const std::shared_ptr<grpc::Channel>& channel, const std::string& session,
              std::int64_t epoch, Tally* tally)
      : stub_(soundmap::v1::IngestService::NewStub(channel)), tally_(tally) {
    open_.mutable_open()->set_session(session);
    open_.mutable_open()->set_epoch(epoch);
    stub_->async()->Ingest(&context_, this);
    StartWrite(&open_);
    StartRead(&response_);
    StartCall();
  }
  void Cancel() { context_.TryCancel(); }
  void OnReadDone(bool ok) override {
    if (!ok) return;
    if (response_.has_welcome()) tally_->Opened();
    StartRead(&response_);
  }
  void OnDone(const grpc::Status& status) override { tally_->Ended(status); }

 private:
  const std::unique_ptr<soundmap::v1::IngestService::Stub> stub_;
  Tally* const tally_;
  grpc::ClientContext context_;
  IngestRequest open_;
  IngestResponse response_;
};

// An app that looks at the sources and robots of a site, and looks again when it is told to.
class Watcher {
 public:
  Watcher(const std::shared_ptr<grpc::Channel>& channel, const std::string& site, Tally* tally)
      : stub_(soundmap::v1::WatchService::NewStub(channel)), tally_(tally) {
    request_.set_site(site);
    request_.set_sound_sources(true);
    request_.set_robots(true);
    Begin();
  }
  void Cancel() {
    const std::lock_guard lock(mutex_);
    cancelled_ = true;
    if (call_ != nullptr) call_->context.TryCancel();
  }

 private:
  struct Call : grpc::ClientReadReactor<WatchEvent> {
    explicit Call(Watcher* owner) : watcher(owner) {
      watcher->stub_->async()->Watch(&context, &watcher->request_, this);
      StartRead(&event);
      StartCall();
    }
    void OnReadDone(bool ok) override {
      if (!ok) return;
      Tally* const tally = watcher->tally_;
      ++tally->events;
      if (event.has_snapshot_complete() && !std::exchange(watcher->opened_, true)) tally->Opened();
      resync |= event.has_resync();
      StartRead(&event);
    }
    void OnDone(const grpc::Status& status) override {
      watcher->Ended(status.ok() && resync, status);
      delete this;
    }

    Watcher* const watcher;
    grpc::ClientContext context;
    WatchEvent event;
    bool resync = false;
  };

  void Begin() {
    const std::lock_guard lock(mutex_);
    call_ = new Call(this);  // deletes itself
  }
  void Ended(bool resync, const grpc::Status& status) {
    {
      const std::lock_guard lock(mutex_);
      call_ = nullptr;
      resync &= !cancelled_;
    }
    if (resync) {
      ++tally_->resyncs;
      Begin();
    } else {
      tally_->Ended(status);
    }
  }

  const std::unique_ptr<soundmap::v1::WatchService::Stub> stub_;
  Tally* const tally_;
  WatchRequest request_;
  bool opened_ = false;
  std::mutex mutex_;
  bool cancelled_ = false;  // guarded by mutex_
  Call* call_ = nullptr;    // guarded by mutex_
};

std::shared_ptr<grpc::Channel> Connect(const std::string& server) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // a connection of its own
  return grpc::CreateCustomChannel(server, grpc::InsecureChannelCredentials(), arguments);
}

int Fail(const std::string& what) {
  std::cerr << "crowd: " << what << '\n';
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  int session_count = 0;
  int watcher_count = 0;
  if (argc != 5 || !absl::SimpleAtoi(argv[3], &session_count) ||
      !absl::SimpleAtoi(argv[4], &watcher_count)) {
    return Fail("usage: crowd SERVER SITE SESSIONS WATCHERS");
  }
  const std::string server = argv[1];
  const std::string site = absl::StrCat("sites/", argv[2]);
  Tally tally;
  std::vector<std::unique_ptr<IdleSession>> sessions;
  for (int i = 0; i < session_count; ++i) {
    const auto channel = Connect(server);
    CreateSessionRequest request;
    request.set_site(site);
    request.set_session_id(absl::StrCat("idle", i));
    request.set_robot(absl::StrCat("robots/idle", i));
    request.set_purpose(soundmap::v1::PURPOSE_LISTENING);
    soundmap::v1::Session session;
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    const grpc::Status made =
        soundmap::v1::SessionService::NewStub(channel)->CreateSession(&context, request, &session);
    if (!made.ok()) return Fail(made.error_message());
    sessions.push_back(
        std::make_unique<IdleSession>(channel, session.name(), session.epoch(), &tally));
  }
  std::vector<std::unique_ptr<Watcher>> watchers;
  for (int i = 0; i < watcher_count; ++i) {
    watchers.push_back(std::make_unique<Watcher>(Connect(server), site, &tally));
  }
  const int all = session_count + watcher_count;
  const bool open = tally.AwaitOpened(all);
  if (open) {
    std::cout << nlohmann::json{{"event", "ready"}} << std::endl;
    std::cin.ignore(std::numeric_limits<std::streamsize>::max());
  }
  const int ended = tally.ended();
  for (const auto& session : sessions) session->Cancel();
  for (const auto& watcher : watchers) watcher->Cancel();
  tally.AwaitEnded(all);
  std::cout << nlohmann::json{{"event", "end"},
                              {"ended_early", ended},
                              {"events", tally.events.load()},
                              {"resyncs", tally.resyncs.load()},
                              {"error", tally.error()}}
            << std::endl;
  return open && ended == 0 ? 0 : 1;
}
