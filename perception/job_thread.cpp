// SPDX-License-Identifier: Apache-2.0
#include "perception/job_thread.hpp"

#include <utility>

namespace holdfast::perception {

JobThread::JobThread(std::function<void()> job)
    : job_(std::move(job)), thread_([this] { run(); }) {}

JobThread::~JobThread() {
  {
    const std::lock_guard lock(mutex_);
    state_ = State::ending;
  }
  changed_.notify_all();
  thread_.join();
}

void JobThread::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return state_ == State::ordered || state_ == State::ending; });
    if (state_ == State::ending) return;
    lock.unlock();
    job_();
    lock.lock();
    if (state_ == State::ending) return;
    state_ = State::done;
    changed_.notify_all();
  }
}

bool JobThread::is_idle() const {
  const std::lock_guard lock(mutex_);
  return state_ == State::idle;
}

void JobThread::order() {
  {
    const std::lock_guard lock(mutex_);
    state_ = State::ordered;
  }
  changed_.notify_all();
}

bool JobThread::take() {
  const std::lock_guard lock(mutex_);
  if (state_ != State::done) return false;
  state_ = State::idle;
  return true;
}

void JobThread::wait() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return state_ != State::ordered; });
}

}  // namespace holdfast::perception
