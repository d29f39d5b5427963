// SPDX-License-Identifier: Apache-2.0
// From the corners of one board in pairs of images, over all zooms, to the calibration and the
// evidence for it; or to the reason why these views cannot carry one.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "registration/calibration_error.hpp"
#include "registration/calibration_views.hpp"
#include "registration/stereo_bundle.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

enum class CalibrationMethod {
  joint,  ///< bundle adjustment over all zooms
  plain   ///< each zoom on its own as paper A: Zhang's method through OpenCV; no covariance
};

struct CalibrationOptions {
  BoardPattern board;
  CalibrationMethod method = CalibrationMethod::joint;
  BundleOptions bundle;
  std::optional<double> focus_mm;   ///< working distance as the microscope reports it
  bool is_held_out = false;         ///< also predict each inner zoom from the others
  int least_pairs = 6;              ///< a zoom
  double worst_nonrigid_mm = 0.15;  ///< 1 sigma that the covariance may predict
  double seating_px = 0.15;  ///< expected repeatability of a principal point from visit to visit
                             ///< of a zoom (1 sigma): see learnt_seating_px
  double worst_view_px = 2;  ///< rms of one pair, beyond five times the median: no pair
};

struct ViewReport {
  std::string name;
  ViewError error;
};

struct ZoomReport {
  double zoom = 0;
  std::vector<ViewReport> views;
  ViewError rms;                      ///< over all views
  double predicted_nonrigid_mm = 0;   ///< 1 sigma; plain: infinite (unknown)
  double distance_mm = 0;             ///< median depth of the boards in the left camera
  std::optional<ViewError> held_out;  ///< rms over the views, zoom predicted from the others
  std::optional<double> held_out_predicted_nonrigid_mm;
};

struct CalibrationOutcome {
  StereoCalibration calibration;
  std::vector<ZoomReport> zooms;
  double corner_sigma_px = 0;
  double covariance_inflation = 1;
  double seating_px = 0;  ///< as assumed or learnt; part of the covariances
  Eigen::Vector3d bend_mm = Eigen::Vector3d::Zero();
};

/// `views` ascending in zoom. `progress` is told what is being done (may be empty); what it throws
/// ends the work. Throws RefusedError, one line naming zoom or pair, value and limit: too few
/// pairs; left and right swapped, in all or in one pair; a pair whose images do not belong
/// together; views that do not constrain the model (as its covariance shows); a distance that
/// contradicts `focus_mm` (wrong square size).
[[nodiscard]] CalibrationOutcome calibrate_stereo(
    const std::vector<ZoomViews>& views, int image_width_px, int image_height_px,
    const CalibrationOptions& options, const std::function<void(const std::string&)>& progress);

}  // namespace holdfast::registration
