#include <google/protobuf/stubs/logging.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <boost/asio/signal_set.hpp>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <future>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "absl/strings/str_cat.h"
#include "api/access.h"
#include "api/decode_message.h"
#include "api/server.h"
#include "config.h"
#include "metrics.h"
#include "pipeline/content_check.h"
#include "pipeline/operations.h"
#include "pipeline/sites.h"
#include "storage/backup.h"
#include "storage/check.h"
#include "storage/store.h"
#include "web_gateway/http_gateway.h"

namespace soundmap {
namespace {

// As many logs are synced at a time: the disk takes them together.
constexpr int kLogThreads = 4;
constexpr int kIoThreads = 4;

std::int64_t NowNs() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

absl::Status Serve(const ServerConfig& config) {
  absl::Status checked = api::CheckTlsFiles(config.tls);
  if (!checked.ok()) return checked;
  api::Access::Options access_options = config.access;
  access_options.robots_by_certificate = !config.tls.client_ca.empty();
  auto access = api::Access::Create(access_options, NowNs);
  if (!access.ok()) return access.status();
  auto store = storage::Store::Open(config.data_dir);
  if (!store.ok()) return store.status();

  const unsigned cores = std::max(1u, std::thread::hardware_concurrency());
  boost::asio::thread_pool pool(config.threads > 0 ? config.threads : cores);
  // What waits for the disk and for peers, so that it never waits behind the work on frames; and
  // what robots wait for, so that it does not wait behind apps either.
  boost::asio::thread_pool io_pool(kIoThreads);
  boost::asio::thread_pool log_pool(kLogThreads);
  // Before any other thread exists in gRPC, so that the signals come here.
  boost::asio::signal_set signals(io_pool, SIGTERM, SIGINT);
  std::promise<int> stop;
  signals.async_wait([&stop](boost::system::error_code error, int signal) {
    if (!error) stop.set_value(signal);
  });

  pipeline::Sites::Options options;
  options.executor = pool.get_executor();
  options.decode = api::DecodeMessage;
  options.profile = [&config](const std::string& name) -> absl::StatusOr<pipeline::Profile> {
    const auto found = config.profiles.find(name);
    if (found == config.profiles.end()) return pipeline::ProfileByName(name);
    return found->second;
  };
  options.now_ns = NowNs;
  options.sync_executor = log_pool.get_executor();
  const std::shared_ptr<const pipeline::Meters> meters = options.meters;
  spdlog::info("recovering from {}", config.data_dir);
  auto sites = pipeline::Sites::Open(store->get(), std::move(options));
  if (!sites.ok()) return sites.status();

  std::atomic<bool> ready = false;
  {
    pipeline::Operations operations(NowNs, pool.get_executor());
    api::Server::Parts parts;
    parts.sites = sites->get();
    parts.operations = &operations;
    parts.access = access->get();
    parts.store = store->get();
    parts.executor = io_pool.get_executor();
    parts.now_ns = NowNs;
    parts.backup_dir = config.backup_dir;
    parts.server_id = absl::StrCat(absl::Hex(NowNs()));
    auto server = api::Server::Start(config.grpc_address, config.tls, parts);
    if (!server.ok()) return server.status();
    auto gateway = web_gateway::HttpGateway::Start(
        io_pool.get_executor(), config.http_address, config.tls,
        {[&ready] { return ready.load(); },
         [meters, access = access->get()] { return MetricsText(*meters, *access); },
         access->get()});
    if (!gateway.ok()) {
      (*server)->Shutdown();
      return gateway.status();
    }

    ready = true;
    std::cout << nlohmann::json{{"event", "ready"},
                                {"grpc", (*server)->address()},
                                {"http", (*gateway)->address()}}
                     .dump()
              << std::endl;
    spdlog::info("serving gRPC on {}, HTTP on {}", (*server)->address(), (*gateway)->address());

    const int signal = stop.get_future().get();
    spdlog::info("signal {}: stopping", signal);
    ready = false;
    (*server)->Shutdown();
  }
  (*sites)->Stop();
  sites->reset();
  pool.join();
  log_pool.join();
  io_pool.join();
  store->reset();
  spdlog::info("stopped");
  return absl::OkStatus();
}

// False: something is wrong, and said.
absl::StatusOr<bool> Check(const std::string& data_dir) {
  const auto check = storage::CheckData(data_dir, pipeline::MakeContentCheck());
  if (!check.ok()) return check.status();
  for (const std::string& remark : check->remarks) std::cout << "remark: " << remark << '\n';
  for (const std::string& fault : check->faults) std::cerr << "soundmap-server: " << fault << '\n';
  std::cout << absl::StrCat(data_dir, ": ", check->sites, " sites, ", check->sessions,
                            " sessions with ", check->segments, " segments of ", check->frames,
                            " frames, ", check->journal_entries, " journal entries, ", check->tiles,
                            " tiles: ", check->faults.empty() ? "no fault" : "damaged")
            << '\n';
  return check->faults.empty();
}

absl::StatusOr<bool> RestoreAndCheck(const std::string& backup, const std::string& data_dir) {
  const auto size = storage::Restore(backup, data_dir, [](double) { return true; });
  if (!size.ok()) return size.status();
  std::cout << absl::StrCat(size->files, " files with ", size->bytes, " bytes of ", backup,
                            " are as they were backed up")
            << '\n';
  return Check(data_dir);
}

int Main(int argc, char** argv) {
  ServerConfig config = DefaultServerConfig();
  std::string config_path;
  CLI::App app(
      "The sound map server: robots stream their sensors to it, apps ask it where the sound "
      "sources are.",
      "soundmap-server");
  // Flags are read into a configuration of their own first, since the file stands below them.
  ServerConfig flags;
  app.add_option("--config", config_path,
                 "TOML file with these settings and the profiles' parameters");
  auto* data_dir = app.add_option("--data-dir", flags.data_dir, "folder of the embedded store");
  auto* grpc =
      app.add_option("--grpc", flags.grpc_address, "gRPC address, HOST:PORT; port 0 for any")
          ->capture_default_str();
  auto* http =
      app.add_option("--http", flags.http_address, "HTTP address, HOST:PORT; port 0 for any")
          ->capture_default_str();
  auto* cert = app.add_option("--tls-cert", flags.tls.certificate, "the server's certificate, PEM");
  auto* key = app.add_option("--tls-key", flags.tls.key, "its private key, PEM");
  auto* client_ca = app.add_option("--tls-client-ca", flags.tls.client_ca,
                                   "who signs the robots' certificates, PEM");
  auto* tokens = app.add_option("--tokens", flags.access.token_file,
                                "TOML file with the tokens' hashes and what each may do");
  auto* audit_log = app.add_option("--audit-log", flags.access.audit_log,
                                   "file that says who changed what; default: standard error");
  auto* calls = app.add_option("--max-calls-per-s", flags.access.calls_per_s,
                               "how often one client may call, in the long run")
                    ->capture_default_str();
  auto* insecure =
      app.add_flag("--insecure", flags.insecure, "allow plain text beyond the loopback interface");
  auto* threads =
      app.add_option("--threads", flags.threads, "threads of the pipeline; 0: one a core");
  auto* log_level =
      app.add_option("--log-level", flags.log_level, "trace, debug, info, warning, error")
          ->capture_default_str();
  auto* backup_dir = app.add_option("--backup-dir", flags.backup_dir,
                                    "folder that takes the backups of `soundmap backup`");
  bool check_data = false;
  app.add_flag("--check", check_data,
               "read all of --data-dir, say what is damaged, and end; no server may use it");
  std::string restore_from;
  app.add_option("--restore", restore_from,
                 "make --data-dir, which must not exist, of this backup, check it, and end");
  std::string print_profile;
  app.add_option("--print-profile", print_profile,
                 "print the parameters of a profile as TOML, and end");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const auto fail = [](const absl::Status& status) {
    std::cerr << "soundmap-server: " << status.message() << '\n';
    return absl::IsInvalidArgument(status) ? 2 : 1;
  };
  if (!config_path.empty()) {
    const absl::Status read = config.ReadFile(config_path);
    if (!read.ok()) return fail(read);
  }
  if (*data_dir) config.data_dir = flags.data_dir;
  if (*grpc) config.grpc_address = flags.grpc_address;
  if (*http) config.http_address = flags.http_address;
  if (*cert) config.tls.certificate = flags.tls.certificate;
  if (*key) config.tls.key = flags.tls.key;
  if (*client_ca) config.tls.client_ca = flags.tls.client_ca;
  if (*tokens) config.access.token_file = flags.access.token_file;
  if (*audit_log) config.access.audit_log = flags.access.audit_log;
  if (*calls) config.access.calls_per_s = flags.access.calls_per_s;
  if (*backup_dir) config.backup_dir = flags.backup_dir;
  if (*insecure) config.insecure = flags.insecure;
  if (*threads) config.threads = flags.threads;
  if (*log_level) config.log_level = flags.log_level;
  if (!print_profile.empty()) {
    const auto profile = config.profiles.find(print_profile);
    if (profile == config.profiles.end()) {
      return fail(pipeline::ProfileByName(print_profile).status());
    }
    std::cout << pipeline::ToToml(profile->second);
    return 0;
  }
  const absl::Status valid = config.Validate();
  if (!valid.ok()) return fail(valid);
  if (check_data || !restore_from.empty()) {
    const auto whole = restore_from.empty() ? Check(config.data_dir)
                                            : RestoreAndCheck(restore_from, config.data_dir);
    if (!whole.ok()) return fail(whole.status());
    return *whole ? 0 : 1;
  }
  // gRPC has a line for every handshake that fails, protobuf for every text that is not UTF-8: a
  // log that strangers could fill.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  google::protobuf::SetLogHandler(nullptr);
  spdlog::set_default_logger(spdlog::stderr_color_mt("soundmap"));
  spdlog::set_level(spdlog::level::from_str(config.log_level));
  const absl::Status served = Serve(config);
  return served.ok() ? 0 : fail(served);
}

}  // namespace
}  // namespace soundmap

int main(int argc, char** argv) { return soundmap::Main(argc, argv); }
