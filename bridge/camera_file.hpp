// SPDX-License-Identifier: Apache-2.0
// camera.yaml as OpenCV's calibration samples write it: image_width, image_height, camera_matrix,
// distortion_coefficients.
#pragma once

#include <string>

#include "perception/camera_model.hpp"

namespace holdfast::bridge {

/// Every value is checked. Throws InputError, naming file, key, value and limit.
[[nodiscard]] perception::CameraModel read_camera_file(const std::string& path);

}  // namespace holdfast::bridge
