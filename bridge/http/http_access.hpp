// SPDX-License-Identifier: Apache-2.0
// Who may read what an HttpServer serves, decided from a request's texts alone. Pure; any thread.
#pragma once

#include <string>
#include <string_view>

namespace holdfast::bridge {

/// A request as far as access depends on it; absent headers are empty.
struct HttpAsking {
  std::string_view target;         ///< as in the request line: path and query
  std::string_view host;           ///< Host
  std::string_view cookie;         ///< Cookie
  std::string_view authorization;  ///< Authorization
};

enum class HttpAnswer {
  serve,
  set_cookie,  ///< the token stood in the address: keep it, and ask again without it
  unauthorised,
  wrong_host
};

/// True when a token is long enough and of the characters that need no quoting (HttpServer).
[[nodiscard]] bool is_usable_token(std::string_view token) noexcept;

/// `token` empty: whoever reaches the loopback interface may read.
[[nodiscard]] HttpAnswer access(const HttpAsking& asking, std::string_view token) noexcept;

/// The target without its query.
[[nodiscard]] std::string_view path_of(std::string_view target) noexcept;

/// The cookie that brings the token from now on.
[[nodiscard]] std::string token_cookie(std::string_view token);

}  // namespace holdfast::bridge
