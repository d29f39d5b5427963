// SPDX-License-Identifier: Apache-2.0
#include "registration/stereo_bundle.hpp"

#include <memory>

#include <ceres/problem.h>
#include <ceres/solver.h>

#include "registration/bundle_corners.hpp"
#include "registration/bundle_covariance.hpp"
#include "registration/bundle_priors.hpp"
#include "registration/bundle_smoothness.hpp"
#include "registration/bundle_unknowns.hpp"
#include "registration/triangulation.hpp"

namespace holdfast::registration {
namespace {

/// Solves, and weighs anew by what the solution shows, until nothing much changes.
class Bundle {
 public:
  Bundle(const std::vector<ZoomViews>& views, const BoardPattern& board,
         const std::vector<ZoomCalibration>& start, cv::Size image, const BundleOptions& options)
      : views_(views),
        board_(board),
        start_(start),
        image_(image),
        options_(options),
        sightings_(bundle::sightings_of(views, board)) {
    for (const ZoomCalibration& zoom : start) unknowns_.zooms.push_back(bundle::from_opencv(zoom));
    place_boards(start);
    if (options.is_joint) contrasts_ = bundle::contrasts(views);
  }

  BundleResult run(const BundleNoise* known) {
    if (known != nullptr)
      noise_ = *known;
    else
      start_crudely();
    bool has_converged = false;
    for (int round = 0; round < kRounds; ++round) {
      has_converged = solve();
      if (known == nullptr)
        noise_.corner_sigma_px = bundle::estimated_sigma_px(
            unknowns_, sightings_, options_.outlier_sigma * noise_.corner_sigma_px);
      estimate_covariance();
      // Expectation maximisation creeps near its end; a factor of 1.2 in a deviation changes
      // little.
      if (known != nullptr || (learn_smoothness() < 0.2 && round > 0)) break;
    }
    return result(has_converged);
  }

 private:
  static constexpr int kRounds = 5;

  /// A crude start tilts some boards the wrong way, and a bound against outliers would keep them
  /// there: first with a wide bound, then with the boards placed anew.
  void start_crudely() {
    noise_.smooth_sigma = bundle::first_smooth_sigma(unknowns_.zooms.front(), image_, options_);
    noise_.corner_sigma_px = 3;
    (void)solve();
    place_boards(zooms());
    noise_.corner_sigma_px = 0.3;
  }

  void place_boards(const std::vector<ZoomCalibration>& zooms) {
    unknowns_.poses.clear();
    for (const bundle::Sighting& sighting : sightings_) {
      const Eigen::Matrix<double, 6, 1> pose = triangulated_pose(
          sighting.pair->left, sighting.pair->right, board_.points_mm(), zooms[sighting.zoom]);
      Eigen::Map<Eigen::Matrix<double, 6, 1>>(unknowns_.poses.emplace_back().data()) = pose;
    }
  }

  void build(ceres::Problem& problem) {
    bundle::add_corners(problem, unknowns_, sightings_, noise_.corner_sigma_px,
                        options_.outlier_sigma);
    bundle::add_priors(problem, unknowns_, image_, options_);
    bundle::add_smoothness(problem, unknowns_, contrasts_, noise_.smooth_sigma);
  }

  [[nodiscard]] bool solve() {
    ceres::Problem problem;
    build(problem);
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::DENSE_SCHUR;
    solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    for (auto& pose : unknowns_.poses)
      solver.linear_solver_ordering->AddElementToGroup(pose.data(), 0);
    for (bundle::ZoomUnknowns& zoom : unknowns_.zooms)
      for (double* block : zoom.blocks())
        solver.linear_solver_ordering->AddElementToGroup(block, 1);
    solver.linear_solver_ordering->AddElementToGroup(unknowns_.bend.data(), 1);
    solver.max_num_iterations = 50;
    solver.function_tolerance = 1e-6;
    solver.logging_type = ceres::SILENT;
    solver.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem, &summary);
    return summary.IsSolutionUsable();
  }

  void estimate_covariance() {
    ceres::Problem problem;
    build(problem);
    covariance_ = bundle::zooms_covariance(problem, unknowns_, options_);
  }

  double learn_smoothness() {
    return bundle::learn_smoothness(unknowns_.zooms, covariance_, contrasts_, noise_.smooth_sigma);
  }

  [[nodiscard]] std::vector<ZoomCalibration> zooms() const {
    std::vector<ZoomCalibration> list;
    for (std::size_t z = 0; z < views_.size(); ++z) {
      ZoomCalibration& zoom = list.emplace_back(
          bundle::to_opencv(unknowns_.zooms[z], options_.coefficients, start_[z]));
      zoom.zoom = views_[z].zoom;
      zoom.pairs_used = static_cast<int>(views_[z].pairs.size());
    }
    return list;
  }

  [[nodiscard]] BundleResult result(bool has_converged) const {
    BundleResult result;
    result.has_converged = has_converged;
    result.noise = noise_;
    result.bend_mm = Eigen::Vector3d(unknowns_.bend.data());
    result.board_mm = bundle::bent_board_mm(board_, unknowns_.bend);
    result.zooms = zooms();
    for (std::size_t z = 0; z < result.zooms.size(); ++z) {
      const auto at = static_cast<Eigen::Index>(z) * bundle::kOfZoom;
      result.zooms[z].parameter_covariance =
          bundle::to_opencv_covariance(unknowns_.zooms[z], options_.coefficients,
                                       covariance_.block(at, at, bundle::kOfZoom, bundle::kOfZoom));
    }
    return result;
  }

  const std::vector<ZoomViews>& views_;
  BoardPattern board_;
  const std::vector<ZoomCalibration>& start_;
  cv::Size image_;
  BundleOptions options_;
  std::vector<bundle::Sighting> sightings_;
  Eigen::MatrixXd contrasts_;
  bundle::Unknowns unknowns_;
  BundleNoise noise_;
  Eigen::MatrixXd covariance_;  // of the zooms' unknowns
};

}  // namespace

BundleResult adjust_bundle(const std::vector<ZoomViews>& views, const BoardPattern& board,
                           const std::vector<ZoomCalibration>& start, int image_width_px,
                           int image_height_px, const BundleOptions& options,
                           const BundleNoise* known) {
  return Bundle(views, board, start, {image_width_px, image_height_px}, options).run(known);
}

}  // namespace holdfast::registration
