#include "cli/command_line.h"

#include "absl/strings/ascii.h"
#include "cli/text_file.h"

namespace soundmap::cli {
namespace {

constexpr std::int64_t kMaxTokenBytes = 1 << 16;
constexpr std::int64_t kMaxCertificateBytes = 4 << 20;

}  // namespace

absl::StatusOr<Client> CommandLine::Connect() const {
  ClientOptions options;
  options.server = server;
  // Somebody waits: a server that is away is said soon.
  options.retry.max_attempts = 3;
  options.retry.initial_backoff = std::chrono::milliseconds(100);
  if (!token_file.empty()) {
    auto token = ReadTextFile(token_file, kMaxTokenBytes);
    if (!token.ok()) return token.status();
    options.token = std::string(absl::StripAsciiWhitespace(*token));
    if (options.token.empty()) {
      return absl::InvalidArgumentError("the token file " + token_file + " is empty");
    }
  }
  if (!tls_ca.empty()) {
    auto pem = ReadTextFile(tls_ca, kMaxCertificateBytes);
    if (!pem.ok()) return pem.status();
    if (pem->empty() || !Client::Connect({.tls_ca_pem = *pem}).ok()) {
      return absl::InvalidArgumentError(tls_ca + " holds no certificate in PEM form");
    }
    options.tls_ca_pem = *std::move(pem);
  }
  return Client::Connect(options);
}

void AddGlobalOptions(CLI::App& app, CommandLine& line) {
  line.server = ClientOptions().server;
  app.add_option("--server", line.server, "address of the server, HOST:PORT")
      ->envname("SOUNDMAP_SERVER")
      ->check([](const std::string& server) {
        const auto client = Client::Connect({.server = server});
        return client.ok() ? std::string() : std::string(client.status().message());
      })
      ->capture_default_str();
  app.add_option("--token-file", line.token_file, "file with a bearer token");
  app.add_option(
      "--tls-ca", line.tls_ca,
      "file with the certificates to trust (PEM); without it the connection is plain text");
}

CLI::App* AddCommand(CLI::App& parent, const std::string& name, const std::string& description) {
  CLI::App* command = parent.add_subcommand(name, description);
  command->fallthrough();
  return command;
}

void RunWithClient(CLI::App& command, CommandLine& line,
                   std::function<absl::Status(Client&)> action) {
  command.callback([&line, action = std::move(action)] {
    line.run = [&line, action]() -> absl::Status {
      auto client = line.Connect();
      if (!client.ok()) return client.status();
      return action(*client);
    };
  });
}

void AddFormat(CLI::App& command, std::string& format, const std::vector<std::string>& formats) {
  format = formats.front();
  command.add_option("--format", format, "form of the output")
      ->check(CLI::IsMember(formats))
      ->capture_default_str();
}

void AddBand(CLI::App& command, std::string& band) {
  command.add_option("--band", band,
                     "of the sound map of this band of the site, instead of that of its profile");
}

}  // namespace soundmap::cli
