#include "pipeline/sites.h"

#include <boost/asio/post.hpp>
#include <chrono>
#include <future>

#include "absl/strings/str_cat.h"
#include "storage/names.h"

namespace soundmap::pipeline {
namespace {

// How often watchers hear of changed sources.
constexpr std::chrono::seconds kSourceInterval(1);
// How often frames that are to be kept no longer are looked for.
constexpr std::chrono::seconds kDropInterval(10);

}  // namespace

Sites::Sites(storage::Store* store, Options options)
    : store_(store),
      options_(std::move(options)),
      timer_strand_(boost::asio::make_strand(options_.executor)),
      source_timer_(timer_strand_),
      drop_strand_(boost::asio::make_strand(SyncExecutor())) {}

boost::asio::any_io_executor Sites::SyncExecutor() const {
  return options_.sync_executor ? options_.sync_executor : options_.executor;
}

void Sites::WatchSources() {
  source_timer_.expires_after(kSourceInterval);
  source_timer_.async_wait([this](boost::system::error_code cancelled) {
    if (cancelled) return;
    StageClock clock(&meters().stages);
    clock.Start();
    for (const std::shared_ptr<Site>& site : List()) site->region().PublishSourceChanges();
    clock.Stop(Stage::kSources);
    const auto now = std::chrono::steady_clock::now();
    if (now - dropped_at_ >= kDropInterval) {
      dropped_at_ = now;
      boost::asio::post(drop_strand_, [this] {
        for (const std::shared_ptr<Site>& site : List()) site->DropOldFrames(options_.now_ns());
      });
    }
    WatchSources();
  });
}

absl::StatusOr<std::unique_ptr<Sites>> Sites::Open(storage::Store* store, Options options) {
  std::unique_ptr<Sites> sites(new Sites(store, std::move(options)));
  const auto records = store->ListRecords(storage::Table::kSite, "");
  if (!records.ok()) return records.status();
  for (const storage::Record& record : *records) {
    auto site_record = SiteRecordFromJson(record.bytes);
    if (!site_record.ok()) return site_record.status();
    auto site = Site::Open(*std::move(site_record), store, sites->options_.decode,
                           sites->options_.executor, &sites->meters());
    if (!site.ok()) {
      return absl::Status(
          site.status().code(),
          absl::StrCat("site '", record.key, "': ", std::string(site.status().message())));
    }
    sites->sites_[record.key] = *std::move(site);
  }
  storage::GroupCommitOptions commit_options;
  commit_options.on_sync = [meters = sites->options_.meters](std::chrono::nanoseconds cpu_time) {
    meters->stages.Add(Stage::kLog, cpu_time);
  };
  sites->group_commit_ = std::make_unique<storage::GroupCommit>(
      sites->SyncExecutor(), store,
      [sites = sites.get()](const storage::SessionId& id,
                            const absl::StatusOr<std::int64_t>& durable) {
        const auto site = sites->Get(id.site);
        if (!site.ok()) return;
        if (const auto session = (*site)->FindSession(id.session)) session->OnDurable(durable);
      },
      commit_options);
  for (const std::shared_ptr<Site>& site : sites->List()) {
    for (const std::shared_ptr<Session>& session : site->Sessions()) session->Resume();
  }
  boost::asio::post(sites->timer_strand_, [sites = sites.get()] { sites->WatchSources(); });
  return sites;
}

Sites::~Sites() { Stop(); }

absl::StatusOr<std::shared_ptr<Site>> Sites::Create(const std::string& name,
                                                    const std::string& profile_name,
                                                    const std::string& request_id,
                                                    const std::vector<Band>& bands) {
  const absl::Status valid = storage::ValidateName("site", name);
  if (!valid.ok()) return valid;
  const auto profile = options_.profile(profile_name.empty() ? "default" : profile_name);
  if (!profile.ok()) return profile.status();
  const absl::Status audible = ValidateBands(bands, *profile);
  if (!audible.ok()) return audible;
  std::lock_guard lock(mutex_);
  if (const auto known = sites_.find(name); known != sites_.end()) {
    if (!request_id.empty() && known->second->record().create_request_id == request_id &&
        known->second->bands() == bands) {
      return known->second;
    }
    return absl::AlreadyExistsError(absl::StrCat("site '", name, "' exists already"));
  }
  SiteRecord record;
  record.site = name;
  record.profile = profile->name;
  record.parameters_toml = ToToml(*profile);
  record.create_time_ns = options_.now_ns();
  record.create_request_id = request_id;
  record.bands = bands;
  const absl::Status stored = store_->PutRecord(storage::Table::kSite, name, ToJson(record));
  if (!stored.ok()) return stored;
  auto site = Site::Open(std::move(record), store_, options_.decode, options_.executor, &meters());
  if (!site.ok()) return site.status();
  sites_[name] = *site;
  return site;
}

absl::StatusOr<std::shared_ptr<Site>> Sites::Get(const std::string& name) const {
  std::lock_guard lock(mutex_);
  const auto found = sites_.find(name);
  if (found == sites_.end()) {
    return absl::NotFoundError(absl::StrCat("site '", name, "' does not exist"));
  }
  return found->second;
}

std::vector<std::shared_ptr<Site>> Sites::List() const {
  std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<Site>> sites;
  for (const auto& [name, site] : sites_) sites.push_back(site);
  return sites;
}

absl::Status Sites::Delete(const std::string& name) {
  std::shared_ptr<Site> site;
  {
    std::lock_guard lock(mutex_);
    const auto found = sites_.find(name);
    if (found == sites_.end()) {
      return absl::NotFoundError(absl::StrCat("site '", name, "' does not exist"));
    }
    for (const auto& session : found->second->Sessions()) {
      if (session->streaming()) {
        return absl::FailedPreconditionError(
            absl::StrCat("site '", name, "' cannot be deleted while robot '",
                         session->record().robot, "' is streaming to it"));
      }
    }
    site = found->second;
    sites_.erase(found);
  }
  site->Stop(/*checkpoint=*/false);
  return store_->DeleteSite(name);
}

void Sites::Stop() {
  if (group_commit_) group_commit_->Stop();
  for (const std::shared_ptr<Site>& site : List()) {
    for (const std::shared_ptr<Session>& session : site->Sessions()) session->AskToStop();
  }
  std::promise<void> timer_stopped;
  boost::asio::post(timer_strand_, [this, &timer_stopped] {
    source_timer_.cancel();
    timer_stopped.set_value();
  });
  timer_stopped.get_future().wait();
  std::promise<void> none_drops;
  boost::asio::post(drop_strand_, [&none_drops] { none_drops.set_value(); });
  none_drops.get_future().wait();
  for (const std::shared_ptr<Site>& site : List()) site->Stop(/*checkpoint=*/true);
}

}  // namespace soundmap::pipeline
