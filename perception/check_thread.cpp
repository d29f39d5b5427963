// SPDX-License-Identifier: Apache-2.0
#include "perception/check_thread.hpp"

#include <utility>

#include "perception/job_thread.hpp"

namespace holdfast::perception {

struct CheckThread::Impl {
  FeatureCheck features;
  cv::Mat image;
  CheckResult result;
  JobThread thread{[this] { result.motion = features.find(image, result.of.T_camera_site); }};

  explicit Impl(FeatureCheck f) : features(std::move(f)) {}
};

CheckThread::CheckThread(FeatureCheck features)
    : impl_(std::make_unique<Impl>(std::move(features))) {}
CheckThread::~CheckThread() = default;

bool CheckThread::order(const cv::Mat& image, const CheckedPose& of) {
  if (!impl_->thread.is_idle()) return false;
  image.copyTo(impl_->image);
  impl_->result.of = of;
  impl_->thread.order();
  return true;
}

std::optional<CheckResult> CheckThread::take() {
  if (!impl_->thread.take()) return std::nullopt;
  return std::move(impl_->result);
}

void CheckThread::wait() {
  impl_->thread.wait();
}

}  // namespace holdfast::perception
