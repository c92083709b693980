#include "api/access.h"

#include <spdlog/sinks/basic_file_sink.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "absl/time/time.h"
#include "storage/files.h"

namespace soundmap::api {
namespace {

constexpr std::int64_t kLookEvery_ns = 1'000'000'000;
constexpr double kFailuresPerS = 10.0;
constexpr char kNobody[] = "nobody";

// Differs when the file was written or replaced.
std::string StampOf(const std::string& path) {
  struct stat file = {};
  if (::stat(path.c_str(), &file) != 0) return "";
  return absl::StrCat(file.st_ino, ":", file.st_size, ":", file.st_mtim.tv_sec, ":",
                      file.st_mtim.tv_nsec);
}

absl::StatusOr<TokenFile> ReadTokens(const std::string& path) {
  const auto text = storage::ReadSmallFile(path);
  if (!text.ok()) return text.status();
  return TokenFile::Parse(*text, path);
}

std::string AddressOf(const std::string& peer) { return peer.substr(0, peer.rfind(':')); }

Access::Shown ShownBy(const grpc::CallbackServerContext& context) {
  Access::Shown shown;
  shown.peer = AddressOf(context.peer());
  const auto& metadata = context.client_metadata();
  if (const auto found = metadata.find("authorization"); found != metadata.end()) {
    shown.authorization.assign(found->second.data(), found->second.size());
  }
  const auto connection = context.auth_context();
  if (connection && connection->IsPeerAuthenticated()) {
    for (const grpc::string_ref& uri : connection->FindPropertyValues(GRPC_PEER_URI_PROPERTY_NAME))
      shown.certificate_uris.emplace_back(uri.data(), uri.size());
  }
  return shown;
}

}  // namespace

Access::Access(const Options& options, std::function<std::int64_t()> now_ns)
    : options_(options),
      now_ns_(std::move(now_ns)),
      calls_(options.calls_per_s),
      failures_(kFailuresPerS) {}

absl::StatusOr<std::unique_ptr<Access>> Access::Create(const Options& options,
                                                       std::function<std::int64_t()> now_ns) {
  std::unique_ptr<Access> access(new Access(options, std::move(now_ns)));
  if (!options.token_file.empty()) {
    access->token_stamp_ = StampOf(options.token_file);
    auto tokens = ReadTokens(options.token_file);
    if (!tokens.ok()) return tokens.status();
    access->tokens_ = std::make_shared<const TokenFile>(*std::move(tokens));
    access->looked_ns_ = access->now_ns_();
  }
  spdlog::sink_ptr sink;
  if (options.audit_log.empty()) {
    sink = std::make_shared<spdlog::sinks::stderr_sink_mt>();
  } else {
    try {
      sink = std::make_shared<spdlog::sinks::basic_file_sink_mt>(options.audit_log);
    } catch (const spdlog::spdlog_ex&) {
      return absl::UnavailableError(absl::StrCat("cannot write the audit log ", options.audit_log));
    }
  }
  access->audit_ = std::make_shared<spdlog::logger>("audit", sink);
  access->audit_->set_pattern("%v");
  access->audit_->flush_on(spdlog::level::info);
  return access;
}

std::shared_ptr<const TokenFile> Access::Tokens() {
  const std::int64_t now_ns = now_ns_();
  const std::lock_guard lock(mutex_);
  if (now_ns - looked_ns_ < kLookEvery_ns && now_ns >= looked_ns_) return tokens_;
  looked_ns_ = now_ns;
  std::string stamp = StampOf(options_.token_file);
  if (stamp == token_stamp_) return tokens_;
  token_stamp_ = std::move(stamp);
  auto tokens = ReadTokens(options_.token_file);
  if (tokens.ok()) {
    tokens_ = std::make_shared<const TokenFile>(*std::move(tokens));
    spdlog::info("the token file {} was read again", options_.token_file);
  } else {
    spdlog::error("{}; the tokens stay as they were", std::string(tokens.status().message()));
  }
  return tokens_;
}

absl::StatusOr<Caller> Access::Identify(const Shown& shown) {
  Caller caller;
  caller.peer = shown.peer;
  if (options_.token_file.empty() && !options_.robots_by_certificate) {
    caller.grant.who = "anybody";
    caller.grant.right = Right::kAdmin;
    caller.grant.all_sites = true;
    return caller;
  }
  const auto tokens = options_.token_file.empty() ? nullptr : Tokens();
  if (!shown.authorization.empty()) {
    absl::string_view token = shown.authorization;
    if (!absl::StartsWithIgnoreCase(token, "bearer ")) {
      return absl::UnauthenticatedError("the authorization is not of the form Bearer TOKEN");
    }
    token.remove_prefix(7);
    caller.token_sha256 = Sha256(std::string(token));
    const Grant* const grant = tokens ? tokens->Find(caller.token_sha256) : nullptr;
    if (grant == nullptr) return absl::UnauthenticatedError("the token is not known");
    caller.grant = *grant;
  } else if (options_.robots_by_certificate && !shown.certificate_uris.empty()) {
    auto grant = GrantFromCertificate(shown.certificate_uris);
    if (!grant.ok()) return grant.status();
    caller.grant = *std::move(grant);
    if (tokens && tokens->Refuses(caller.grant.robot)) {
      return absl::UnauthenticatedError(
          absl::StrCat("the certificate of ", caller.grant.who, " is believed no more"));
    }
  } else {
    return absl::UnauthenticatedError(options_.robots_by_certificate
                                          ? "neither a token nor a robot's certificate was shown"
                                          : "no token was shown");
  }
  if (caller.grant.expires_ns <= now_ns_()) {
    return absl::UnauthenticatedError(absl::StrCat(caller.grant.who, " has expired"));
  }
  return caller;
}

absl::Status Access::Count(const absl::Status& status) {
  if (absl::IsUnauthenticated(status)) {
    ++refusals_[static_cast<std::size_t>(Refusal::kUnauthenticated)];
  } else if (absl::IsPermissionDenied(status)) {
    ++refusals_[static_cast<std::size_t>(Refusal::kDenied)];
  } else if (absl::IsResourceExhausted(status)) {
    ++refusals_[static_cast<std::size_t>(Refusal::kTooOften)];
  }
  return status;
}

absl::StatusOr<Caller> Access::CallerOf(const Shown& shown) {
  auto caller = Identify(shown);
  if (options_.token_file.empty() && !options_.robots_by_certificate) return caller;
  if (!caller.ok()) {
    if (failures_.Take(shown.peer, now_ns_())) return Count(caller.status());
    return Count(
        absl::ResourceExhaustedError(absl::StrCat(shown.peer, " shows bad credentials too often")));
  }
  if (!calls_.Take(caller->grant.who, now_ns_())) {
    return Count(absl::ResourceExhaustedError(absl::StrCat(
        caller->grant.who, " calls more often than ", options_.calls_per_s, " times a second")));
  }
  return caller;
}

absl::StatusOr<Caller> Access::CallerOf(const grpc::CallbackServerContext& context) {
  return CallerOf(ShownBy(context));
}

absl::StatusOr<Caller> Access::Check(const grpc::CallbackServerContext& context, Right right,
                                     const std::string& site, const std::string& robot) {
  auto caller = CallerOf(context);
  if (!caller.ok()) return caller;
  const absl::Status checked = Check(*caller, right, site, robot);
  if (!checked.ok()) return checked;
  return caller;
}

absl::Status Access::Check(const Caller& caller, Right right, const std::string& site,
                           const std::string& robot) {
  return Count(caller.grant.Check(right, site, robot));
}

absl::Status Access::Recheck(const Caller& caller) {
  if (options_.token_file.empty()) return absl::OkStatus();
  const auto tokens = Tokens();
  bool holds = caller.grant.expires_ns > now_ns_();
  if (!caller.token_sha256.empty()) {
    const Grant* const grant = tokens->Find(caller.token_sha256);
    holds = holds && grant != nullptr && grant->right == caller.grant.right &&
            grant->all_sites == caller.grant.all_sites && grant->sites == caller.grant.sites &&
            grant->robot == caller.grant.robot;
  } else {
    holds = holds && !tokens->Refuses(caller.grant.robot);
  }
  if (holds) return absl::OkStatus();
  return Count(absl::UnauthenticatedError(
      absl::StrCat("what ", caller.grant.who, " was granted has ended")));
}

absl::Status Access::Audit(const grpc::CallbackServerContext& context, const char* deed,
                           const std::string& what, const absl::Status& result) {
  const Shown shown = ShownBy(context);
  const auto caller = Identify(shown);
  nlohmann::ordered_json line = {
      {"event", "audit"},
      {"time", absl::FormatTime("%Y-%m-%dT%H:%M:%E3SZ", absl::FromUnixNanos(now_ns_()),
                                absl::UTCTimeZone())},
      {"who", caller.ok() ? caller->grant.who : kNobody},
      {"peer", shown.peer},
      {"deed", deed},
      {"what", what},
      {"result", absl::StatusCodeToString(result.code())}};
  if (!result.ok()) line["error"] = std::string(result.message());
  audit_->info(line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  return result;
}

}  // namespace soundmap::api
