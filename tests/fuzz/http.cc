#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <boost/asio/thread_pool.hpp>
#include <csignal>

#include "absl/strings/escaping.h"
#include "api/token_file.h"
#include "tests/fuzz/target.h"
#include "tests/fuzz/temporary_folder.h"
#include "web_gateway/http_gateway.h"

namespace soundmap::fuzz {
namespace {

// The gateway as it listens in the server, on a port of its own.
class Gateway {
 public:
  Gateway() {
    const std::string tokens = (folder_.path() / "tokens.toml").string();
    WriteFile(tokens, "[[token]]\nname = \"a\"\nsha256 = \"" +
                          absl::BytesToHexString(api::Sha256("secret")) +
                          "\"\nrole = \"read\"\nsites = [\"*\"]\n");
    // A second goes by with every look at the clock, so that nobody comes too often.
    access_ = api::Access::Create({.token_file = tokens}, [this] {
                return now_ns_ += 1'000'000'000;
              }).value();
    gateway_ =
        web_gateway::HttpGateway::Start(pool_.get_executor(), "127.0.0.1:0", {},
                                        {[this] { return (now_ns_ & 1) == 0; },
                                         [] { return std::string("metrics\n"); }, access_.get()})
            .value();
    const std::string& address = gateway_->address();
    port_ = static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1)));
    // libFuzzer's alarm would interrupt what Ask() waits for; the gateway's thread takes it.
    sigset_t alarm;
    ::sigemptyset(&alarm);
    ::sigaddset(&alarm, SIGALRM);
    Require(::pthread_sigmask(SIG_BLOCK, &alarm, nullptr) == 0);
  }

  // What a connection gets that sends these bytes and closes its side.
  std::string Ask(std::string_view bytes) const {
    const int connection = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    Require(connection >= 0);
    sockaddr_in to = {};
    to.sin_family = AF_INET;
    to.sin_port = htons(port_);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    Require(::connect(connection, reinterpret_cast<const sockaddr*>(&to), sizeof(to)) == 0);
    // Longer than the gateway waits for the rest of a request that never comes.
    const timeval patience = {.tv_sec = 60, .tv_usec = 0};
    ::setsockopt(connection, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof(patience));
    while (!bytes.empty()) {
      const ssize_t sent = ::send(connection, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (sent <= 0) break;  // it has closed
      bytes.remove_prefix(static_cast<std::size_t>(sent));
    }
    ::shutdown(connection, SHUT_WR);
    std::string answer;
    char buffer[4096];
    ssize_t got = 0;
    while ((got = ::recv(connection, buffer, sizeof(buffer), 0)) > 0) {
      answer.append(buffer, static_cast<std::size_t>(got));
    }
    Require(got == 0 || errno == ECONNRESET || errno == EPIPE);
    ::close(connection);
    return answer;
  }

 private:
  const TemporaryFolder folder_;
  std::atomic<std::int64_t> now_ns_ = 1'000'000'000;
  boost::asio::thread_pool pool_{1};
  std::unique_ptr<api::Access> access_;
  std::unique_ptr<web_gateway::HttpGateway> gateway_;
  std::uint16_t port_ = 0;
};

}  // namespace

std::vector<std::string> Seeds() {
  return {"GET /livez HTTP/1.1\r\nHost: a\r\n\r\nHEAD /readyz HTTP/1.1\r\n\r\n",
          "GET /metrics HTTP/1.1\r\nAuthorization: Bearer secret\r\nConnection: close\r\n\r\n",
          "GET /metrics HTTP/1.0\r\nAuthorization: Basic c2VjcmV0\r\n\r\n",
          "POST /livez HTTP/1.1\r\nContent-Length: 4\r\n\r\nbodyGET /../x HTTP/1.1\r\n\r\n",
          "PUT /metrics HTTP/1.1\r\nTransfer-Encoding: chunked\r\nContent-Encoding: gzip\r\n\r\n"
          "5\r\nabcde\r\n0\r\nTrailer: t\r\n\r\n",
          "GET /readyz HTTP/1.1\r\nExpect: 100-continue\r\nUpgrade: h2c\r\n folded: x\r\n\r\n"};
}

void Decode(std::string_view bytes) {
  static const Gateway gateway;
  const std::string answer = gateway.Ask(bytes);
  Require(answer.empty() || answer.starts_with("HTTP/1."));
  // Without the token there are no figures to be had.
  if (bytes.find("secret") == bytes.npos) Require(answer.find("metrics\n") == answer.npos);
}

}  // namespace soundmap::fuzz
