// SPDX-License-Identifier: Apache-2.0
#include "registration/calibration_run.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

#include "registration/calibration_check.hpp"
#include "registration/calibration_start.hpp"
#include "registration/triangulation.hpp"
#include "registration/working_volume.hpp"
#include "registration/zoom_seating.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr std::size_t kFolds = 3;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

ViewError rms_of(const std::vector<ViewReport>& views) {
  ViewError sum;
  for (double ViewError::*of : {&ViewError::reprojection_left_px, &ViewError::reprojection_right_px,
                                &ViewError::epipolar_px, &ViewError::board_mm}) {
    for (const ViewReport& view : views) sum.*of += view.error.*of * view.error.*of;
    sum.*of = std::sqrt(sum.*of / static_cast<double>(views.size()));
  }
  return sum;
}

double of_both_px(const ViewError& e) {
  return std::hypot(e.reprojection_left_px, e.reprojection_right_px) / std::sqrt(2.0);
}

std::vector<ViewReport> reports_of(const ZoomViews& views,
                                   const std::vector<Eigen::Vector3d>& board_mm,
                                   const ZoomCalibration& zoom) {
  std::vector<ViewReport> reports;
  for (const BoardPair& pair : views.pairs)
    reports.push_back({pair.name, view_error(pair, board_mm, zoom)});
  return reports;
}

class Run {
 public:
  Run(const std::vector<ZoomViews>& views, cv::Size image, const CalibrationOptions& options,
      const std::function<void(const std::string&)>& progress)
      : views_(views), image_(image), options_(options), progress_(progress) {}

  CalibrationOutcome calibrate() {
    for (const ZoomViews& zoom : views_)
      if (static_cast<int>(zoom.pairs.size()) < options_.least_pairs)
        throw RefusedError(
            fmt::format("zoom {:g}: {} pairs show the whole board, at least {} are "
                        "needed",
                        zoom.zoom, zoom.pairs.size(), options_.least_pairs));
    for (const ZoomViews& zoom : views_) {
      tell(fmt::format("zoom {:g}: start", zoom.zoom));
      start_.push_back(start_of(zoom));
      check_sides(zoom, start_.back());
    }
    if (options_.method == CalibrationMethod::plain)
      adjust_plainly();
    else
      adjust_jointly();
    outcome_.calibration.image_width_px = image_.width;
    outcome_.calibration.image_height_px = image_.height;
    for (std::size_t z = 0; z < views_.size(); ++z) report(z);
    if (options_.is_held_out) hold_out();
    if (const auto what = invalid_calibration(outcome_.calibration))
      throw RefusedError("the views do not constrain the model: " + *what);
    return outcome_;
  }

 private:
  void tell(const std::string& what) const {
    if (progress_) progress_(what);
  }

  [[nodiscard]] ZoomCalibration start_of(const ZoomViews& zoom) const {
    try {
      return start_of_zoom(zoom, options_.board, image_.width, image_.height);
    } catch (const cv::Exception& e) {
      throw RefusedError(
          fmt::format("zoom {:g}: the views do not constrain the model: {}", zoom.zoom, e.err));
    }
  }

  /// The right camera lies to the right of the left one (x_right < x_left for near points).
  void check_sides(const ZoomViews& zoom, const ZoomCalibration& start) const {
    std::vector<double> side;
    for (const BoardPair& pair : zoom.pairs)
      side.push_back(right_camera_mm(pair, options_.board, start)[0]);
    const double typical = median(side);
    if (!(typical > 0))
      throw RefusedError(
          fmt::format("zoom {:g}: the right camera stands {:.1f} mm to the left of the left one: "
                      "left and right are swapped",
                      zoom.zoom, -typical));
    check_each_side(zoom, start);
  }

  /// One pair among good ones: the others' cameras explain it far better with its sides exchanged.
  void check_each_side(const ZoomViews& zoom, const ZoomCalibration& start) const {
    const auto board_mm = options_.board.points_mm();
    std::vector<double> ahead_px, exchanged_px;
    for (const BoardPair& pair : zoom.pairs) {
      ahead_px.push_back(of_both_px(view_error(pair, board_mm, start)));
      exchanged_px.push_back(
          of_both_px(view_error({pair.name, pair.right, pair.left}, board_mm, start)));
    }
    const double typical_px = median(ahead_px);
    for (std::size_t i = 0; i < ahead_px.size(); ++i)
      if (ahead_px[i] > 2 * typical_px && exchanged_px[i] < 0.5 * ahead_px[i])
        throw RefusedError(zoom.pairs[i].name + ": left and right are swapped in this pair");
  }

  /// A pair whose two images are not of one moment fits no common calibration.
  void check_pairs(const std::vector<ZoomViews>& views, const std::vector<ZoomCalibration>& zooms,
                   const std::vector<Eigen::Vector3d>& board_mm) const {
    for (std::size_t z = 0; z < views.size(); ++z) {
      std::vector<double> errors;
      for (const BoardPair& pair : views[z].pairs)
        errors.push_back(of_both_px(view_error(pair, board_mm, zooms[z])));
      const double limit_px = std::max(options_.worst_view_px, 5 * median(errors));
      for (std::size_t i = 0; i < errors.size(); ++i)
        if (!(errors[i] < limit_px))
          refuse_pair(views[z].pairs[i], board_mm, zooms[z], errors[i], limit_px);
    }
  }

  [[noreturn]] static void refuse_pair(const BoardPair& pair,
                                       const std::vector<Eigen::Vector3d>& board_mm,
                                       const ZoomCalibration& zoom, double error_px,
                                       double limit_px) {
    const BoardPair swapped{pair.name, pair.right, pair.left};
    if (of_both_px(view_error(swapped, board_mm, zoom)) < 0.5 * error_px)
      throw RefusedError(pair.name + ": left and right are swapped in this pair");
    throw RefusedError(
        fmt::format("{}: reprojection error {:.2f} px, must be below {:.2f} px: the left and the "
                    "right image do not belong together",
                    pair.name, error_px, limit_px));
  }

  void adjust_plainly() {
    outcome_.calibration.zooms.clear();
    for (const ZoomViews& zoom : views_)
      outcome_.calibration.zooms.push_back(
          plain_calibration(zoom, options_.board, image_.width, image_.height));
    board_mm_ = options_.board.points_mm();
    check_pairs(views_, outcome_.calibration.zooms, board_mm_);
  }

  void adjust_jointly() {
    tell("bundle adjustment");
    const BundleResult all = adjusted(views_, start_, nullptr);
    noise_ = all.noise;
    check_pairs(views_, all.zooms, all.board_mm);
    outcome_.corner_sigma_px = noise_.corner_sigma_px;
    outcome_.bend_mm = all.bend_mm;
    outcome_.calibration.zooms = all.zooms;
    board_mm_ = all.board_mm;
    check_constrained();
    double inflation = 0;
    for (std::size_t fold = 0; fold < kFolds; ++fold) {
      tell(fmt::format("held-out views {}/{}", fold + 1, kFolds));
      std::vector<ZoomViews> kept = views_, held = views_;
      for (std::size_t z = 0; z < views_.size(); ++z) split(views_[z], fold, kept[z], held[z]);
      const BundleResult part = adjusted(kept, all.zooms, &noise_);
      inflation +=
          covariance_inflation(held, part.zooms, part.board_mm, noise_.corner_sigma_px) / kFolds;
    }
    outcome_.covariance_inflation = inflation;
    for (std::size_t z = 0; z < views_.size(); ++z)
      outcome_.calibration.zooms[z].focus_mm = distance_mm(z);
    outcome_.seating_px = learnt_seating_px(outcome_.calibration.zooms, image_.width, image_.height,
                                            options_.seating_px);
    for (std::size_t z = 0; z < views_.size(); ++z)
      state_covariance(outcome_.calibration.zooms[z], outcome_.calibration.zooms[z].focus_mm);
  }

  /// From the bundle's covariance to that of what the next visit to this zoom will find.
  void state_covariance(ZoomCalibration& zoom, double depth_mm) const {
    const Eigen::Index n = 4 + static_cast<Eigen::Index>(zoom.distortion_left.total());
    Eigen::VectorXd seating = Eigen::VectorXd::Zero(zoom.parameter_covariance.rows());
    for (const Eigen::Index i : {Eigen::Index{2}, Eigen::Index{3}, n + 2, n + 3})
      seating[i] = outcome_.seating_px * outcome_.seating_px;
    zoom.parameter_covariance *= outcome_.covariance_inflation;
    // Twice: as it sat for the boards, which shifts the frame too, and as it will sit.
    zoom.parameter_covariance.diagonal() += seating;
    zoom.parameter_covariance =
        covariance_in_own_frame(zoom, image_.width, image_.height, depth_mm);
    zoom.parameter_covariance.diagonal() += seating;
  }

  static void split(const ZoomViews& views, std::size_t fold, ZoomViews& kept, ZoomViews& held) {
    kept.pairs.clear();
    held.pairs.clear();
    for (std::size_t i = 0; i < views.pairs.size(); ++i)
      (i % kFolds == fold ? held : kept).pairs.push_back(views.pairs[i]);
  }

  [[nodiscard]] BundleResult adjusted(const std::vector<ZoomViews>& views,
                                      const std::vector<ZoomCalibration>& start,
                                      const BundleNoise* known) const {
    try {
      BundleResult result = adjust_bundle(views, options_.board, start, image_.width, image_.height,
                                          options_.bundle, known);
      if (!result.has_converged)
        throw RefusedError("the bundle adjustment does not converge on these views");
      return result;
    } catch (const cv::Exception& e) {
      throw RefusedError("the views do not constrain the model: " + std::string(e.err));
    }
  }

  [[nodiscard]] double distance_mm(std::size_t z) const {
    std::vector<double> depths;
    for (const BoardPair& pair : views_[z].pairs) {
      std::vector<double> corners;
      for (const auto& point : triangulate(pair.left, pair.right, outcome_.calibration.zooms[z]))
        corners.push_back(point.p_camera_mm.z());
      depths.push_back(median(corners));
    }
    return median(depths);
  }

  void check_constrained() const {
    for (std::size_t z = 0; z < views_.size(); ++z) {
      const double error_mm = predicted_nonrigid_mm(outcome_.calibration.zooms[z], image_.width,
                                                    image_.height, distance_mm(z));
      if (!(error_mm <= options_.worst_nonrigid_mm))
        throw RefusedError(fmt::format(
            "zoom {:g}: the views do not constrain the model: they leave {:.2g} mm of non-rigid "
            "error (1 sigma), at most {:g} mm: tilt the board more, and in different directions",
            views_[z].zoom, error_mm, options_.worst_nonrigid_mm));
    }
  }

  void report(std::size_t z) {
    ZoomReport report;
    ZoomCalibration& zoom = outcome_.calibration.zooms[z];
    report.zoom = views_[z].zoom;
    report.views = reports_of(views_[z], board_mm_, zoom);
    report.rms = rms_of(report.views);
    report.distance_mm = distance_mm(z);
    report.predicted_nonrigid_mm =
        predicted_nonrigid_mm(zoom, image_.width, image_.height, report.distance_mm);
    zoom.focus_mm = options_.focus_mm.value_or(report.distance_mm);
    zoom.rms_px = of_both_px(report.rms);
    const double ratio = report.distance_mm / zoom.focus_mm;
    if (!(ratio > 0.67 && ratio < 1.5))
      throw RefusedError(fmt::format(
          "zoom {:g}: the boards lie {:.0f} mm away, the working distance is {:g} mm: the squares "
          "are not {:g} mm",
          report.zoom, report.distance_mm, zoom.focus_mm, options_.board.square_mm));
    outcome_.zooms.push_back(report);
  }

  void hold_out() {
    for (std::size_t z = 1; z + 1 < views_.size(); ++z) {
      tell(fmt::format("held-out zoom {:g}", views_[z].zoom));
      const auto at = static_cast<std::ptrdiff_t>(z);
      std::vector<ZoomViews> others = views_;
      others.erase(others.begin() + at);
      StereoCalibration part = outcome_.calibration;
      part.zooms.erase(part.zooms.begin() + at);
      if (options_.method == CalibrationMethod::joint) {
        part.zooms = adjusted(others, part.zooms, &noise_).zooms;
        for (ZoomCalibration& zoom : part.zooms)
          state_covariance(zoom, outcome_.zooms[z].distance_mm);
      }
      const ZoomCalibration zoom = calibration_at_zoom(part, views_[z].zoom);
      ZoomReport& report = outcome_.zooms[z];
      report.held_out = rms_of(reports_of(views_[z], board_mm_, zoom));
      report.held_out_predicted_nonrigid_mm =
          predicted_nonrigid_mm(zoom, image_.width, image_.height, report.distance_mm);
    }
  }

  const std::vector<ZoomViews>& views_;
  cv::Size image_;
  const CalibrationOptions& options_;
  const std::function<void(const std::string&)>& progress_;
  std::vector<ZoomCalibration> start_;
  std::vector<Eigen::Vector3d> board_mm_;
  BundleNoise noise_;
  CalibrationOutcome outcome_;
};

}  // namespace

CalibrationOutcome calibrate_stereo(const std::vector<ZoomViews>& views, int image_width_px,
                                    int image_height_px, const CalibrationOptions& options,
                                    const std::function<void(const std::string&)>& progress) {
  return Run(views, {image_width_px, image_height_px}, options, progress).calibrate();
}

}  // namespace holdfast::registration
