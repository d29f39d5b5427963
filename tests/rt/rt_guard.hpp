// SPDX-License-Identifier: Apache-2.0
// Counts the heap and lock calls of the calling thread: rt_guard.cpp replaces malloc, free and
// their kin and the pthread locks in the executable that links it. Not for sanitizer builds, which
// replace them too.
#pragma once

#include <cstdint>

namespace holdfast::rt::testing {

struct GuardCounts {
  std::uint64_t allocations = 0;  ///< malloc, calloc, realloc, free, memalign and kin, new, delete
  std::uint64_t locks = 0;        ///< mutex, rwlock, spin, condition and semaphore waits
};

/// Counts while it lives, on this thread.
class RtGuard {
 public:
  RtGuard() noexcept;
  ~RtGuard();
  RtGuard(const RtGuard&) = delete;
  RtGuard& operator=(const RtGuard&) = delete;
  [[nodiscard]] GuardCounts counts() const noexcept;
};

}  // namespace holdfast::rt::testing
