#include "config.h"

#include <algorithm>
#include <filesystem>
#include <sstream>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "pipeline/toml.h"

namespace soundmap {
namespace {

bool IsLoopback(const std::string& address) {
  return absl::StartsWith(address, "127.") || absl::StartsWith(address, "localhost:") ||
         absl::StartsWith(address, "[::1]:");
}

}  // namespace

ServerConfig DefaultServerConfig() {
  ServerConfig config;
  for (const char* name : {"default", "paper"}) {
    config.profiles[name] = *pipeline::ProfileByName(name);
  }
  return config;
}

absl::Status ServerConfig::ReadFile(const std::string& path) {
  if (!std::filesystem::exists(path)) {
    return absl::NotFoundError(absl::StrCat("the configuration file ", path, " does not exist"));
  }
  toml::parse_result parsed = toml::parse_file(path);
  if (!parsed) {
    std::ostringstream what;
    what << parsed.error();
    return absl::InvalidArgumentError(absl::StrCat("the configuration file: ", what.str()));
  }
  const std::map<std::string, std::string*> texts = {{"data_dir", &data_dir},
                                                     {"grpc", &grpc_address},
                                                     {"http", &http_address},
                                                     {"tls_cert", &tls.certificate},
                                                     {"tls_key", &tls.key},
                                                     {"tls_client_ca", &tls.client_ca},
                                                     {"log_level", &log_level},
                                                     {"tokens", &access.token_file},
                                                     {"audit_log", &access.audit_log},
                                                     {"backup_dir", &backup_dir}};
  for (auto&& [key, node] : parsed.table()) {
    const std::string name(key.str());
    bool taken = false;
    if (const auto text = texts.find(name); text != texts.end()) {
      if (const auto value = node.value<std::string>()) {
        *text->second = *value;
        taken = true;
      }
    } else if (name == "insecure") {
      if (const auto value = node.value_exact<bool>()) {
        insecure = *value;
        taken = true;
      }
    } else if (name == "max_calls_per_s") {
      if (const auto value = node.value<double>(); value && node.is_number()) {
        access.calls_per_s = *value;
        taken = true;
      }
    } else if (name == "threads") {
      if (const auto value = node.value_exact<std::int64_t>()) {
        threads = static_cast<int>(std::clamp<std::int64_t>(*value, -1, 1 << 20));
        taken = true;
      }
    } else if (name == "profiles" && node.is_table()) {
      taken = true;
      for (auto&& [profile_key, sections] : *node.as_table()) {
        const std::string profile_name(profile_key.str());
        if (!sections.is_table()) {
          return absl::InvalidArgumentError(
              absl::StrCat(path, ": profiles.", profile_name, " is not a table"));
        }
        toml::table parameters = *sections.as_table();
        parameters.insert_or_assign("profile", profile_name);
        std::ostringstream text;
        text << parameters;
        auto profile = pipeline::ProfileFromToml(text.str());
        if (!profile.ok()) {
          return absl::InvalidArgumentError(absl::StrCat(path, ": profiles.", profile_name, ": ",
                                                         std::string(profile.status().message())));
        }
        profiles[profile_name] = *std::move(profile);
      }
    }
    if (!taken) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": '", name, "' is not a setting, or has a value of the wrong kind"));
    }
  }
  return absl::OkStatus();
}

absl::Status ServerConfig::Validate() const {
  if (data_dir.empty()) {
    return absl::InvalidArgumentError("the data directory is not given (--data-dir)");
  }
  if (tls.certificate.empty() != tls.key.empty()) {
    return absl::InvalidArgumentError("--tls-cert and --tls-key go together");
  }
  if (!tls.client_ca.empty() && tls.certificate.empty()) {
    return absl::InvalidArgumentError("--tls-client-ca needs --tls-cert and --tls-key");
  }
  if (tls.certificate.empty() && !insecure && !IsLoopback(grpc_address)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the gRPC address ", grpc_address,
        " is not loopback: give --tls-cert and --tls-key, or --insecure for plain text"));
  }
  if (tls.certificate.empty() && !insecure && !IsLoopback(http_address)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the HTTP address ", http_address,
        " is not loopback: give --tls-cert and --tls-key, or --insecure for plain text"));
  }
  if (access.token_file.empty() && tls.client_ca.empty() && !insecure &&
      !IsLoopback(grpc_address)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the gRPC address ", grpc_address,
        " is not loopback: give --tokens or --tls-client-ca, or --insecure to let anybody in"));
  }
  if (!(access.calls_per_s >= 1.0)) {
    return absl::InvalidArgumentError("max_calls_per_s must be 1 or more");
  }
  if (threads < 0 || threads > 1024) {
    return absl::InvalidArgumentError("threads must be from 0 to 1024");
  }
  return absl::OkStatus();
}

}  // namespace soundmap
