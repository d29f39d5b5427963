// SPDX-License-Identifier: Apache-2.0
#include "perception/check_thread.hpp"

#include <condition_variable>
#include <mutex>
#include <thread>

namespace holdfast::perception {

struct CheckThread::Impl {
  enum class State : std::uint8_t { idle, ordered, done, ending };

  FeatureCheck features;
  std::mutex mutex;  // of state; the rest belongs to the thread while ordered, else to the owner
  std::condition_variable changed;
  State state = State::idle;
  cv::Mat image;
  CheckResult result;
  std::thread thread;

  explicit Impl(FeatureCheck f) : features(std::move(f)), thread([this] { run(); }) {}

  void run() {
    std::unique_lock lock(mutex);
    while (true) {
      changed.wait(lock, [this] { return state == State::ordered || state == State::ending; });
      if (state == State::ending) return;
      lock.unlock();
      result.motion = features.find(image, result.of.T_camera_site);
      lock.lock();
      if (state == State::ending) return;
      state = State::done;
      changed.notify_all();
    }
  }
};

CheckThread::CheckThread(FeatureCheck features)
    : impl_(std::make_unique<Impl>(std::move(features))) {}

CheckThread::~CheckThread() {
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->state = Impl::State::ending;
  }
  impl_->changed.notify_all();
  impl_->thread.join();
}

bool CheckThread::order(const cv::Mat& image, const CheckedPose& of) {
  {
    const std::lock_guard lock(impl_->mutex);
    if (impl_->state != Impl::State::idle) return false;
  }
  image.copyTo(impl_->image);
  impl_->result.of = of;
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->state = Impl::State::ordered;
  }
  impl_->changed.notify_all();
  return true;
}

std::optional<CheckResult> CheckThread::take() {
  const std::lock_guard lock(impl_->mutex);
  if (impl_->state != Impl::State::done) return std::nullopt;
  impl_->state = Impl::State::idle;
  return std::move(impl_->result);
}

void CheckThread::wait() {
  std::unique_lock lock(impl_->mutex);
  impl_->changed.wait(lock, [this] { return impl_->state != Impl::State::ordered; });
}

}  // namespace holdfast::perception
