// SPDX-License-Identifier: Apache-2.0
// A rigid transform as ITK writes it (.tfm, LPS, mm), for 3D Slicer and other ITK tools. By ITK's
// convention it takes points of the fixed image (the CT) to the moving one (the camera): it holds
// T_camera_ct, and 3D Slicer, which inverts it on loading, then moves camera models onto the CT.
#pragma once

#include <string>

#include <Eigen/Geometry>

namespace holdfast::registration {

/// The file's content; the caller writes it.
[[nodiscard]] std::string transform_text(const Eigen::Isometry3d& T_moving_fixed);

/// Reads an affine 3-D transform whose linear part is a rotation (to 1e-6) and applies
/// its centre (FixedParameters). Throws InputError naming file and fault.
[[nodiscard]] Eigen::Isometry3d read_transform(const std::string& path);

}  // namespace holdfast::registration
