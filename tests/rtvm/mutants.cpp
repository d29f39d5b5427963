// SPDX-License-Identifier: Apache-2.0
#include "tests/rtvm/mutants.hpp"

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <thread>

#include <sys/mman.h>

#include "rt/core/clock.hpp"
#include "rt/core/cyclic_thread.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rtvm {
namespace {

using std::chrono::milliseconds;

void spin(std::chrono::nanoseconds duration) {
  const auto end = rt::monotonic_now() + duration;
  while (rt::monotonic_now() < end) {
  }
}

class Malloc : public Mutant {
 public:
  void act() override {
    block_ = std::malloc(256);
    std::free(block_);
  }

 private:
  void* volatile block_ = nullptr;  // so that the pair is not optimised away
};

/// One page a cycle that has never been touched.
class PageTouch : public Mutant {
 public:
  PageTouch()
      : memory_(mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0)) {
    if (memory_ == MAP_FAILED || munlock(memory_, kBytes) != 0 ||
        madvise(memory_, kBytes, MADV_DONTNEED) != 0) {
      throw UnavailableError("mutant page_touch: no untouched memory");
    }
  }
  ~PageTouch() override { munmap(memory_, kBytes); }
  void act() override {
    static_cast<volatile std::byte*>(memory_)[next_] = std::byte{1};
    next_ = (next_ + 4096) % kBytes;
  }

 private:
  static constexpr std::size_t kBytes = std::size_t{64} << 20U;
  void* memory_;
  std::size_t next_ = 0;
};

/// A lock without priority inheritance, shared with an unimportant thread; a third one, in between,
/// keeps that from running: priority inversion.
class Mutex : public Mutant {
 public:
  ~Mutex() override {
    is_ending_ = true;
    unimportant_.join();
    middle_.stop();
  }
  void act() override { const std::scoped_lock lock(mutex_); }

 private:
  static rt::CyclicThreadParameters middle() {
    rt::CyclicThreadParameters parameters;
    parameters.name = "middle";
    parameters.fifo_priority = 40;
    parameters.period = milliseconds(50);
    return parameters;
  }
  std::mutex mutex_;
  std::atomic<bool> is_ending_{false};
  std::thread unimportant_{[this] {
    while (!is_ending_) {
      const std::scoped_lock lock(mutex_);
      spin(std::chrono::microseconds(200));
    }
  }};
  rt::CyclicThread middle_{middle(), [](const rt::CycleInfo&) { spin(milliseconds(10)); }};
};

class Printf : public Mutant {
 public:
  void act() override { std::fprintf(stderr, "%s", "."); }
};

class GridDrift : public Mutant {
 public:
  [[nodiscard]] bool drifts() const override { return true; }
};

}  // namespace

std::unique_ptr<Mutant> make_mutant(std::string_view name) {
  if (name == "none") return std::make_unique<Mutant>();
  if (name == "malloc") return std::make_unique<Malloc>();
  if (name == "page_touch") return std::make_unique<PageTouch>();
  if (name == "mutex") return std::make_unique<Mutex>();
  if (name == "printf") return std::make_unique<Printf>();
  if (name == "grid_drift") return std::make_unique<GridDrift>();
  return nullptr;
}

}  // namespace holdfast::rtvm
