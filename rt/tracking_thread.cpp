// SPDX-License-Identifier: Apache-2.0
#include "rt/tracking_thread.hpp"

#include <cmath>
#include <cstring>

#include <fmt/format.h>
#include <pthread.h>

#include "bridge/depth_file.hpp"
#include "bridge/image_file.hpp"
#include "perception/direct_tracker.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

perception::SiteGeometry read_geometry(const DaemonConfig& config) {
  const cv::Mat depth_mm =
      bridge::read_depth_file(config.registration.depth.string(), config.calibration.width_px,
                              config.calibration.height_px);
  if (config.site_model == SiteModel::depth) return perception::SiteDepth{depth_mm};
  const auto row = static_cast<int>(std::lround(config.calibration.cy_px));
  const auto column = static_cast<int>(std::lround(config.calibration.cx_px));
  const bool is_inside = row >= 0 && row < depth_mm.rows && column >= 0 && column < depth_mm.cols;
  const float depth = is_inside ? depth_mm.at<float>(row, column) : std::nanf("");
  if (!(depth > 0))
    throw InputError(
        fmt::format("{}: no depth under the optical axis, pixel {},{}: a planar site "
                    "needs it",
                    config.registration.depth.string(), column, row));
  return perception::SitePlane{static_cast<double>(depth)};
}

perception::DirectTracker make_tracker(const DaemonConfig& config) {
  const cv::Mat keyframe = bridge::read_image_file(config.registration.keyframe.string());
  perception::TrackerParameters parameters = config.tracker;
  parameters.check.is_threaded = true;
  perception::DirectTracker tracker{config.calibration, parameters};
  const auto refusal = tracker.set_keyframe(keyframe, read_geometry(config));
  if (refusal != perception::TrackingReason::none)
    throw InputError(fmt::format("{}: cannot serve as keyframe: {}",
                                 config.registration.keyframe.string(), perception::name(refusal)));
  return tracker;
}

}  // namespace

TrackingThread::TrackingThread(const DaemonConfig& config, FrameIntake& intake) : intake_(intake) {
  perception::DirectTracker tracker = make_tracker(config);
  if (config.live_view) live_.emplace(*config.live_view, config.calibration, config.tracker.mask);
  thread_ =
      std::thread{[this, id = config.registration.id(), tracker = std::move(tracker)]() mutable {
        IntakeFrame frame;
        while (intake_.wait_frame(frame)) {
          StampedEstimate estimate;
          estimate.motion = tracker.track(frame.image, frame.t_exposure);
          estimate.registration_id = id;
          estimate.frame = frame.frame;
          estimate.t_frame_received = frame.t_received;
          estimate.t_published = monotonic_now();
          for_control_.publish(estimate);
          for_publishing_.publish(estimate);
          if (live_) live_->offer(frame.image, frame.frame, estimate.motion, tracker);
        }
      }};
  pthread_setname_np(thread_.native_handle(), "tracker");
  if (config.loop.tracker_priority == 0) return;
  sched_param scheduling{};
  scheduling.sched_priority = config.loop.tracker_priority;
  const int code = pthread_setschedparam(thread_.native_handle(), SCHED_FIFO, &scheduling);
  if (code == 0) return;
  const std::string denied =
      fmt::format("tracker: SCHED_FIFO priority {} denied: {}; raise RLIMIT_RTPRIO or run as root",
                  scheduling.sched_priority, std::strerror(code));
  if (config.loop.allow_non_rt) {
    warnings_.push_back(denied);
    return;
  }
  intake_.close();
  thread_.join();
  throw UnavailableError(denied);
}

TrackingThread::~TrackingThread() {
  intake_.close();
  if (thread_.joinable()) thread_.join();
}

}  // namespace holdfast::rt
