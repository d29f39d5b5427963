// SPDX-License-Identifier: Apache-2.0
// The OpenIGTLink server against clients that do not behave, on loopback.
#include "bridge/openigtlink/igtl_server.hpp"

#include <gtest/gtest.h>

#include "rt/core/error.hpp"
#include "tests/rt/outlets/tcp_client.hpp"

namespace holdfast::bridge::openigtlink {
namespace {

using namespace std::chrono_literals;

class IgtlServer : public ::testing::Test {
 protected:
  static ServerParameters parameters() {
    ServerParameters p;
    p.port = 0;
    p.clients_max = 2;
    p.backlog_max = 256 * 1024;
    return p;
  }
  /// The server's turns until it holds.
  template <class F>
  bool eventually(F&& holds) {
    for (int turn = 0; turn < 20'000; ++turn) {
      if (holds()) return true;
      server_.serve(1ms);
    }
    return false;
  }
  Server server_{parameters()};
};

TEST_F(IgtlServer, SendsTheNewestGreetingAndThenEveryMessage) {
  server_.set_greeting("old");
  server_.set_greeting("hello ");
  testing::TcpClient client(server_.port());
  ASSERT_TRUE(eventually([&] { return server_.clients() == 1; }));
  server_.send("one ");
  server_.send("two");
  EXPECT_TRUE(eventually([&] { return client.receive() == "hello one two"; }));
}

TEST_F(IgtlServer, DropsAClientThatDoesNotReadAndServesTheOther) {
  RecordProperty("requirement", "SR-142");
  const testing::TcpClient lazy(server_.port());
  testing::TcpClient eager(server_.port());
  ASSERT_TRUE(eventually([&] { return server_.clients() == 2; }));
  const std::string message(64 * 1024, 'x');
  std::size_t sent = 0;
  // More than the kernel keeps for a connection and the backlog together.
  for (; sent < 64U * 1024 * 1024 && server_.dropped() == 0; sent += message.size()) {
    server_.send(message);
    ASSERT_TRUE(eventually([&] { return eager.receive().size() == sent + message.size(); }));
  }
  EXPECT_EQ(server_.dropped(), 1U);
  EXPECT_EQ(server_.clients(), 1U);
  EXPECT_EQ(eager.receive().size(), sent);
}

TEST_F(IgtlServer, ThrowsAwayWhateverComesIn) {
  RecordProperty("requirement", "SR-142");
  testing::TcpClient client(server_.port());
  ASSERT_TRUE(eventually([&] { return server_.clients() == 1; }));
  const std::string garbage(8 * 1024, '\xff');
  for (int i = 0; i < 200; ++i) {
    client.send(garbage);
    server_.serve(10us);
  }
  server_.send("still here");
  EXPECT_TRUE(eventually([&] { return client.receive() == "still here"; }));
}

TEST_F(IgtlServer, ForgetsClientsThatLeaveAndRefusesMoreThanItsNumber) {
  RecordProperty("requirement", "SR-142");
  {
    const testing::TcpClient first(server_.port()), second(server_.port());
    ASSERT_TRUE(eventually([&] { return server_.clients() == 2; }));
    testing::TcpClient third(server_.port());
    EXPECT_TRUE(eventually([&] { return third.is_closed(); }));
    EXPECT_EQ(server_.clients(), 2U);
  }
  EXPECT_TRUE(eventually([&] { return server_.clients() == 0; }));
  server_.send("to nobody");
}

TEST_F(IgtlServer, StaysOnLoopbackUnlessToldOtherwise) {
  RecordProperty("requirement", "SR-142");
  ServerParameters p = parameters();
  p.address = "0.0.0.0";
  EXPECT_THROW(check_server(p), InputError);
  EXPECT_THROW(Server{p}, InputError);
  p.allow_network = true;
  EXPECT_NO_THROW(check_server(p));
  p.address = "localhost";
  EXPECT_THROW(check_server(p), InputError);
  p = parameters();
  p.port = server_.port();
  EXPECT_THROW(Server{p}, UnavailableError);
}

}  // namespace
}  // namespace holdfast::bridge::openigtlink
