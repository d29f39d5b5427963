// SPDX-License-Identifier: Apache-2.0
// Daemon and guard as a service manager sees them.
#include <csignal>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/service_manager.hpp"
#include "tests/sim/demo/child_process.hpp"
#include "tests/sim/demo/rig.hpp"

namespace holdfast::rt {
namespace {

using std::chrono::milliseconds;
namespace fs = std::filesystem;

constexpr milliseconds kStart{30'000};
// Twice the shorter WatchdogSec of the units.
constexpr milliseconds kPatience{2000};

class ServiceProcess : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ =
        fs::path(::testing::TempDir()) /
        (std::string("service-") + ::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  /// What every service that runs says, and one that is frozen does not.
  static void expect_life_of(pid_t pid, const holdfast::testing::ServiceManager& manager) {
    for (int i = 0; i < 3; ++i) EXPECT_EQ(manager.next(kPatience), "WATCHDOG=1");
    kill(pid, SIGSTOP);
    manager.forget();
    EXPECT_EQ(manager.next(kPatience), "");
    kill(pid, SIGCONT);
    EXPECT_EQ(manager.next(kPatience), "WATCHDOG=1");
  }
  static void expect_end(const holdfast::testing::ServiceManager& manager) {
    std::string said = manager.next(kPatience);
    while (said == "WATCHDOG=1") said = manager.next(kPatience);
    EXPECT_EQ(said, "STOPPING=1");
  }

  fs::path folder_;
};

TEST_F(ServiceProcess, TheGuardIsReadyThenAliveUntilItEnds) {
  const holdfast::testing::ServiceManager manager(folder_);
  sim::ChildProcess guard(
      HOLDFAST_GUARD,
      {"--config", HOLDFAST_GUARD_CONFIG, "--domain", std::to_string(bridge::dds::test_domain())},
      folder_ / "guard.log");
  ASSERT_EQ(manager.next(kStart), "READY=1");
  expect_life_of(guard.pid(), manager);
  EXPECT_EQ(guard.end(milliseconds(5000)), 0);
  expect_end(manager);
}

TEST_F(ServiceProcess, TheDaemonIsReadyThenAliveUntilItEnds) {
  sim::RigParameters parameters;
  parameters.folder = folder_ / "rig";
  parameters.daemon_config = HOLDFAST_DEMO_CONFIG;
  parameters.guard_config = HOLDFAST_GUARD_CONFIG;
  parameters.domain = static_cast<int>(bridge::dds::test_domain());
  parameters.has_operator = false;
  sim::Rig rig(parameters);
  rig.kill_daemon();
  const holdfast::testing::ServiceManager manager(folder_);
  rig.restart_daemon();
  ASSERT_EQ(manager.next(kStart), "READY=1");
  expect_life_of(rig.daemon_pid(), manager);
  rig.finish();
  expect_end(manager);
}

}  // namespace
}  // namespace holdfast::rt
