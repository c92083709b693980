#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <utility>

#include "config.h"

namespace soundmap {
namespace {

using ::testing::HasSubstr;

absl::Status Read(const std::string& text, ServerConfig& config) {
  const std::string path = ::testing::TempDir() + "/server.toml";
  std::ofstream(path) << text;
  return config.ReadFile(path);
}

TEST(ServerConfig, AFileSaysWhatFlagsSay) {
  ServerConfig config = DefaultServerConfig();
  ASSERT_EQ(
      Read("data_dir = 'd'\ngrpc = '0.0.0.0:1'\nhttp = '0.0.0.0:2'\ntls_cert = 'c'\ntls_key = 'k'\n"
           "tls_client_ca = 'a'\nlog_level = 'warn'\ntokens = 't'\naudit_log = 'l'\nbackup_dir = "
           "'b'\n"
           "insecure = true\nmax_calls_per_s = 12\nthreads = 3\n"
           "[profiles.default.acoustics]\nf_min_hz = 700.0\n",
           config),
      absl::OkStatus());
  EXPECT_EQ(config.data_dir, "d");
  EXPECT_EQ(config.grpc_address, "0.0.0.0:1");
  EXPECT_EQ(config.http_address, "0.0.0.0:2");
  EXPECT_EQ(config.tls.certificate, "c");
  EXPECT_EQ(config.tls.key, "k");
  EXPECT_EQ(config.tls.client_ca, "a");
  EXPECT_EQ(config.log_level, "warn");
  EXPECT_EQ(config.access.token_file, "t");
  EXPECT_EQ(config.access.audit_log, "l");
  EXPECT_EQ(config.backup_dir, "b");
  EXPECT_TRUE(config.insecure);
  EXPECT_EQ(config.access.calls_per_s, 12.0);
  EXPECT_EQ(config.threads, 3);
  EXPECT_EQ(config.profiles.at("default").acoustics.f_min_hz, 700.0);
  EXPECT_NE(config.profiles.at("paper").acoustics.f_min_hz, 700.0);
  EXPECT_EQ(config.Validate(), absl::OkStatus());
}

TEST(ServerConfig, AMistakeInTheFileIsNamed) {
  for (const auto& [text, says] : {std::pair("dta_dir = 'd'", "'dta_dir'"),
                                   {"data_dir = 1", "'data_dir'"},
                                   {"insecure = 1", "'insecure'"},
                                   {"insecure = 'no'", "'insecure'"},
                                   {"max_calls_per_s = true", "'max_calls_per_s'"},
                                   {"threads = 1.5", "'threads'"},
                                   {"profiles = 1", "'profiles'"},
                                   {"[profiles]\ndefault = 1", "profiles.default"},
                                   {"[profiles.loud]", "loud"},
                                   {"[profiles.default.acoustics]\nf_min_hz = true", "f_min_hz"},
                                   {"data_dir = ", "server.toml"}}) {
    ServerConfig config = DefaultServerConfig();
    const absl::Status read = Read(text, config);
    EXPECT_EQ(read.code(), absl::StatusCode::kInvalidArgument) << text;
    EXPECT_THAT(std::string(read.message()), HasSubstr(says)) << text;
  }
  ServerConfig config;
  EXPECT_EQ(config.ReadFile("/no/such/file").code(), absl::StatusCode::kNotFound);
}

TEST(ServerConfig, NobodyIsLetInByMistake) {
  const std::string here = "127.0.0.1:0";
  const std::string everywhere = "0.0.0.0:7443";
  struct Case {
    std::string data_dir, grpc_address, http_address;
    api::TlsFiles tls;
    std::string token_file;
    bool insecure;
    const char* says;  // nothing: it is fine
  };
  const api::TlsFiles none, tls = {"cert", "key", ""}, mutual = {"cert", "key", "ca"};
  for (const Case& c : {Case{"data", here, here, none, "", false, ""},
                        {"data", "[::1]:0", "localhost:0", none, "", false, ""},
                        {"data", everywhere, everywhere, none, "", true, ""},
                        {"data", everywhere, everywhere, tls, "tokens", false, ""},
                        {"data", everywhere, everywhere, mutual, "", false, ""},
                        {"", here, here, none, "", false, "--data-dir"},
                        {"data", here, here, {"cert", "", ""}, "", false, "--tls-key"},
                        {"data", here, here, {"", "", "ca"}, "", false, "--tls-cert"},
                        {"data", everywhere, here, none, "tokens", false, "--insecure"},
                        {"data", here, "[::]:7480", none, "tokens", false, "--insecure"},
                        // TLS alone keeps nobody out.
                        {"data", everywhere, here, tls, "", false, "--tokens"}}) {
    ServerConfig config = DefaultServerConfig();
    config.data_dir = c.data_dir;
    config.grpc_address = c.grpc_address;
    config.http_address = c.http_address;
    config.tls = c.tls;
    config.access.token_file = c.token_file;
    config.insecure = c.insecure;
    const absl::Status valid = config.Validate();
    EXPECT_EQ(valid.ok(), *c.says == '\0') << valid;
    EXPECT_THAT(std::string(valid.message()), HasSubstr(c.says));
  }
}

}  // namespace
}  // namespace soundmap
