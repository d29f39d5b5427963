// SPDX-License-Identifier: Apache-2.0
#include "tests/rt/rt_guard.hpp"

#include <atomic>
#include <cerrno>
#include <cstdlib>

#include <dlfcn.h>
#include <malloc.h>
#include <pthread.h>
#include <semaphore.h>

namespace {

// In the executable's own TLS block: reading them allocates nothing.
thread_local bool is_counting = false;
thread_local std::uint64_t allocations = 0;
thread_local std::uint64_t locks = 0;

void count_allocation() noexcept {
  allocations += is_counting ? 1U : 0U;
}
void count_lock() noexcept {
  locks += is_counting ? 1U : 0U;
}

/// Calls the C library's own function behind the one replaced here.
template <typename... Arguments>
int forward(std::atomic<void*>& known, const char* name, Arguments... arguments) noexcept {
  void* function = known.load(std::memory_order_relaxed);
  if (function == nullptr) {
    function = dlsym(RTLD_NEXT, name);
    if (function == nullptr) std::abort();
    known.store(function, std::memory_order_relaxed);
  }
  return reinterpret_cast<int (*)(Arguments...)>(function)(arguments...);
}

}  // namespace

// NOLINTBEGIN: names, signatures and C linkage are the C library's.
extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);
void __libc_free(void*);

void* malloc(std::size_t size) noexcept {
  count_allocation();
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) noexcept {
  count_allocation();
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) noexcept {
  count_allocation();
  return __libc_realloc(memory, size);
}
void* memalign(std::size_t alignment, std::size_t size) noexcept {
  count_allocation();
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  count_allocation();
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, std::size_t alignment, std::size_t size) noexcept {
  count_allocation();
  *memory = __libc_memalign(alignment, size);
  return *memory == nullptr ? ENOMEM : 0;
}
void free(void* memory) noexcept {
  count_allocation();
  __libc_free(memory);
}

#define HOLDFAST_COUNT_LOCK(name, parameters, ...)      \
  int name parameters {                                 \
    static constinit std::atomic<void*> known{nullptr}; \
    count_lock();                                       \
    return forward(known, #name, __VA_ARGS__);          \
  }
HOLDFAST_COUNT_LOCK(pthread_mutex_lock, (pthread_mutex_t * m) noexcept, m)
HOLDFAST_COUNT_LOCK(pthread_mutex_trylock, (pthread_mutex_t * m) noexcept, m)
HOLDFAST_COUNT_LOCK(pthread_mutex_timedlock, (pthread_mutex_t * m, const timespec* t) noexcept, m,
                    t)
HOLDFAST_COUNT_LOCK(pthread_rwlock_rdlock, (pthread_rwlock_t * l) noexcept, l)
HOLDFAST_COUNT_LOCK(pthread_rwlock_wrlock, (pthread_rwlock_t * l) noexcept, l)
HOLDFAST_COUNT_LOCK(pthread_spin_lock, (pthread_spinlock_t * l) noexcept, l)
HOLDFAST_COUNT_LOCK(pthread_cond_wait, (pthread_cond_t * c, pthread_mutex_t* m), c, m)
HOLDFAST_COUNT_LOCK(pthread_cond_timedwait,
                    (pthread_cond_t * c, pthread_mutex_t* m, const timespec* t), c, m, t)
HOLDFAST_COUNT_LOCK(sem_wait, (sem_t * s), s)
#undef HOLDFAST_COUNT_LOCK
}
// NOLINTEND

namespace holdfast::rt::testing {

RtGuard::RtGuard() noexcept {
  allocations = 0;
  locks = 0;
  is_counting = true;
}
RtGuard::~RtGuard() {
  is_counting = false;
}
GuardCounts RtGuard::counts() const noexcept {
  return {allocations, locks};
}

}  // namespace holdfast::rt::testing
