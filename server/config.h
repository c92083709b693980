#pragma once

#include <map>
#include <string>

#include "absl/status/statusor.h"
#include "api/access.h"
#include "api/tls.h"
#include "pipeline/profile.h"

namespace soundmap {

// What a server is started with: flags over the configuration file over these defaults.
struct ServerConfig {
  std::string data_dir;
  std::string grpc_address = "127.0.0.1:7443";
  std::string http_address = "127.0.0.1:7480";
  api::TlsFiles tls;
  api::Access::Options access;
  bool insecure = false;   // plain text beyond the loopback interface
  std::string backup_dir;  // takes backups; empty: none are made
  int threads = 0;         // of the pipeline; 0: one a core
  std::string log_level = "info";
  // By name; sites keep the parameters that they were created with.
  std::map<std::string, pipeline::Profile> profiles;

  // Sets what the TOML file says: top-level keys named as the flags with '_' for '-', and tables
  // [profiles.NAME.SECTION] with parameters that differ from the profile's own. NotFound;
  // InvalidArgument, naming the key.
  absl::Status ReadFile(const std::string& path);

  // InvalidArgument with a sentence that names the setting.
  absl::Status Validate() const;
};

// With the two profiles as they are.
ServerConfig DefaultServerConfig();

}  // namespace soundmap
