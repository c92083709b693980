#include "web_gateway/http_gateway.h"

#include <spdlog/spdlog.h>

#include <array>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl.hpp>
#include <boost/asio/strand.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>
#include <chrono>
#include <filesystem>
#include <optional>
#include <type_traits>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace soundmap::web_gateway {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
using tcp = asio::ip::tcp;

constexpr std::uint64_t kMaxBodyBytes = 16 << 10;
constexpr std::chrono::seconds kRequestTimeout(30);
constexpr std::chrono::seconds kHandshakeTimeout(10);
constexpr std::chrono::seconds kLookEvery(1);
constexpr long kMaxConnections = 512;

using Source = HttpGateway::Source;

http::status HttpStatusOf(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kUnauthenticated:
      return http::status::unauthorized;
    case absl::StatusCode::kPermissionDenied:
      return http::status::forbidden;
    case absl::StatusCode::kResourceExhausted:
      return http::status::too_many_requests;
    default:
      return http::status::internal_server_error;
  }
}

template <typename Stream>
std::string PeerOf(const Stream& stream) {
  beast::error_code error;
  const auto peer = beast::get_lowest_layer(stream).socket().remote_endpoint(error);
  return error ? "" : peer.address().to_string();
}

http::response<http::string_body> Answer(const http::request<http::string_body>& request,
                                         const std::string& peer, const Source& source) {
  http::response<http::string_body> response(http::status::ok, request.version());
  response.set(http::field::content_type, "text/plain; charset=utf-8");
  response.keep_alive(request.keep_alive());
  const bool live = request.target() == "/livez";
  const bool ready = request.target() == "/readyz";
  const bool metrics = request.target() == "/metrics";
  if (!live && !ready && !metrics) {
    response.result(http::status::not_found);
    response.body() = "no such page\n";
  } else if (request.method() != http::verb::get && request.method() != http::verb::head) {
    response.result(http::status::method_not_allowed);
    response.set(http::field::allow, "GET, HEAD");
    response.body() = "only GET\n";
  } else if (metrics) {
    const std::string authorization(request[http::field::authorization]);
    const auto caller = source.access->CallerOf({.authorization = authorization, .peer = peer});
    if (caller.ok()) {
      response.set(http::field::content_type, "text/plain; version=0.0.4; charset=utf-8");
      response.body() = source.metrics();
    } else {
      response.result(HttpStatusOf(caller.status()));
      response.set(http::field::www_authenticate, "Bearer");
      response.body() = absl::StrCat(caller.status().message(), "\n");
    }
  } else if (ready && !source.is_ready()) {
    response.result(http::status::service_unavailable);
    response.body() = "not serving\n";
  } else {
    response.body() = "ok\n";
  }
  response.prepare_payload();
  if (request.method() == http::verb::head) response.body().clear();
  return response;
}

class StoppableConnection {
 public:
  virtual ~StoppableConnection() = default;
  // Closes it, whatever it is at. Any thread.
  virtual void Stop() = 0;
};

// One connection: the handshake, then requests one after the other until the peer closes or is too
// slow. `Stream` is a tcp_stream or an ssl_stream over one.
template <typename Stream>
class Connection : public StoppableConnection,
                   public std::enable_shared_from_this<Connection<Stream>> {
 public:
  template <typename... Tls>
  Connection(std::shared_ptr<const Source> source, tcp::socket socket, Tls&... tls)
      : source_(std::move(source)), stream_(std::move(socket), tls...) {}

  void Start() {
    if constexpr (std::is_same_v<Stream, beast::tcp_stream>) {
      Read();
    } else {
      beast::get_lowest_layer(stream_).expires_after(kHandshakeTimeout);
      stream_.async_handshake(asio::ssl::stream_base::server,
                              [self = this->shared_from_this()](beast::error_code error) {
                                if (!error) self->Read();
                              });
    }
  }

  void Stop() override {
    asio::post(stream_.get_executor(), [self = this->shared_from_this()] {
      beast::get_lowest_layer(self->stream_).close();
    });
  }

 private:
  void Read() {
    parser_.emplace();
    parser_->body_limit(kMaxBodyBytes);
    beast::get_lowest_layer(stream_).expires_after(kRequestTimeout);
    http::async_read(stream_, buffer_, *parser_,
                     [self = this->shared_from_this()](beast::error_code error, std::size_t) {
                       if (!error) self->Write();
                     });
  }
  void Write() {
    response_ = Answer(parser_->get(), PeerOf(stream_), *source_);
    http::async_write(stream_, response_,
                      [self = this->shared_from_this()](beast::error_code error, std::size_t) {
                        if (!error && self->response_.keep_alive()) self->Read();
                      });
  }

  const std::shared_ptr<const Source> source_;  // counts the connections, too
  Stream stream_;
  beast::flat_buffer buffer_{kMaxBodyBytes};
  std::optional<http::request_parser<http::string_body>> parser_;
  http::response<http::string_body> response_;
};

// What connections are accepted with; made anew when a file changes.
class TlsContext {
 public:
  explicit TlsContext(const api::TlsFiles& files) : files_(files) {}

  // InvalidArgument: as api::CheckTlsFiles() says; what was there before stays.
  absl::Status Refresh() {
    looked_ = std::chrono::steady_clock::now();
    const std::array<WriteTime, 2> written = {WrittenAt(files_.certificate), WrittenAt(files_.key)};
    if (context_ && written == written_) return absl::OkStatus();
    written_ = written;
    const absl::Status checked = api::CheckTlsFiles(files_);
    if (!checked.ok()) return checked;
    auto context = std::make_shared<asio::ssl::context>(asio::ssl::context::tls_server);
    beast::error_code error;
    SSL_CTX_set_min_proto_version(context->native_handle(), TLS1_3_VERSION);
    context->use_certificate_chain_file(files_.certificate, error);
    if (!error) context->use_private_key_file(files_.key, asio::ssl::context::pem, error);
    if (error) return absl::InvalidArgumentError(error.message());
    context_ = std::move(context);
    return absl::OkStatus();
  }

  asio::ssl::context& Get() {
    if (std::chrono::steady_clock::now() - looked_ >= kLookEvery) {
      const absl::Status refreshed = Refresh();
      if (!refreshed.ok()) {
        spdlog::error("{}; the certificate stays as it was", std::string(refreshed.message()));
      }
    }
    return *context_;
  }

 private:
  using WriteTime = std::filesystem::file_time_type;
  static WriteTime WrittenAt(const std::string& path) {
    std::error_code error;
    return std::filesystem::last_write_time(path, error);
  }

  const api::TlsFiles files_;
  std::shared_ptr<asio::ssl::context> context_;
  std::array<WriteTime, 2> written_;
  std::chrono::steady_clock::time_point looked_;
};

}  // namespace

class HttpGateway::Listener : public std::enable_shared_from_this<Listener> {
 public:
  Listener(const asio::any_io_executor& executor, Source source)
      : acceptor_(asio::make_strand(executor)),
        source_(std::make_shared<const Source>(std::move(source))) {}

  absl::Status UseTls(const api::TlsFiles& files) {
    return files.on() ? tls_.emplace(files).Refresh() : absl::OkStatus();
  }

  beast::error_code Open(const tcp::endpoint& endpoint) {
    beast::error_code error;
    acceptor_.open(endpoint.protocol(), error);
    if (!error) acceptor_.set_option(asio::socket_base::reuse_address(true), error);
    if (!error) acceptor_.bind(endpoint, error);
    if (!error) acceptor_.listen(asio::socket_base::max_listen_connections, error);
    return error;
  }
  std::uint16_t port() const { return acceptor_.local_endpoint().port(); }

  void Accept() {
    acceptor_.async_accept(
        asio::make_strand(acceptor_.get_executor()),
        [self = shared_from_this()](beast::error_code error, tcp::socket socket) {
          if (error == asio::error::operation_aborted) return;
          if (!error && self->source_.use_count() <= kMaxConnections) {
            self->Serve(std::move(socket));
          }
          self->Accept();
        });
  }

  void Stop() {
    asio::post(acceptor_.get_executor(), [self = shared_from_this()] {
      beast::error_code ignored;
      self->acceptor_.close(ignored);
      for (const auto& connection : self->connections_) {
        if (const auto open = connection.lock()) open->Stop();
      }
    });
  }

 private:
  void Serve(tcp::socket socket) {
    std::erase_if(connections_, [](const auto& connection) { return connection.expired(); });
    if (tls_) {
      Start(std::make_shared<Connection<beast::ssl_stream<beast::tcp_stream>>>(
          source_, std::move(socket), tls_->Get()));
    } else {
      Start(std::make_shared<Connection<beast::tcp_stream>>(source_, std::move(socket)));
    }
  }
  template <typename Connection>
  void Start(const std::shared_ptr<Connection>& connection) {
    connections_.push_back(connection);
    connection->Start();
  }

  tcp::acceptor acceptor_;
  const std::shared_ptr<const Source> source_;
  // On the acceptor's strand.
  std::optional<TlsContext> tls_;
  std::vector<std::weak_ptr<StoppableConnection>> connections_;
};

absl::StatusOr<std::unique_ptr<HttpGateway>> HttpGateway::Start(
    const asio::any_io_executor& executor, const std::string& address, const api::TlsFiles& tls,
    Source source) {
  const std::size_t colon = address.rfind(':');
  int port = -1;
  beast::error_code error;
  asio::ip::address host;
  if (colon != std::string::npos) {
    const std::string host_text = address.substr(0, colon);
    host = asio::ip::make_address(host_text == "localhost" ? "127.0.0.1" : host_text, error);
    if (!absl::SimpleAtoi(address.substr(colon + 1), &port)) port = -1;
  }
  if (colon == std::string::npos || error || port < 0 || port > 65535) {
    return absl::InvalidArgumentError(
        absl::StrCat("the HTTP address '", address, "' is not HOST:PORT with a numeric host"));
  }
  auto listener = std::make_shared<Listener>(executor, std::move(source));
  const absl::Status secured = listener->UseTls(tls);
  if (!secured.ok()) return secured;
  error = listener->Open({host, static_cast<std::uint16_t>(port)});
  if (error) {
    return absl::UnavailableError(
        absl::StrCat("cannot listen on the HTTP address ", address, ": ", error.message()));
  }
  listener->Accept();
  std::unique_ptr<HttpGateway> gateway(new HttpGateway);
  gateway->address_ = absl::StrCat(address.substr(0, colon), ":", listener->port());
  gateway->listener_ = std::move(listener);
  return gateway;
}

HttpGateway::~HttpGateway() { listener_->Stop(); }

}  // namespace soundmap::web_gateway
