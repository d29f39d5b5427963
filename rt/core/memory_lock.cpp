// SPDX-License-Identifier: Apache-2.0
#include "rt/core/memory_lock.hpp"

#include <cerrno>
#include <cstring>
#include <memory>
#include <new>

#include <malloc.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

std::size_t page_bytes() noexcept {
  return static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
}

void touch(volatile std::byte* memory, std::size_t bytes) noexcept {
  const std::size_t step = page_bytes();
  for (std::size_t i = 0; i < bytes; i += step) memory[i] = std::byte{1};
}

std::string denied(const char* call, int error) {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  const std::string allowed = limit.rlim_cur == RLIM_INFINITY
                                  ? "unlimited"
                                  : std::to_string(limit.rlim_cur / 1024) + " KiB";
  return std::string("memory lock: ") + call + " denied: " + std::strerror(error) +
         "; RLIMIT_MEMLOCK is " + allowed +
         "; set 'memlock unlimited' in /etc/security/limits.conf (LimitMEMLOCK=infinity in a "
         "systemd unit) or grant CAP_IPC_LOCK";
}

}  // namespace

std::vector<std::string> lock_memory(const MemoryLockParameters& parameters) {
  std::vector<std::string> warnings;
  const auto refuse = [&](const std::string& what) {
    if (!parameters.allow_non_rt) throw UnavailableError(what);
    warnings.push_back(what);
  };
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) refuse(denied("mlockall", errno));
  // Freed memory stays in the (touched, locked) heap, and large blocks come from there too.
  if (mallopt(M_TRIM_THRESHOLD, -1) != 1 || mallopt(M_MMAP_MAX, 0) != 1) {
    warnings.emplace_back(
        "memory lock: mallopt has no effect, freed memory may leave the process; use the GNU C "
        "library's allocator");
  }
  try {
    const std::unique_ptr<std::byte[]> heap(new std::byte[parameters.heap_prefault_bytes]);
    touch(heap.get(), parameters.heap_prefault_bytes);
  } catch (const std::bad_alloc&) {
    refuse(denied("heap prefault", ENOMEM));
  }
  prefault_stack(parameters.stack_prefault_bytes);
  return warnings;
}

// Recursion by fixed frames instead of alloca: bounded, and each frame is really written.
[[gnu::noinline]] void prefault_stack(std::size_t bytes) noexcept {
  constexpr std::size_t kFrame = 4096;
  volatile std::byte frame[kFrame];
  touch(frame, kFrame);
  if (bytes > kFrame) prefault_stack(bytes - kFrame);
  frame[0] = std::byte{0};  // after the call, so that it is no tail call on the same frame
}

}  // namespace holdfast::rt
