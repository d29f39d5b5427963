// SPDX-License-Identifier: Apache-2.0
// A few threads that share out numbered tasks. What a task computes may depend on its number only,
// so that results do not depend on how many threads there are.
#pragma once

#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace holdfast::registration {

class WorkerPool {
 public:
  /// `threads` in all, the caller of run() included; at least 1.
  explicit WorkerPool(int threads);
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  /// Runs task(0) … task(count - 1), in no fixed order, and returns when all are done. After an
  /// exception no further task begins; once all threads have stopped, that of the smallest number
  /// is thrown on, however the threads ran. One caller at a time; not from a task.
  void run(int count, const std::function<void(int)>& task);
  [[nodiscard]] int threads() const { return static_cast<int>(helpers_.size()) + 1; }

 private:
  void help();
  void work();

  std::mutex mutex_;
  std::condition_variable has_work_, is_done_;
  const std::function<void(int)>* task_ = nullptr;
  int next_ = 0, count_ = 0, working_ = 0, failed_ = 0;
  bool is_ending_ = false;
  std::exception_ptr failure_;
  std::vector<std::thread> helpers_;
};

}  // namespace holdfast::registration
