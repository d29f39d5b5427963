// SPDX-License-Identifier: Apache-2.0
// Programs that link heap_counter.cpp have malloc, calloc and realloc replaced by ones that count,
// also for the shared libraries they use. Not together with sanitizers.
#pragma once

namespace holdfast::bridge::dds {

/// How often the calling thread has asked for memory.
[[nodiscard]] long heap_requests() noexcept;

/// How often it does in `f`.
template <class F>
long heap_requests_in(F&& f) {
  const long before = heap_requests();
  f();
  return heap_requests() - before;
}

}  // namespace holdfast::bridge::dds
