// SPDX-License-Identifier: Apache-2.0
// What the room's writers share: folders, images, and truth as JSON.
#pragma once

#include <filesystem>

#include <Eigen/Geometry>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "registration/stereo_calibration.hpp"
#include "tests/sim/or/dicom_series.hpp"
#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

/// Throws InputError when it cannot be made.
void make_folder(const std::filesystem::path& path);

/// Whole or not at all; PNG or JPEG by its ending. Throws InputError.
void write_image(const std::filesystem::path& path, const cv::Mat& image);

[[nodiscard]] nlohmann::json as_json(const Eigen::Isometry3d& T);  ///< 4x4, row-major
[[nodiscard]] nlohmann::json as_json(const Eigen::Vector3d& p);
[[nodiscard]] nlohmann::json as_json(const registration::ZoomCalibration& zoom);
/// The truth about a CT scan: its UIDs; markers, beads and the region of interest in ct.
[[nodiscard]] nlohmann::json ct_truth(const Phantom& phantom, const DicomSeries& series);
/// Markers and beads, in ct and in the camera's frame.
[[nodiscard]] nlohmann::json markers_json(const Phantom& phantom,
                                          const Eigen::Isometry3d& T_camera_ct);

}  // namespace holdfast::sim
