// SPDX-License-Identifier: Apache-2.0
#include "bridge/service.hpp"

#include <gtest/gtest.h>

#include "tests/bridge/service_manager.hpp"

namespace holdfast::bridge {
namespace {

using std::chrono::milliseconds;

TEST(Service, TellsItsManager) {
  const holdfast::testing::ServiceManager manager(::testing::TempDir());
  service_is_ready();
  EXPECT_EQ(manager.next(milliseconds(1000)), "READY=1");
  service_is_alive();
  EXPECT_EQ(manager.next(milliseconds(1000)), "WATCHDOG=1");
  service_is_ending();
  EXPECT_EQ(manager.next(milliseconds(1000)), "STOPPING=1");
}

TEST(Service, WithoutAManagerOrWithOneThatIsGoneNothingHappens) {
  service_is_ready();
  setenv("NOTIFY_SOCKET", "/nowhere/notify", 1);
  service_is_alive();
  unsetenv("NOTIFY_SOCKET");
}

TEST(Progress, OneThatStandsStillIsEnough) {
  Progress<2> progress;
  EXPECT_TRUE(progress.all_moved({0, 0}));
  EXPECT_FALSE(progress.all_moved({0, 0}));
  EXPECT_FALSE(progress.all_moved({5, 0}));
  EXPECT_FALSE(progress.all_moved({9, 0}));
  EXPECT_TRUE(progress.all_moved({9, 1}));
  EXPECT_FALSE(progress.all_moved({9, 2}));
  EXPECT_TRUE(progress.all_moved({10, 2}));
}

}  // namespace
}  // namespace holdfast::bridge
