#include "api/watch_service.h"

#include <algorithm>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <utility>
#include <variant>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "api/convert.h"
#include "api/find.h"
#include "api/resource_names.h"
#include "api/status.h"
#include "api/wake.h"

namespace soundmap::api {
namespace {

constexpr std::chrono::seconds kHeartbeat(10);
// What happens in this time goes to a watcher together: few writes to the network, and of a robot's
// states the newest.
constexpr std::chrono::milliseconds kGather(200);
constexpr std::int64_t kEventsPerPage = 256;

}  // namespace

// One watcher. It reads the site's ring of events at its own pace, at most five times a second, and
// holds a page of it at most.
class WatchService::Stream : public grpc::ServerWriteReactor<v1::WatchEvent>,
                             public std::enable_shared_from_this<WatchService::Stream> {
 public:
  Stream(const WatchService& service, Caller caller, std::shared_ptr<pipeline::Site> site,
         std::uint8_t band, const v1::WatchRequest& request)
      : executor_(service.executor_),
        access_(service.access_),
        caller_(std::move(caller)),
        token_prefix_(absl::StrCat(service.server_id_, ":")),
        site_(std::move(site)),
        site_name_(site_->record().site),
        band_(band),
        band_name_(request.band()),
        wants_all_(!request.sound_sources() && !request.robots() && !request.audio_scans()),
        wants_sources_(request.sound_sources()),
        wants_robots_(request.robots()),
        wants_scans_(request.audio_scans()),
        meters_(&service.sites_->meters()),
        heartbeat_(executor_) {
    ++meters_->watches;
  }

  void Start(const std::string& resume_token) {
    alive_ = shared_from_this();
    // With a first event that may wait for others to be sent, the metadata would wait, and the
    // others for it.
    StartSendInitialMetadata();
    absl::string_view position = resume_token;
    const bool ours = absl::ConsumePrefix(&position, token_prefix_) &&
                      absl::SimpleAtoi(position, &next_) &&
                      !site_->region().events().Read(next_, 0).lost;
    if (!ours) QueueSnapshot();
    subscription_ =
        site_->region().events().Subscribe(Wake(executor_, kGather, [weak = weak_from_this()] {
          if (const auto self = weak.lock()) self->Pump();
        }));
    Pump();
    std::lock_guard lock(mutex_);
    ArmHeartbeat();
  }

  void OnWriteDone(bool ok) override {
    std::lock_guard lock(mutex_);
    writing_ = false;
    if (!ok) End(grpc::Status(grpc::StatusCode::CANCELLED, "the watcher is gone"));
    if (end_status_) {
      FinishOnce();
    } else {
      WriteNext();
    }
  }
  void OnCancel() override {
    std::lock_guard lock(mutex_);
    End(grpc::Status(grpc::StatusCode::CANCELLED, "the watcher is gone"));
  }
  void OnDone() override {
    site_->region().events().Unsubscribe(subscription_);
    --meters_->watches;
    {
      std::lock_guard lock(mutex_);
      heartbeat_.cancel();
    }
    alive_.reset();
  }

 private:
  void QueueSnapshot() {
    next_ = site_->region().events().next();
    const auto sources = site_->region().sources(band_);
    for (const sound_map::RegisteredSource& source : sources->sources) {
      Queue(pipeline::SourceChanged{band_, source});
    }
    for (const pipeline::RobotInfo& robot : site_->Robots()) Queue(robot);
    v1::WatchEvent& complete = queue_.emplace_back();
    complete.mutable_snapshot_complete();
  }

  bool WantsSources(std::uint8_t band) const {
    return (wants_all_ || wants_sources_) && band == band_;
  }

  void Queue(const pipeline::Event& event) {
    v1::WatchEvent proto;
    if (const auto* changed = std::get_if<pipeline::SourceChanged>(&event)) {
      if (!WantsSources(changed->band)) return;
      *proto.mutable_sound_source() = ToProto(site_name_, band_name_, changed->source);
    } else if (const auto* happened = std::get_if<pipeline::SourceHappened>(&event)) {
      if (!WantsSources(happened->band)) return;
      *proto.mutable_sound_source_event() = ToProto(site_name_, band_name_, happened->event);
    } else if (const auto* removed = std::get_if<pipeline::SourceRemoved>(&event)) {
      if (!WantsSources(removed->band)) return;
      proto.set_removed_sound_source(
          SoundSourceResource(site_name_, SourceId(band_name_, removed->id)));
    } else if (const auto* robot = std::get_if<pipeline::RobotInfo>(&event)) {
      if (!wants_all_ && !wants_robots_) return;
      *proto.mutable_robot() = ToProto(*robot);
    } else if (const auto* scan = std::get_if<pipeline::AudioScanInfo>(&event)) {
      if ((!wants_all_ && !wants_scans_) || scan->band != band_) return;
      *proto.mutable_audio_scan() = ToProto(site_name_, band_name_, *scan);
    } else if (const auto* spoke = std::get_if<pipeline::LiveChanged>(&event)) {
      if (!wants_all_ && !wants_robots_) return;
      v1::LiveRobot& live = *proto.mutable_live_robot();
      live.set_robot(RobotResource(spoke->robot));
      if (const auto view = site_->live().Find(spoke->robot)) {
        *live.mutable_live() = ToProto(site_name_, *view);
        const auto& offset = view->report.clock_offset;
        if (offset) *live.mutable_clock_offset() = ToProto(*offset);
      }
    }
    queue_.push_back(std::move(proto));
  }

  void QueuePage(const std::vector<pipeline::Event>& events) {
    using Key = std::pair<std::size_t, std::string>;  // the kind of event and whose it is
    const auto key_of = [](const pipeline::Event& event) -> std::optional<Key> {
      if (const auto* robot = std::get_if<pipeline::RobotInfo>(&event)) {
        return Key(event.index(), robot->robot);
      }
      if (const auto* live = std::get_if<pipeline::LiveChanged>(&event)) {
        return Key(event.index(), live->robot);
      }
      return std::nullopt;
    };
    std::map<Key, const pipeline::Event*> newest;  // state of each robot
    for (const pipeline::Event& event : events) {
      if (const auto key = key_of(event)) newest[*key] = &event;
    }
    for (const pipeline::Event& event : events) {
      const auto key = key_of(event);
      if (!key || newest[*key] == &event) Queue(event);
    }
  }

  void Pump() {
    std::lock_guard lock(mutex_);
    end_ = site_->region().events().next();
    WriteNext();
  }

  // With mutex_ held.
  void WriteNext() {
    if (writing_ || end_status_) return;
    while (queue_.empty() && !resync_ && next_ < end_) {
      const auto batch = site_->region().events().Read(
          next_, static_cast<std::size_t>(std::min(kEventsPerPage, end_ - next_)));
      if (batch.lost) {
        resync_ = true;
        queue_.emplace_back().mutable_resync();
        break;
      }
      QueuePage(batch.events);
      next_ = batch.next;
    }
    if (queue_.empty() && std::exchange(heartbeat_due_, false)) {
      queue_.emplace_back().mutable_heartbeat();
    }
    if (queue_.empty()) {
      if (resync_) End(grpc::Status::OK);
      return;
    }
    event_ = std::move(queue_.front());
    queue_.pop_front();
    event_.set_revision(static_cast<std::int64_t>(site_->region().revision()));
    // In the middle of a page the token would skip the rest of it.
    if (queue_.empty()) event_.set_resume_token(absl::StrCat(token_prefix_, next_));
    writing_ = true;
    grpc::WriteOptions options;
    if (!queue_.empty()) options.set_buffer_hint();
    StartWrite(&event_, options);
  }

  // With mutex_ held.
  void ArmHeartbeat() {
    heartbeat_.expires_after(kHeartbeat);
    heartbeat_.async_wait([weak = weak_from_this()](boost::system::error_code cancelled) {
      const auto self = weak.lock();
      if (cancelled || !self) return;
      std::lock_guard lock(self->mutex_);
      self->heartbeat_due_ = true;
      const absl::Status granted = self->access_->Recheck(self->caller_);
      if (!granted.ok()) self->End(ToGrpcStatus(granted));
      self->WriteNext();
      if (!self->end_status_) self->ArmHeartbeat();
    });
  }
  void End(const grpc::Status& status) {
    if (!end_status_) end_status_ = status;
    if (!writing_) FinishOnce();
  }
  void FinishOnce() {
    if (!std::exchange(finished_, true)) Finish(*end_status_);
  }

  const boost::asio::any_io_executor executor_;
  Access* const access_;
  const Caller caller_;
  const std::string token_prefix_;
  const std::shared_ptr<pipeline::Site> site_;
  const std::string site_name_;
  const std::uint8_t band_;  // that is watched
  const std::string band_name_;
  const bool wants_all_;
  const bool wants_sources_;
  const bool wants_robots_;
  const bool wants_scans_;
  pipeline::Meters* const meters_;
  std::shared_ptr<Stream> alive_;
  int subscription_ = 0;

  std::mutex mutex_;
  // Guarded by mutex_.
  std::deque<v1::WatchEvent> queue_;
  std::int64_t next_ = 0;  // in the site's ring
  std::int64_t end_ = 0;   // what came later waits for the next page
  v1::WatchEvent event_;
  bool writing_ = false;
  bool resync_ = false;
  bool heartbeat_due_ = false;
  bool finished_ = false;
  std::optional<grpc::Status> end_status_;
  boost::asio::steady_timer heartbeat_;
};

grpc::ServerWriteReactor<v1::WatchEvent>* WatchService::Watch(grpc::CallbackServerContext* context,
                                                              const v1::WatchRequest* request) {
  auto caller = access_->CallerOf(*context);
  auto site = caller.ok() ? FindSite(*sites_, request->site(), Right::kRead, *access_, *caller)
                          : caller.status();
  const auto band = site.ok() ? (*site)->FindBand(request->band()) : site.status();
  if (!band.ok()) {
    class Refusal : public grpc::ServerWriteReactor<v1::WatchEvent> {
     public:
      explicit Refusal(const absl::Status& status) { Finish(ToGrpcStatus(status)); }
      void OnDone() override { delete this; }
    };
    return new Refusal(band.status());
  }
  auto stream =
      std::make_shared<Stream>(*this, *std::move(caller), *std::move(site), *band, *request);
  stream->Start(request->resume_token());
  return stream.get();
}

}  // namespace soundmap::api
