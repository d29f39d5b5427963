// SPDX-License-Identifier: Apache-2.0
#include "tests/bridge/heap_counter.hpp"

#include <cstddef>

namespace {
thread_local long requests = 0;
}

extern "C" {
// NOLINTBEGIN(readability-identifier-naming): glibc's names
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* memory, std::size_t size);
// NOLINTEND(readability-identifier-naming)

void* malloc(std::size_t size) {
  ++requests;
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  ++requests;
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) {
  ++requests;
  return __libc_realloc(memory, size);
}
}

namespace holdfast::bridge::dds {

long heap_requests() noexcept {
  return requests;
}

}  // namespace holdfast::bridge::dds
