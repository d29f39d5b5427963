// SPDX-License-Identifier: Apache-2.0
#include "bridge/http/http_access.hpp"

#include <algorithm>

#include "bridge/http/http_server.hpp"

namespace holdfast::bridge {
namespace {

constexpr std::string_view kCookie = "holdfast_token=";
constexpr std::string_view kBearer = "Bearer ";
constexpr std::string_view kQuery = "token=";

/// In a time that does not depend on where the texts differ.
bool is_equal(std::string_view given, std::string_view wanted) noexcept {
  unsigned difference = given.size() == wanted.size() ? 0U : 1U;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const char c = i < given.size() ? given[i] : '\0';
    difference |= static_cast<unsigned>(c ^ wanted[i]);
  }
  return difference == 0;
}

/// The value of the first part of `list` that begins with `name`; parts end at `separator`, and a
/// space before them does not count.
std::string_view value_in(std::string_view list, std::string_view name, char separator) noexcept {
  while (!list.empty()) {
    const std::size_t end = std::min(list.find(separator), list.size());
    std::string_view part = list.substr(0, end);
    while (!part.empty() && part.front() == ' ') part.remove_prefix(1);
    if (part.starts_with(name)) return part.substr(name.size());
    list.remove_prefix(std::min(end + 1, list.size()));
  }
  return {};
}

std::string_view query_of(std::string_view target) noexcept {
  const std::size_t at = target.find('?');
  return at == std::string_view::npos ? std::string_view{} : target.substr(at + 1);
}

/// Whether a Host header names the loopback interface.
bool is_loopback_host(std::string_view host) noexcept {
  const std::string_view names[] = {"127.0.0.1", "localhost", "[::1]"};
  return std::any_of(std::begin(names), std::end(names), [host](std::string_view name) {
    return host.starts_with(name) && (host.size() == name.size() || host[name.size()] == ':');
  });
}

}  // namespace

bool is_usable_token(std::string_view token) noexcept {
  return token.size() >= kTokenLengthMin && std::all_of(token.begin(), token.end(), [](char c) {
           return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                  c == '-' || c == '_';
         });
}

HttpAnswer access(const HttpAsking& asking, std::string_view token) noexcept {
  if (token.empty())
    return is_loopback_host(asking.host) ? HttpAnswer::serve : HttpAnswer::wrong_host;
  if (is_equal(value_in(asking.cookie, kCookie, ';'), token)) return HttpAnswer::serve;
  if (asking.authorization.starts_with(kBearer) &&
      is_equal(asking.authorization.substr(kBearer.size()), token))
    return HttpAnswer::serve;
  if (is_equal(value_in(query_of(asking.target), kQuery, '&'), token))
    return HttpAnswer::set_cookie;
  return HttpAnswer::unauthorised;
}

std::string_view path_of(std::string_view target) noexcept {
  return target.substr(0, target.find('?'));
}

std::string token_cookie(std::string_view token) {
  return std::string{kCookie} + std::string{token} + "; Path=/; HttpOnly; SameSite=Strict";
}

}  // namespace holdfast::bridge
