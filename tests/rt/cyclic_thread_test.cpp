// SPDX-License-Identifier: Apache-2.0
#include "rt/core/cyclic_thread.hpp"

#include <atomic>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

CyclicThreadParameters ordinary() {
  CyclicThreadParameters parameters;
  parameters.fifo_priority.reset();  // tests run anywhere
  return parameters;
}

/// Runs a cyclic thread for `cycles` cycles and returns what each was told.
std::vector<CycleInfo> run_cycles(const CyclicThreadParameters& parameters, std::size_t cycles,
                                  void (*body)(const CycleInfo&) = nullptr) {
  std::vector<CycleInfo> seen;
  seen.reserve(cycles);
  std::atomic<bool> is_done{false};
  CyclicThread thread(parameters, [&](const CycleInfo& info) {
    if (seen.size() < cycles) seen.push_back(info);
    if (body != nullptr) body(info);
    if (seen.size() == cycles && !is_done.exchange(true)) is_done.notify_one();
  });
  is_done.wait(false);
  thread.stop();
  return seen;
}

void spin_for(nanoseconds time) {
  const nanoseconds end = monotonic_now() + time;
  while (monotonic_now() < end) {
  }
}

TEST(CyclicThread, EveryCycleLiesOnTheGrid) {
  CyclicThreadParameters parameters = ordinary();
  parameters.epoch = nanoseconds(12345);
  parameters.phase = microseconds(300);
  for (const CycleInfo& info : run_cycles(parameters, 50)) {
    EXPECT_EQ((info.t_scheduled - parameters.epoch - parameters.phase) % parameters.period,
              nanoseconds(0));
    EXPECT_GE(info.t_woken, info.t_scheduled);
    EXPECT_EQ(info.lateness, info.t_woken - info.t_scheduled);
  }
}

TEST(CyclicThread, CyclesAndMissedSlotsAccountForEverySlot) {
  const CyclicThreadParameters parameters = ordinary();
  const auto seen = run_cycles(parameters, 100);
  for (std::size_t i = 1; i < seen.size(); ++i) {
    EXPECT_EQ(seen[i].index, seen[i - 1].index + 1);
    const auto slots = (seen[i].t_scheduled - seen[i - 1].t_scheduled) / parameters.period;
    const auto missed_before = seen[i - 1].missed - (i > 1 ? seen[i - 2].missed : 0);
    EXPECT_EQ(slots, static_cast<std::int64_t>(missed_before) + 1);
    EXPECT_EQ(seen[i].missed - seen[i - 1].missed,
              static_cast<std::uint64_t>(seen[i].lateness / parameters.period));
  }
}

TEST(CyclicThread, AnOverrunSkipsSlotsShowsItsWholeLatenessAndDoesNotBurst) {
  const CyclicThreadParameters parameters = ordinary();
  const auto seen = run_cycles(parameters, 8, [](const CycleInfo& info) {
    if (info.index == 3) spin_for(microseconds(5500));
  });
  // The body of cycle 3 covered at least 5 whole slots after its own.
  const CycleInfo& before = seen[3];
  const CycleInfo& after = seen[4];
  EXPECT_GE(after.missed - before.missed, 4U);
  EXPECT_GE(after.lateness, microseconds(4500));
  // One cycle per slot: the grid point that a later cycle serves has begun and is a new one.
  for (std::size_t i = 1; i < seen.size(); ++i) {
    const auto slot = [&](const CycleInfo& info) {
      return (info.t_scheduled + info.lateness) / parameters.period;
    };
    EXPECT_GT(slot(seen[i]), slot(seen[i - 1]));
  }
}

TEST(CyclicThread, ThreadsWithOneEpochShareOneGrid) {
  CyclicThreadParameters first = ordinary();
  CyclicThreadParameters second = ordinary();
  second.phase = microseconds(400);
  const auto a = run_cycles(first, 3);
  const auto b = run_cycles(second, 3);
  EXPECT_EQ((b[0].t_scheduled - a[0].t_scheduled) % first.period, microseconds(400));
}

TEST(CyclicThread, AFutureEpochIsWaitedFor) {
  CyclicThreadParameters parameters = ordinary();
  parameters.epoch = monotonic_now() + milliseconds(20);
  const auto seen = run_cycles(parameters, 1);
  EXPECT_EQ(seen[0].t_scheduled, parameters.epoch);
}

TEST(CyclicThread, NoCycleBeginsAfterStop) {
  std::atomic<int> cycles{0};
  CyclicThread thread(ordinary(), [&](const CycleInfo&) {
    ++cycles;
    cycles.notify_one();
  });
  cycles.wait(0);
  thread.stop();
  const int at_stop = cycles.load();
  thread.stop();  // again is harmless
  spin_for(milliseconds(5));
  EXPECT_EQ(cycles.load(), at_stop);
}

TEST(CyclicThread, TheCallbackCanAskForTheStop) {
  std::atomic<CyclicThread*> self{nullptr};
  std::atomic<int> cycles{0};
  CyclicThread thread(ordinary(), [&](const CycleInfo&) {
    self.wait(nullptr);
    self.load()->request_stop();
    ++cycles;
    cycles.notify_one();
  });
  self.store(&thread);
  self.notify_one();
  cycles.wait(0);
  thread.stop();
  EXPECT_EQ(cycles.load(), 1);
}

TEST(CyclicThread, RefusesParametersOutOfRange) {
  const auto refuses = [](auto change) {
    CyclicThreadParameters parameters = ordinary();
    change(parameters);
    EXPECT_THROW(CyclicThread(parameters, [](const CycleInfo&) {}), InputError);
  };
  refuses([](auto& p) { p.period = nanoseconds(0); });
  refuses([](auto& p) { p.phase = p.period; });
  refuses([](auto& p) { p.phase = nanoseconds(-1); });
  refuses([](auto& p) { p.fifo_priority = 0; });
  refuses([](auto& p) { p.fifo_priority = 100; });
  refuses([](auto& p) { p.cpu = -1; });
  refuses([](auto& p) { p.stack_prefault_bytes = p.stack_bytes; });
}

TEST(CyclicThread, RefusesACpuThatIsNotThereNamingThoseThatAre) {
  CyclicThreadParameters parameters = ordinary();
  parameters.cpu = CPU_SETSIZE - 1;
  bool has_run = false;
  try {
    CyclicThread thread(parameters, [&](const CycleInfo&) { has_run = true; });
    FAIL() << "started on cpu " << *parameters.cpu;
  } catch (const UnavailableError& error) {
    const std::string what = error.what();
    EXPECT_NE(what.find("cpu 1023"), std::string::npos) << what;
    EXPECT_NE(what.find("Invalid argument"), std::string::npos) << what;
    EXPECT_NE(what.find("choose one of"), std::string::npos) << what;
  }
  EXPECT_FALSE(has_run);
}

TEST(CyclicThread, GoesOnWithAWarningWhenAllowed) {
  CyclicThreadParameters parameters = ordinary();
  parameters.cpu = CPU_SETSIZE - 1;
  parameters.allow_non_rt = true;
  std::atomic<bool> has_run{false};
  CyclicThread thread(parameters, [&](const CycleInfo&) {
    if (!has_run.exchange(true)) has_run.notify_one();
  });
  has_run.wait(false);
  ASSERT_EQ(thread.warnings().size(), 1U);
  EXPECT_NE(thread.warnings()[0].find("cpu 1023"), std::string::npos);
}

/// In a child without the right to real-time priorities: 0 if SCHED_FIFO is refused clearly and,
/// with allow_non_rt, runs on with the same text as a warning.
int refusal_without_privilege() {
  const rlimit none{0, 0};
  if (setrlimit(RLIMIT_RTPRIO, &none) != 0) return 99;
  if (geteuid() == 0 && setresuid(65534, 65534, 65534) != 0) return 99;
  CyclicThreadParameters parameters;
  std::string refusal;
  try {
    CyclicThread thread(parameters, [](const CycleInfo&) {});
    return 1;
  } catch (const UnavailableError& error) {
    refusal = error.what();
  }
  for (const char* part : {"SCHED_FIFO priority 80", "Operation not permitted", "rtprio"}) {
    if (refusal.find(part) == std::string::npos) return 2;
  }
  parameters.allow_non_rt = true;
  CyclicThread thread(parameters, [](const CycleInfo&) {});
  return thread.warnings() == std::vector<std::string>{refusal} ? 0 : 3;
}

TEST(CyclicThread, RefusesWhenTheSystemDeniesRealTimePriority) {
  const pid_t child = fork();
  if (child == 0) _exit(refusal_without_privilege());
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace holdfast::rt
