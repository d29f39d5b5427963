// SPDX-License-Identifier: Apache-2.0
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/camera_file.hpp"
#include "bridge/depth_file.hpp"
#include "registration/registration_file.hpp"
#include "tests/sim/demo/rig.hpp"

namespace holdfast::sim {

void write_registration(const std::filesystem::path& folder) {
  const perception::CameraModel camera =
      bridge::read_camera_file((folder / "camera.yaml").string());
  const cv::Mat depth_mm =
      bridge::read_depth_file((folder / "depth.tiff").string(), camera.width_px, camera.height_px);
  const double z_mm = static_cast<double>(
      depth_mm.at<float>(static_cast<int>(camera.cy_px), static_cast<int>(camera.cx_px)));

  registration::Registration registration;
  // Any rigid motion would do; this one has no axis in common with the camera.
  // The CT's origin lies in the ear, as that of a CT cropped to it does: the covariance is about
  // it.
  const Eigen::Vector3d p_target_ct_mm{12.0, -8.5, 21.0};
  registration.T_camera_ct = Eigen::Translation3d{0, 0, z_mm} *
                             Eigen::AngleAxisd{2.1, Eigen::Vector3d{0.3, -0.8, 0.52}.normalized()} *
                             Eigen::Translation3d{-p_target_ct_mm};
  constexpr double kSigmaMm = 0.08,
                   kSigmaRad = 0.001;  // what paper A's set-up leaves after averaging
  registration.covariance.diagonal() << kSigmaMm * kSigmaMm, kSigmaMm * kSigmaMm,
      kSigmaMm * kSigmaMm, kSigmaRad * kSigmaRad, kSigmaRad * kSigmaRad, kSigmaRad * kSigmaRad;
  registration.fre_mm = 0.1;
  registration.zoom = 1.1;
  registration.focus_mm = 200;
  registration.ct_identity = "virtual operating room";
  registration::TargetError target;
  target.p_target_ct_mm = p_target_ct_mm;
  target.rms_mm = 0.14;
  target.covariance_mm2 = Eigen::Matrix3d::Identity() * kSigmaMm * kSigmaMm;
  registration.tre.push_back(target);
  registration.keyframe = "keyframe.png";
  registration.depth = "depth.tiff";
  bridge::write_file_atomically((folder / "registration.json").string(),
                                registration::sealed_registration(registration, folder));
}

}  // namespace holdfast::sim
