// SPDX-License-Identifier: Apache-2.0
#include "bridge/http/http_access.hpp"

#include <gtest/gtest.h>

#include "bridge/http/http_server.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

constexpr std::string_view kToken = "0123456789abcdef01234567";

TEST(HttpAccess, OnLoopbackServesOnlyWhoAsksForALoopbackHost) {
  RecordProperty("requirement", "SR-132");
  for (const char* host : {"127.0.0.1", "127.0.0.1:8080", "localhost:1", "[::1]:9"})
    EXPECT_EQ(access({"/", host, "", ""}, ""), HttpAnswer::serve) << host;
  for (const char* host :
       {"", "evil.example", "localhost.evil.example", "127.0.0.1.evil", "10.0.0.1"})
    EXPECT_EQ(access({"/", host, "", ""}, ""), HttpAnswer::wrong_host) << host;
}

TEST(HttpAccess, WithATokenServesOnlyWhoBringsIt) {
  RecordProperty("requirement", "SR-132");
  const std::string good(kToken), cookie = "a=b; holdfast_token=" + good, bearer = "Bearer " + good;
  EXPECT_EQ(access({"/state", "x", cookie, ""}, kToken), HttpAnswer::serve);
  EXPECT_EQ(access({"/state", "x", "", bearer}, kToken), HttpAnswer::serve);
  EXPECT_EQ(access({"/?token=" + good, "x", "", ""}, kToken), HttpAnswer::set_cookie);
  EXPECT_EQ(access({"/?a=1&token=" + good, "x", "", ""}, kToken), HttpAnswer::set_cookie);
  for (const std::string& wrong :
       {std::string(), good.substr(1), good + "0", good.substr(0, good.size() - 1),
        std::string("0123456789abcdef01234568"), std::string(24, '\0')}) {
    EXPECT_EQ(access({"/", "127.0.0.1", "holdfast_token=" + wrong, "Bearer " + wrong}, kToken),
              HttpAnswer::unauthorised);
    EXPECT_EQ(access({"/?token=" + wrong, "127.0.0.1", "", ""}, kToken), HttpAnswer::unauthorised);
  }
  EXPECT_EQ(access({"/token=" + good, "x", "xholdfast_token=" + good, good}, kToken),
            HttpAnswer::unauthorised);
}

TEST(HttpAccess, TakesOnlyTokensThatCannotBeGuessedOrQuoted) {
  EXPECT_TRUE(is_usable_token(kToken));
  EXPECT_TRUE(is_usable_token("ABCDEFGHIJKLMNOPQRSTUVWXYZ-_"));
  EXPECT_FALSE(is_usable_token(kToken.substr(1)));
  EXPECT_FALSE(is_usable_token("0123456789abcdef0123456;"));
  EXPECT_FALSE(is_usable_token("0123456789abcdef0123456 "));
}

TEST(HttpServer, RefusesToBeReachedFromOutsideWithoutAToken) {
  RecordProperty("requirement", "SR-132");
  HttpParameters parameters;
  EXPECT_NO_THROW(check_http(parameters));
  for (const char* address : {"0.0.0.0", "::", "192.168.1.2"}) {
    parameters.address = address;
    parameters.token.clear();
    EXPECT_THROW(HttpServer{parameters}, InputError) << address;
    parameters.token = "short";
    EXPECT_THROW(HttpServer{parameters}, InputError) << address;
    parameters.token = kToken;
    EXPECT_NO_THROW(check_http(parameters)) << address;
  }
  parameters.address = "localhost.";
  EXPECT_THROW(check_http(parameters), InputError);
}

}  // namespace
}  // namespace holdfast::bridge
