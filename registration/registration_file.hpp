// SPDX-License-Identifier: Apache-2.0
// The registration file (registration.json): where the CT lies in the camera at the keyframe, how
// well that is known, and which keyframe, depth, optics and CT it belongs to. It is sealed: a
// SHA-256 over its content, and one over each file it refers to. A file that does not match is
// refused.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace holdfast::registration {

struct TargetError {
  Eigen::Vector3d p_target_ct_mm = Eigen::Vector3d::Zero();  ///< CT, LPS
  double rms_mm = 0;                                         ///< predicted TRE there
  Eigen::Matrix3d covariance_mm2 = Eigen::Matrix3d::Zero();
};

/// How far the reconstructed surface lies from the CT's (mm), over the overlap.
struct SurfaceAgreement {
  double mean_mm = 0, rmse_mm = 0;
  double overlap = 0;  ///< share of the reconstruction that lies on the CT surface, 0..1
};

struct Registration {
  Eigen::Isometry3d T_camera_ct = Eigen::Isometry3d::Identity();  ///< at the keyframe
  /// tx,ty,tz,rx,ry,rz (mm, rad), fixed camera axes: p_camera = Exp(r)·R·p_ct + t + dt.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  double fre_mm = 0;
  std::vector<TargetError> tre;
  double zoom = 0;
  double focus_mm = 0;
  std::string ct_identity;
  std::optional<SurfaceAgreement> closest_point;
  /// Image; in the file relative to it. Keyframe and depth may be empty: such a registration is for
  /// measuring, and a daemon refuses it.
  std::filesystem::path keyframe;
  std::filesystem::path depth;  ///< 32-bit float TIFF, mm, on the keyframe's undistorted grid
  std::string checksum;         ///< "sha256:" and 64 hex digits; set by load and save
  [[nodiscard]] std::uint64_t id() const;  ///< the checksum's first 64 bits
};

/// Reads and verifies. Throws InputError naming the file and what is wrong: missing or mistyped
/// member, number that is not finite, rotation that is not one, covariance that is not symmetric
/// and positive semi-definite, wrong checksum, keyframe or depth that is missing or was changed.
[[nodiscard]] Registration load_registration(const std::filesystem::path& file);

/// The file's content for `registration`, sealed; `folder` is where it will stand, with the
/// keyframe and depth files already in place. The caller writes it. Throws InputError on a
/// registration that load_registration would refuse.
[[nodiscard]] std::string sealed_registration(const Registration& registration,
                                              const std::filesystem::path& folder);

}  // namespace holdfast::registration
