// SPDX-License-Identifier: Apache-2.0
#include "rt/doctor.hpp"

#include <algorithm>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

namespace holdfast::rt {
namespace {

using std::filesystem::path;

/// A machine as proc and sys would show it.
class Doctor : public ::testing::Test {
 public:
  void SetUp() override {
    root = path(::testing::TempDir()) / ("doctor_" + std::to_string(getpid()));
    write("proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian");
    write("proc/sys/kernel/sched_rt_runtime_us", "-1");
    write("proc/sys/net/core/rmem_max", "16777216");
    write("sys/devices/system/cpu/isolated", "2-3");
    write("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance");
    write("sys/devices/system/cpu/cpu0/cpuidle/state0/latency", "2");
    write("sys/devices/system/cpu/cpu0/cpuidle/state1/latency", "133");
    write("sys/devices/system/cpu/cpu0/cpuidle/state1/disable", "1");
    write("sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc");
  }
  void TearDown() override { std::filesystem::remove_all(root); }
  void write(const path& file, const std::string& text) const {
    std::filesystem::create_directories((root / file).parent_path());
    std::ofstream(root / file) << text << '\n';
  }
  [[nodiscard]] DoctorFinding finding(const std::string& check) const {
    DoctorParameters parameters;
    parameters.root = root;
    parameters.cameras_found = cameras;
    const auto all = run_doctor(parameters);
    const auto found = std::ranges::find(all, check, &DoctorFinding::check);
    if (found == all.end()) return {"missing: " + check, DoctorState::failed, "", ""};
    return *found;
  }
  path root;
  int cameras = 1;
};

TEST_F(Doctor, FindsAWellSetMachineWell) {
  for (const char* check : {"kernel", "rt throttling", "isolated cpus", "cpu frequency",
                            "idle states", "clock source", "socket buffer", "cameras"}) {
    const DoctorFinding f = finding(check);
    EXPECT_EQ(f.check, check);
    EXPECT_EQ(f.state, DoctorState::ok) << check << ": " << f.measured;
    EXPECT_TRUE(f.advice.empty()) << f.advice;
  }
}

TEST_F(Doctor, NamesEachShortcomingAndItsCure) {
  cameras = 0;
  write("proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC");
  write("proc/sys/kernel/sched_rt_runtime_us", "950000");
  write("proc/sys/net/core/rmem_max", "212992");
  write("sys/devices/system/cpu/isolated", "");
  write("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "powersave");
  write("sys/devices/system/cpu/cpu0/cpuidle/state1/disable", "0");
  write("sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet");
  const auto expect_warning = [&](const char* check, const char* measured, const char* advice) {
    const DoctorFinding f = finding(check);
    EXPECT_EQ(f.state, DoctorState::warning) << check;
    EXPECT_NE(f.measured.find(measured), std::string::npos) << f.measured;
    EXPECT_NE(f.advice.find(advice), std::string::npos) << f.advice;
  };
  expect_warning("kernel", "PREEMPT_DYNAMIC", "linux-image-rt");
  expect_warning("rt throttling", "950000 us", "sched_rt_runtime_us=-1");
  expect_warning("socket buffer", "212992 bytes", "rmem_max=16777216");
  expect_warning("isolated cpus", "none", "isolcpus");
  expect_warning("cpu frequency", "powersave", "performance");
  expect_warning("idle states", "133 us", "cpupower idle-set");
  expect_warning("clock source", "hpet", "tsc=reliable");
  expect_warning("cameras", "0 found", "cable");
}

TEST_F(Doctor, KnowsAnRtKernelByEitherSign) {
  write("proc/sys/kernel/version", "#1 SMP PREEMPT");
  EXPECT_EQ(finding("kernel").state, DoctorState::warning);
  write("sys/kernel/realtime", "1");
  EXPECT_EQ(finding("kernel").state, DoctorState::ok);
}

TEST_F(Doctor, SaysWhatItCannotRead) {
  std::filesystem::remove_all(root / "sys");
  const DoctorFinding f = finding("cpu frequency");
  EXPECT_EQ(f.state, DoctorState::warning);
  EXPECT_NE(f.measured.find("cannot be read"), std::string::npos);
}

// On the machine that runs the test the outcome is its own; each check must have one, with a cure
// unless it is ok.
TEST(DoctorHere, EveryCheckMeasuresAndAdvises) {
  const auto findings = run_doctor(DoctorParameters{});
  EXPECT_EQ(findings.size(), 12U);
  for (const DoctorFinding& f : findings) {
    EXPECT_FALSE(f.measured.empty()) << f.check;
    EXPECT_EQ(f.advice.empty(), f.state == DoctorState::ok) << f.check;
  }
}

}  // namespace
}  // namespace holdfast::rt
