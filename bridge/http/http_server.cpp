// SPDX-License-Identifier: Apache-2.0
#include "bridge/http/http_server.hpp"

#include <map>
#include <optional>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <fmt/format.h>

#include "bridge/http/http_access.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using asio::ip::tcp;
using boost::system::error_code;

constexpr std::uint32_t kHeaderBytesMax = 8192;
constexpr std::size_t kBufferBytesMax = 16384;
constexpr std::chrono::milliseconds kAcceptRetry{100};

struct Resource {
  std::string content_type;
  std::function<HttpBody()> make;
};

/// What all connections share.
struct Site {
  HttpParameters parameters;
  std::map<std::string, Resource, std::less<>> resources;
  std::size_t connections = 0;
};

std::string_view text(beast::string_view view) {
  return {view.data(), view.size()};
}

/// One connection: a request, its answer, the next request.
class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(tcp::socket&& socket, Site& site) : stream_(std::move(socket)), site_(site) {
    ++site_.connections;
  }
  ~Session() { --site_.connections; }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  void read() {
    parser_.emplace();
    parser_->header_limit(kHeaderBytesMax);
    parser_->body_limit(0);
    stream_.expires_after(site_.parameters.patience);
    http::async_read(
        stream_, buffer_, *parser_,
        [self = shared_from_this()](error_code error, std::size_t) { self->answer(error); });
  }

 private:
  using Request = http::request<http::empty_body>;

  void answer(error_code error) {
    if (error) {  // no request, or none that is HTTP with a small header and without a body
      const bool is_malformed =
          error.category() == http::make_error_code(http::error::bad_method).category() &&
          error != http::error::end_of_stream && error != http::error::partial_message;
      if (is_malformed) refuse(http::status::bad_request);
      return;  // dropping the last reference closes the connection
    }
    const Request& request = parser_->get();
    if (request.method() != http::verb::get) return refuse(http::status::method_not_allowed);
    const HttpAsking asking{text(request.target()), text(request[http::field::host]),
                            text(request[http::field::cookie]),
                            text(request[http::field::authorization])};
    switch (access(asking, site_.parameters.token)) {
      case HttpAnswer::serve:
        return serve(path_of(asking.target));
      case HttpAnswer::set_cookie:
        return redirect();
      case HttpAnswer::unauthorised:
        return refuse(http::status::unauthorized);
      case HttpAnswer::wrong_host:
        return refuse(http::status::misdirected_request);
    }
  }

  void serve(std::string_view path) {
    const auto found = site_.resources.find(path);
    if (found == site_.resources.end()) return refuse(http::status::not_found);
    start(http::status::ok, parser_->get().keep_alive());
    response_.set(http::field::content_type, found->second.content_type);
    send(found->second.make());
  }

  /// To the page, without what stood in the address: a token stays in no history.
  void redirect() {
    start(http::status::see_other, parser_->get().keep_alive());
    response_.set(http::field::location, "/");
    response_.set(http::field::set_cookie, token_cookie(site_.parameters.token));
    send(std::make_shared<const std::string>());
  }

  void refuse(http::status status) {
    start(status, false);
    response_.set(http::field::content_type, "text/plain; charset=utf-8");
    if (status == http::status::method_not_allowed) response_.set(http::field::allow, "GET");
    if (status == http::status::unauthorized)
      response_.set(http::field::www_authenticate, "Bearer");
    send(std::make_shared<const std::string>(fmt::format("{}\n", static_cast<unsigned>(status))));
  }

  void start(http::status status, bool is_kept_alive) {
    response_ = {};
    response_.version(11);
    response_.result(status);
    response_.keep_alive(is_kept_alive);
    response_.set(http::field::cache_control, "no-store");
    response_.set("Content-Security-Policy", site_.parameters.content_security_policy);
    response_.set("X-Content-Type-Options", "nosniff");
    response_.set("X-Frame-Options", "DENY");
    response_.set("Referrer-Policy", "no-referrer");
    response_.set("Cross-Origin-Resource-Policy", "same-origin");
    response_.set("Cross-Origin-Opener-Policy", "same-origin");
  }

  void send(HttpBody body) {
    body_ = std::move(body);
    response_.body() = boost::beast::span<const char>(body_->data(), body_->size());
    response_.prepare_payload();
    stream_.expires_after(site_.parameters.patience);
    http::async_write(stream_, response_,
                      [self = shared_from_this()](error_code error, std::size_t) {
                        if (!error && self->response_.keep_alive()) self->read();
                        if (!error && !self->response_.keep_alive()) self->close();
                      });
  }

  void close() {
    error_code ignored;  // the peer may be gone already
    stream_.socket().shutdown(tcp::socket::shutdown_send, ignored);
  }

  beast::tcp_stream stream_;
  Site& site_;
  beast::flat_buffer buffer_{kBufferBytesMax};
  std::optional<http::request_parser<http::empty_body>> parser_;
  HttpBody body_;  // what response_ refers to
  http::response<http::span_body<const char>> response_;
};

tcp::endpoint checked_endpoint(const HttpParameters& parameters) {
  error_code error;
  const auto address = asio::ip::make_address(parameters.address, error);
  if (error) throw InputError(fmt::format("http: '{}' is no IP address", parameters.address));
  if (parameters.token.empty() && !address.is_loopback())
    throw InputError(
        fmt::format("http: {} can be reached from outside: a token is needed", parameters.address));
  if (!parameters.token.empty() && !is_usable_token(parameters.token))
    throw InputError(fmt::format(
        "http: the token must have {} or more of the characters A-Z a-z 0-9 - _", kTokenLengthMin));
  return {address, parameters.port};
}

}  // namespace

void check_http(const HttpParameters& parameters) {
  (void)checked_endpoint(parameters);
}

struct HttpServer::Impl {
  explicit Impl(const HttpParameters& parameters)
      : site{parameters, {}, 0}, endpoint(checked_endpoint(parameters)), acceptor(io) {
    try {
      acceptor.open(endpoint.protocol());
      acceptor.set_option(tcp::acceptor::reuse_address(true));
      acceptor.bind(endpoint);
      acceptor.listen();
    } catch (const boost::system::system_error& e) {
      throw UnavailableError(fmt::format("http: cannot listen on {} port {}: {}",
                                         parameters.address, parameters.port, e.code().message()));
    }
  }

  void accept() {
    acceptor.async_accept([this](error_code error, tcp::socket socket) {
      if (error) {  // out of descriptors, for example: not at once again
        retry.expires_after(kAcceptRetry);
        retry.async_wait([this](error_code) { accept(); });
        return;
      }
      if (site.connections < site.parameters.connections_max)
        std::make_shared<Session>(std::move(socket), site)->read();
      accept();
    });
  }

  void wait(std::chrono::nanoseconds period, const std::function<bool()>& tick) {
    timer.expires_after(period);
    timer.async_wait([this, period, &tick](error_code) {
      if (tick())
        wait(period, tick);
      else
        io.stop();
    });
  }

  Site site;
  tcp::endpoint endpoint;
  asio::io_context io{1};
  tcp::acceptor acceptor;
  asio::steady_timer timer{io}, retry{io};
};

HttpServer::HttpServer(const HttpParameters& parameters)
    : impl_(std::make_unique<Impl>(parameters)) {}
HttpServer::~HttpServer() = default;

void HttpServer::add(const std::string& path, std::string content_type, HttpBody body) {
  add(path, std::move(content_type), [kept = std::move(body)] { return kept; });
}

void HttpServer::add(const std::string& path, std::string content_type,
                     std::function<HttpBody()> make) {
  impl_->site.resources[path] = {std::move(content_type), std::move(make)};
}

std::uint16_t HttpServer::port() const noexcept {
  error_code ignored;  // it listens: it has an end point
  return impl_->acceptor.local_endpoint(ignored).port();
}

void HttpServer::run(std::chrono::nanoseconds period, const std::function<bool()>& tick) {
  impl_->accept();
  impl_->wait(period, tick);
  impl_->io.run();
}

}  // namespace holdfast::bridge
