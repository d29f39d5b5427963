// SPDX-License-Identifier: Apache-2.0
// A surface file (registration/mesh_file) as the depth map a camera would see. The surface is in
// the camera's frame, or, when it carries `comment R1 r11 ... r33`, in the rectified frame
// R1 * camera.
#pragma once

#include <string>

#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"

namespace holdfast::bridge {

/// Depth (mm, CV_32FC1, NaN where no triangle is) on the camera's undistorted pixel grid; of
/// several triangles the nearest counts. Throws InputError for an unreadable, truncated or empty
/// file.
[[nodiscard]] cv::Mat depth_from_surface_file(const std::string& path,
                                              const perception::CameraModel& camera);

}  // namespace holdfast::bridge
