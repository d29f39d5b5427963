// SPDX-License-Identifier: Apache-2.0
// holdfast-guard as a process between a scripted daemon and a robot's client, over the real
// middleware: frozen, killed and started again.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

#include <gtest/gtest.h>

#include "bridge/client/client.hpp"
#include "bridge/dds/endpoint.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/scripted_daemon.hpp"
#include "tests/sim/demo/child_process.hpp"

namespace holdfast::guard {
namespace {

namespace dds = bridge::dds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr nanoseconds kValidityMax = milliseconds(20);

/// A healthy daemon's four streams, each millisecond, until it is told to fall silent.
class HealthyDaemon {
 public:
  explicit HealthyDaemon(const dds::Participant& participant)
      : poses_(participant, source_, dds::PoseForger::key()),
        stops_(participant, source_),
        health_(participant, source_),
        registrations_(participant, source_) {
    thread_ = std::thread([this] { run(); });
  }
  ~HealthyDaemon() {
    is_ending_ = true;
    thread_.join();
  }
  std::atomic<bool> is_silent{false};

 private:
  void run() {
    msg::RegistrationInfo registration{};
    registration.is_loaded = true;
    registration.registration_id = 9;
    registration.rotation_xyzw[3] = 1;
    (void)registrations_.publish(registration);
    for (std::uint64_t cycle = 0; !is_ending_; ++cycle) {
      if (!is_silent) publish(cycle);
      std::this_thread::sleep_for(milliseconds(1));
    }
  }
  void publish(std::uint64_t cycle) {
    if (cycle % 30 == 0) {
      msg::TrackingHealth health{};
      health.registration_id = 9;
      health.site_rotation_xyzw[3] = 1;
      (void)health_.publish(health);
    }
    msg::MotionStop stop{};
    stop.mode = 3;
    stop.is_permitted = true;
    (void)stops_.publish(stop);
    const std::int64_t now_ns = dds::read_clocks().monotonic.count();
    msg::CompensatedPose pose{};
    pose.t_pose_ns = now_ns;
    pose.t_exposure_ns = now_ns - 30'000'000;
    pose.t_frame_received_ns = now_ns - 15'000'000;
    pose.registration_id = 9;
    // At the keyframe, with the ct in the camera's frame: T_robot_ct is [robot] of the guard's
    // file.
    constexpr double kRobotMm[3] = {120, -35, 310};
    std::copy(std::begin(kRobotMm), std::end(kRobotMm), pose.translation_mm);
    std::copy(std::begin(kRobotMm), std::end(kRobotMm), pose.target_robot_mm);
    pose.rotation_xyzw[1] = pose.rotation_xyzw[3] = std::sqrt(0.5);
    for (std::size_t i = 0; i < 6; ++i) pose.covariance[7 * i] = 0.01;
    (void)poses_.publish(pose);
  }

  std::uint32_t source_ = dds::random_source();
  dds::ProtectedWriter<msg::CompensatedPose> poses_;
  dds::ProtectedWriter<msg::MotionStop> stops_;
  dds::ProtectedWriter<msg::TrackingHealth> health_;
  dds::ProtectedWriter<msg::RegistrationInfo> registrations_;
  std::atomic<bool> is_ending_{false};
  std::thread thread_;
};

class GuardProcess : public ::testing::Test {
 protected:
  void SetUp() override { start_guard(); }
  void start_guard() {
    guard_.emplace(HOLDFAST_GUARD,
                   std::vector<std::string>{"--config", HOLDFAST_GUARD_CONFIG, "--domain",
                                            std::to_string(dds::test_domain())},
                   std::filesystem::path(::testing::TempDir()) / "guard.log");
  }
  /// One cycle of the robot.
  client::Permission poll() {
    robot_.wait(milliseconds(1));
    const client::Permission permission = robot_.poll();
    (void)robot_.report({permission.is_permitted(), false, 0});
    return permission;
  }
  [[nodiscard]] bool gets_permitted() {
    return dds::eventually([this] { return poll().is_permitted(); });
  }
  /// The robot's last permission when it has stopped for the given reason.
  void expect_stop(client::Refusal wanted) {
    client::Permission last;
    client::Permission p = poll();
    ASSERT_TRUE(dds::eventually([&] {
      if (p.is_permitted()) last = p;
      p = poll();
      return p.refusal == wanted;
    })) << name(p.refusal);
  }

  dds::Participant participant_{{.domain = dds::test_domain(), .configuration = {}}};
  HealthyDaemon daemon_{participant_};
  client::Client robot_{[] {
    client::Parameters parameters;
    parameters.domain = dds::test_domain();
    return parameters;
  }()};
  std::optional<sim::ChildProcess> guard_;
};

TEST_F(GuardProcess, AFrozenGuardStopsTheRobotWithinItsValidity) {
  RecordProperty("requirement", "SR-106");
  ASSERT_TRUE(gets_permitted());
  kill(guard_->pid(), SIGSTOP);
  const nanoseconds t_frozen = dds::read_clocks().monotonic;
  client::Permission p = poll();
  while (p.is_permitted()) {
    // No permission reaches further than the newest answer, sent before the freeze, allows.
    ASSERT_LE(nanoseconds(p.pose->t_valid_until_ns), t_frozen + kValidityMax);
    p = poll();
  }
  expect_stop(client::Refusal::guard_silent);
  kill(guard_->pid(), SIGCONT);
  EXPECT_TRUE(gets_permitted());
}

TEST_F(GuardProcess, AKilledGuardStopsTheRobotAndANewOneTakesOver) {
  RecordProperty("requirement", "SR-106");
  ASSERT_TRUE(gets_permitted());
  guard_->kill_now();
  const nanoseconds t_killed = dds::read_clocks().monotonic;
  client::Permission p = poll();
  while (p.is_permitted()) {
    ASSERT_LE(nanoseconds(p.pose->t_valid_until_ns), t_killed + kValidityMax);
    p = poll();
  }
  expect_stop(client::Refusal::guard_silent);
  start_guard();
  EXPECT_TRUE(gets_permitted());
}

TEST_F(GuardProcess, ASilentDaemonLosesTheGuardsPermission) {
  RecordProperty("requirement", "SR-101");
  ASSERT_TRUE(gets_permitted());
  dds::Reader<msg::GuardPermission> answers(participant_);
  daemon_.is_silent = true;
  EXPECT_TRUE(dds::eventually([&] {
    bool is_withdrawn = false;
    for (const auto& answer : answers.take()) is_withdrawn = !answer.is_permitted;
    (void)poll();
    return is_withdrawn;
  }));
  EXPECT_FALSE(poll().is_permitted());
}

TEST_F(GuardProcess, AGuardThatEndsInOrderWithdraws) {
  RecordProperty("requirement", "SR-106");
  ASSERT_TRUE(gets_permitted());
  EXPECT_EQ(guard_->end(milliseconds(10'000)), 0);
  EXPECT_FALSE(poll().is_permitted());
}

std::string text_of(const std::filesystem::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

/// Exit code of `holdfast-guard --check` on this text, and what it said.
std::pair<int, std::string> check(const std::string& configuration) {
  const auto folder = std::filesystem::path(::testing::TempDir());
  const auto file = folder / "guard_check.toml", log = folder / "guard_check.log";
  std::ofstream(file) << configuration;
  sim::ChildProcess process(HOLDFAST_GUARD, {"--config", file, "--check"}, log);
  const int code = process.wait(milliseconds(60'000));
  return {code, text_of(log)};
}

TEST(GuardProgram, NamesEachMistakeOfItsConfiguration) {
  RecordProperty("requirement", "SR-82,SR-89");
  const std::string good = text_of(HOLDFAST_GUARD_CONFIG);
  EXPECT_EQ(check(good).first, 0);
  struct Mistake {
    const char *from, *to, *said;
  };
  for (const auto& [from, to, said] :
       {Mistake{"daemon_silence_max_ms", "daemon_silence_max_us", "daemon_silence_max_us"},
        Mistake{"permission_validity_ms = 18", "permission_validity_ms = 21", "out of range"},
        Mistake{"translation_mm", "#translation_mm",
                "robot.translation_mm and rotation_xyzw are required"},
        Mistake{"allow_unsecured = true", "", "dds.security: give either"},
        Mistake{"allow_unsecured = true", "security = \"nowhere\"", "nowhere"}}) {
    std::string bad = good;
    const auto at = bad.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    const auto [code, text] = check(bad.replace(at, std::string(from).size(), to));
    EXPECT_EQ(code, 2) << to;
    EXPECT_NE(text.find(said), std::string::npos) << text;
  }
}

}  // namespace
}  // namespace holdfast::guard
