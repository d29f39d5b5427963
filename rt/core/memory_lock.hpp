// SPDX-License-Identifier: Apache-2.0
// Keeps the process' memory resident, so that the real-time path never waits for a page fault.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace holdfast::rt {

struct MemoryLockParameters {
  std::size_t heap_prefault_bytes = 64 * 1024 * 1024;
  std::size_t stack_prefault_bytes = 256 * 1024;  ///< of the calling thread
  bool allow_non_rt = false;  ///< a denied lock becomes a warning instead of an error
};

/// Locks all present and future pages (mlockall), makes the C library keep freed memory instead of
/// returning it (no trim, no mmap), and touches heap and stack once. Call at start-up, before
/// threads and before the real-time path runs. Throws UnavailableError naming the limit and the
/// cure; with allow_non_rt returns it as a warning and prefaults all the same. An allocator other
/// than the C library's is a warning in either case.
[[nodiscard]] std::vector<std::string> lock_memory(const MemoryLockParameters& parameters);

/// Touches `bytes` of the calling thread's stack below the current frame; the stack must have them.
void prefault_stack(std::size_t bytes) noexcept;

}  // namespace holdfast::rt
