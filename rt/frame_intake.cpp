// SPDX-License-Identifier: Apache-2.0
#include "rt/frame_intake.hpp"

#include <utility>

namespace holdfast::rt {
namespace {

using bridge::CameraEvent;
using safety::Reason;

safety::ReasonSet faults_of(CameraEvent event) {
  safety::ReasonSet faults;
  switch (event) {
    case CameraEvent::incomplete:
      faults.insert(Reason::frame_incomplete);
      break;
    case CameraEvent::gap:
      faults.insert(Reason::frame_gap);
      break;
    case CameraEvent::time_invalid:
      faults.insert(Reason::frame_time_invalid);
      break;
    case CameraEvent::disconnected:
      faults.insert(Reason::camera_disconnected);
      break;
    case CameraEvent::silent:
      faults.insert(Reason::frame_late);
      break;
    case CameraEvent::connected:
    case CameraEvent::frame:
      break;
  }
  return faults;
}

}  // namespace

void FrameIntake::on_report(const bridge::CameraReport& report) {
  FrameArrival arrival;
  arrival.frame = report.frame_id;
  arrival.t_received = report.t_received;
  arrival.t_exposure = report.t_exposure;
  arrival.is_connected = report.event != CameraEvent::disconnected;
  arrival.is_frame = report.event == CameraEvent::frame;
  arrival.faults = faults_of(report.event);
  if (report.event == CameraEvent::connected) check_.forget_previous();
  if (arrival.is_frame) arrival.faults.insert(check_.check(report.image));
  // An overflow is counted by the queue; the control loop reads the count and stops.
  (void)arrivals_.try_push(arrival);
  if (!arrival.is_frame) return;
  clock_sigma_ns_.store(report.clock_offset_sigma.count(), std::memory_order_relaxed);
  if (arrival.faults.empty()) hand_over(report);
}

void FrameIntake::hand_over(const bridge::CameraReport& report) {
  if (report.image.depth() == CV_16U)
    report.image.convertTo(writing_.image, CV_8U, 1.0 / 16.0);  // 12 significant bits
  else
    report.image.copyTo(writing_.image);  // reuses the buffer: the size is constant
  writing_.frame = report.frame_id;
  writing_.t_received = report.t_received;
  writing_.t_exposure = report.t_exposure;
  {
    const std::lock_guard lock{mutex_};
    std::swap(writing_, waiting_);
    if (is_fresh_) skipped_.fetch_add(1, std::memory_order_relaxed);
    is_fresh_ = true;
  }
  fresh_.notify_one();
}

bool FrameIntake::wait_frame(IntakeFrame& frame) {
  std::unique_lock lock{mutex_};
  fresh_.wait(lock, [this] { return is_fresh_ || is_closed_; });
  if (is_closed_) return false;
  std::swap(frame, waiting_);
  is_fresh_ = false;
  return true;
}

void FrameIntake::close() {
  {
    const std::lock_guard lock{mutex_};
    is_closed_ = true;
  }
  fresh_.notify_all();
}

}  // namespace holdfast::rt
