// SPDX-License-Identifier: Apache-2.0
#include "rt/core/memory_lock.hpp"

#include <string>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

constexpr MemoryLockParameters kSmall{.heap_prefault_bytes = 1 << 20,
                                      .stack_prefault_bytes = 1 << 16};

/// Runs `body` in a child without the right to lock memory; its return is the exit status.
template <typename Body>
int in_unprivileged_child(Body body) {
  const pid_t child = fork();
  if (child == 0) {
    const rlimit none{0, 0};
    const bool is_unprivileged = setrlimit(RLIMIT_MEMLOCK, &none) == 0 &&
                                 (geteuid() != 0 || setresuid(65534, 65534, 65534) == 0);
    _exit(is_unprivileged ? body() : 99);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

#if !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
// The sanitizers' runtimes turn mlockall into nothing.
TEST(MemoryLock, RefusesNamingTheLimitAndTheCure) {
  const int status = in_unprivileged_child([] {
    try {
      (void)lock_memory(kSmall);
    } catch (const UnavailableError& error) {
      const std::string what = error.what();
      const bool is_clear = what.find("mlockall") != std::string::npos &&
                            what.find("RLIMIT_MEMLOCK is 0 KiB") != std::string::npos &&
                            what.find("CAP_IPC_LOCK") != std::string::npos;
      return is_clear ? 0 : 2;
    }
    return 1;
  });
  EXPECT_EQ(status, 0);
}

TEST(MemoryLock, GoesOnWithAWarningWhenAllowed) {
  const int status = in_unprivileged_child([] {
    MemoryLockParameters parameters = kSmall;
    parameters.allow_non_rt = true;
    return lock_memory(parameters).size() == 1 ? 0 : 1;
  });
  EXPECT_EQ(status, 0);
}

TEST(MemoryLock, LocksOrSaysThatItCannot) {
  try {
    EXPECT_TRUE(lock_memory(kSmall).empty());
    munlockall();
  } catch (const UnavailableError& error) {
    EXPECT_NE(std::string(error.what()).find("mlockall"), std::string::npos);
  }
}
#endif

TEST(MemoryLock, PrefaultsTheStackOfTheCaller) {
  prefault_stack(1 << 20);
}

}  // namespace
}  // namespace holdfast::rt
