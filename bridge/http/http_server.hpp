// SPDX-License-Identifier: Apache-2.0
// A small read-only HTTP/1.1 server for pages of our own. Everything that comes in is hostile: only
// GET of a path that was added before, headers of a few kilobytes, no body, so many connections and
// so much patience. Nothing outside of what was added can be reached, and nothing can be changed.
//
// Who may read: without a token it listens on loopback only and answers only requests for a
// loopback host (a page elsewhere cannot reach it by naming itself so: DNS rebinding). With a token
// each request must bring it: once in the address (`/?token=...`, answered with a cookie and the
// address without it), then as the cookie; or as `Authorization: Bearer ...`.
//
// One thread: that of run().
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

namespace holdfast::bridge {

/// What a token must have at least: 24 of the characters A-Z a-z 0-9 - _ (as `openssl rand -hex 16`
/// makes 32).
inline constexpr std::size_t kTokenLengthMin = 24;

struct HttpParameters {
  std::string address = "127.0.0.1";    ///< IPv4 or IPv6, no name
  std::uint16_t port = 0;               ///< 0: the system chooses
  std::string token;                    ///< empty: loopback only
  std::string content_security_policy;  ///< sent with each answer
  std::size_t connections_max = 64;     ///< more are closed at once
  std::chrono::seconds patience{10};    ///< for a whole request, and for taking an answer
};

/// Throws InputError as HttpServer's constructor does; opens nothing.
void check_http(const HttpParameters& parameters);

using HttpBody = std::shared_ptr<const std::string>;

class HttpServer {
 public:
  /// Listens. Throws InputError on an address that is none, one beyond loopback without a token, or
  /// a token too short or of other characters; UnavailableError when the port cannot be had.
  explicit HttpServer(const HttpParameters& parameters);
  ~HttpServer();
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  /// Serves `body` at `path` ("/", "/page.js").
  void add(const std::string& path, std::string content_type, HttpBody body);
  /// Serves what `make` gives at each request; it must not be null.
  void add(const std::string& path, std::string content_type, std::function<HttpBody()> make);

  [[nodiscard]] std::uint16_t port() const noexcept;

  /// Serves and calls `tick` every `period`, until `tick` gives false.
  void run(std::chrono::nanoseconds period, const std::function<bool()>& tick);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::bridge
