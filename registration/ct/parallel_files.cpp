// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/parallel_files.hpp"

#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace holdfast::registration {

void for_each_file(std::size_t count, int threads,
                   const std::function<void(std::size_t done, std::size_t total)>& progress,
                   const std::function<void(std::size_t k)>& work) {
  std::atomic<std::size_t> next{0};
  std::mutex mutex;  // of what follows
  std::size_t done = 0, failed_at = count;
  std::exception_ptr failure;
  const auto run = [&] {
    // Numbers are handed out in order, so whatever is smaller than a failed one was begun before
    // it and will report too.
    for (std::size_t k = next.fetch_add(1); k < count; k = next.fetch_add(1)) {
      std::exception_ptr caught;
      try {
        work(k);
      } catch (...) {
        caught = std::current_exception();
      }
      const std::lock_guard lock(mutex);
      try {
        if (!caught && progress) progress(++done, count);
      } catch (...) {
        caught = std::current_exception();
      }
      if (!caught) continue;
      next.store(count);
      if (k < failed_at) {
        failed_at = k;
        failure = caught;
      }
    }
  };
  {
    std::vector<std::jthread> helpers;
    for (int t = 1; t < threads; ++t) helpers.emplace_back(run);
    run();
  }
  if (failure) std::rethrow_exception(failure);
}

}  // namespace holdfast::registration
