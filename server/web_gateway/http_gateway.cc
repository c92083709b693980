#include "web_gateway/http_gateway.h"

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/strand.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <chrono>

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

using Source = HttpGateway::Source;

http::response<http::string_body> Answer(const http::request<http::string_body>& request,
                                         const Source& source) {
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
    response.set(http::field::content_type, "text/plain; version=0.0.4; charset=utf-8");
    response.body() = source.metrics();
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

// One connection: requests one after the other until the peer closes or is too slow.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(tcp::socket socket, Source source)
      : stream_(std::move(socket)), source_(std::move(source)) {}

  void Read() {
    parser_.emplace();
    parser_->body_limit(kMaxBodyBytes);
    stream_.expires_after(kRequestTimeout);
    http::async_read(stream_, buffer_, *parser_,
                     [self = shared_from_this()](beast::error_code error, std::size_t) {
                       if (!error) self->Write();
                     });
  }

 private:
  void Write() {
    response_ = Answer(parser_->get(), source_);
    http::async_write(stream_, response_,
                      [self = shared_from_this()](beast::error_code error, std::size_t) {
                        if (!error && self->response_.keep_alive()) self->Read();
                      });
  }

  beast::tcp_stream stream_;
  const Source source_;
  beast::flat_buffer buffer_{kMaxBodyBytes};
  std::optional<http::request_parser<http::string_body>> parser_;
  http::response<http::string_body> response_;
};

}  // namespace

class HttpGateway::Listener : public std::enable_shared_from_this<Listener> {
 public:
  Listener(const asio::any_io_executor& executor, Source source)
      : acceptor_(asio::make_strand(executor)), source_(std::move(source)) {}

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
          if (!error) std::make_shared<Connection>(std::move(socket), self->source_)->Read();
          self->Accept();
        });
  }

  void Stop() {
    asio::post(acceptor_.get_executor(), [self = shared_from_this()] {
      beast::error_code ignored;
      self->acceptor_.close(ignored);
    });
  }

 private:
  tcp::acceptor acceptor_;
  const Source source_;
};

absl::StatusOr<std::unique_ptr<HttpGateway>> HttpGateway::Start(
    const asio::any_io_executor& executor, const std::string& address, Source source) {
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
