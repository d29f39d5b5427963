// SPDX-License-Identifier: Apache-2.0
#include "registration/worker_pool.hpp"

namespace holdfast::registration {

WorkerPool::WorkerPool(int threads) {
  for (int i = 1; i < threads; ++i) helpers_.emplace_back([this] { help(); });
}

WorkerPool::~WorkerPool() {
  {
    const std::lock_guard lock(mutex_);
    is_ending_ = true;
  }
  has_work_.notify_all();
  for (std::thread& helper : helpers_) helper.join();
}

void WorkerPool::run(int count, const std::function<void(int)>& task) {
  {
    const std::lock_guard lock(mutex_);
    task_ = &task;
    next_ = 0;
    count_ = count;
    failed_ = count;
    failure_ = nullptr;
    working_ = 1;
  }
  if (count > 1) has_work_.notify_all();
  work();
  std::unique_lock lock(mutex_);
  is_done_.wait(lock, [this] { return working_ == 0; });
  task_ = nullptr;
  if (failure_) std::rethrow_exception(failure_);
}

void WorkerPool::help() {
  for (;;) {
    {
      std::unique_lock lock(mutex_);
      has_work_.wait(lock, [this] { return is_ending_ || (task_ != nullptr && next_ < count_); });
      if (is_ending_) return;
      ++working_;
    }
    work();
  }
}

/// Takes tasks until none is left; the caller has counted itself in `working_`.
void WorkerPool::work() {
  std::unique_lock lock(mutex_);
  while (next_ < count_) {
    const int mine = next_++;
    lock.unlock();
    try {
      (*task_)(mine);
      lock.lock();
    } catch (...) {
      lock.lock();
      next_ = count_;
      // Numbers are handed out in order: whatever is smaller has begun before, and will report too.
      if (mine >= failed_) continue;
      failed_ = mine;
      failure_ = std::current_exception();
    }
  }
  if (--working_ == 0) is_done_.notify_all();
}

}  // namespace holdfast::registration
