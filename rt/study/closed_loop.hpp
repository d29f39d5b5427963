// SPDX-License-Identifier: Apache-2.0
// The control step in virtual time over the estimates of a tracked sequence: what a robot would
// have been told, millisecond by millisecond. Between tracker and robot everything that decides is
// the product's own code; what a network and a scheduler add is declared, not measured.
#pragma once

#include <chrono>
#include <span>
#include <string>

#include <Eigen/Core>

#include "perception/motion_estimate.hpp"

namespace holdfast::rt {

struct ClosedLoopSettings {
  double rate_hz = 60;  ///< of the frames
  /// From mid-exposure: a 1080p frame has arrived over GigE; its estimate is handed over.
  std::chrono::nanoseconds arrival = std::chrono::milliseconds(8);
  std::chrono::nanoseconds estimate = std::chrono::milliseconds(11);
  std::chrono::nanoseconds pose_lead{0};  ///< safety::Limits::pose_lead
  Eigen::Vector3d p_target_site_mm = Eigen::Vector3d::Zero();
};

struct ClosedLoopRun {
  std::string commands;     ///< CSV: t_ns (of the estimates' clock), is_permitted, T_camera_site of
                            ///< the approved pose (tx_mm ... qw), empty while not permitted
  int stops = 0;            ///< latched ones, each acknowledged, confirmed and armed again at once
  std::string stop_causes;  ///< of them, each once, separated by spaces
};

/// `estimates`: one a frame, in the order of time. The registration and T_robot_camera are exact,
/// the optics fixed, the robot well; so what errs is tracking, prediction and permission. From the
/// first estimate to the last. Pure.
[[nodiscard]] ClosedLoopRun run_closed_loop(std::span<const perception::MotionEstimate> estimates,
                                            const ClosedLoopSettings& settings);

}  // namespace holdfast::rt
