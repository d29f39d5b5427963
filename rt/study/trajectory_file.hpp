// SPDX-License-Identifier: Apache-2.0
// A trajectory as text: poses.csv (docs/interfaces.md) and the TUM format.
#pragma once

#include <chrono>
#include <string>

#include "perception/motion_estimate.hpp"

namespace holdfast::rt {

/// The line of column names.
[[nodiscard]] std::string trajectory_header();
/// One line a frame. Of a lost one nothing stands after its status.
[[nodiscard]] std::string trajectory_row(int frame, std::chrono::nanoseconds t_frame,
                                         const perception::MotionEstimate& estimate);
/// Time in s, position in m, quaternion: one line a pose, none for a lost frame.
[[nodiscard]] std::string tum_row(std::chrono::nanoseconds t_frame,
                                  const perception::MotionEstimate& estimate);

}  // namespace holdfast::rt
