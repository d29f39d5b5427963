// SPDX-License-Identifier: Apache-2.0
#include "registration/stereo_bundle.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <opencv2/calib3d.hpp>

#include "registration/triangulation.hpp"

namespace holdfast::registration {
namespace {

// A camera: log fx, log fy, cx, cy, k1 k2 p1 p2 k3 s1 s2 s3 s4 (no k4..k6).
constexpr int kIntrinsics = 13;
constexpr int kExtrinsics = 6;  // rotation vector and T: left to right camera
constexpr int kPose = 6;        // rotation vector and translation: board to left camera
constexpr int kBend = 3;
constexpr int kOfZoom = 2 * kIntrinsics + kExtrinsics;

/// OpenCV's projection (calib3d, "Detailed Description").
template <typename T>
void project(const T* camera, const T* p, T* pixel) {
  const T x = p[0] / p[2], y = p[1] / p[2], r2 = x * x + y * y;
  const T radial = 1.0 + r2 * (camera[4] + r2 * (camera[5] + r2 * camera[8]));
  const T& p1 = camera[6];
  const T& p2 = camera[7];
  const T xd =
      x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (camera[9] + camera[10] * r2);
  const T yd =
      y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (camera[11] + camera[12] * r2);
  pixel[0] = exp(camera[0]) * xd + camera[2];
  pixel[1] = exp(camera[1]) * yd + camera[3];
}

/// One corner: flat place (mm), the same in -1..1 over the board (u, v), and where it was seen.
struct Corner {
  double x_mm, y_mm, u, v, left[2], right[2];
};

template <typename T>
void to_left_camera(const Corner& corner, const T* pose, const T* bend, T* p) {
  const T flat[3] = {T(corner.x_mm), T(corner.y_mm),
                     bend[0] * (corner.u * corner.u) + bend[1] * (corner.u * corner.v) +
                         bend[2] * (corner.v * corner.v)};
  ceres::AngleAxisRotatePoint(pose, flat, p);
  for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];
}

struct LeftResidual {
  Corner corner;
  double sigma_px;
  template <typename T>
  bool operator()(const T* camera, const T* pose, const T* bend, T* residual) const {
    T p[3], pixel[2];
    to_left_camera(corner, pose, bend, p);
    if (p[2] < 1e-3) return false;
    project(camera, p, pixel);
    for (int i = 0; i < 2; ++i) residual[i] = (pixel[i] - corner.left[i]) / sigma_px;
    return true;
  }
};

struct RightResidual {
  Corner corner;
  double sigma_px;
  template <typename T>
  bool operator()(const T* camera, const T* extrinsics, const T* pose, const T* bend,
                  T* residual) const {
    T p[3], q[3], pixel[2];
    to_left_camera(corner, pose, bend, p);
    ceres::AngleAxisRotatePoint(extrinsics, p, q);
    for (int i = 0; i < 3; ++i) q[i] += extrinsics[3 + i];
    if (q[2] < 1e-3) return false;
    project(camera, q, pixel);
    for (int i = 0; i < 2; ++i) residual[i] = (pixel[i] - corner.right[i]) / sigma_px;
    return true;
  }
};

/// (value - mean) / sigma, elementwise.
struct Prior {
  std::vector<double> mean, sigma;
  template <typename T>
  bool operator()(const T* const* value, T* residual) const {
    for (std::size_t i = 0; i < mean.size(); ++i) residual[i] = (value[0][i] - mean[i]) / sigma[i];
    return true;
  }
};

/// fx/fy: the pixels are square.
struct AspectPrior {
  template <typename T>
  bool operator()(const T* camera, T* residual) const {
    residual[0] = (camera[0] - camera[1]) / 2e-3;
    return true;
  }
};

/// What of one block a parabola over zoom does not explain: sum_z contrast(z) · block_z / sigma.
class SmoothResidual : public ceres::CostFunction {
 public:
  SmoothResidual(Eigen::VectorXd contrast, Eigen::VectorXd sigma)
      : contrast_(std::move(contrast)), sigma_(std::move(sigma)) {
    set_num_residuals(static_cast<int>(sigma_.size()));
    for (Eigen::Index z = 0; z < contrast_.size(); ++z)
      mutable_parameter_block_sizes()->push_back(static_cast<int>(sigma_.size()));
  }
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Eigen::Index n = sigma_.size();
    Eigen::Map<Eigen::VectorXd> residual(residuals, n);
    residual.setZero();
    for (Eigen::Index z = 0; z < contrast_.size(); ++z) {
      residual += contrast_[z] * Eigen::Map<const Eigen::VectorXd>(blocks[z], n);
      if (jacobians == nullptr || jacobians[z] == nullptr) continue;
      Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> jacobian(
          jacobians[z], n, n);
      jacobian = (contrast_[z] * sigma_.cwiseInverse()).asDiagonal();
    }
    residual.array() /= sigma_.array();
    return true;
  }

 private:
  Eigen::VectorXd contrast_, sigma_;
};

struct ZoomBlocks {
  std::array<double, kIntrinsics> left{}, right{};
  std::array<double, kExtrinsics> extrinsics{};
};

void from_opencv(const cv::Matx33d& K, const cv::Mat& distortion,
                 std::array<double, kIntrinsics>& camera) {
  camera = {std::log(K(0, 0)), std::log(K(1, 1)), K(0, 2), K(1, 2)};
  const auto n = static_cast<int>(distortion.total());
  for (int i = 0; i < std::min(n, 5); ++i)
    camera[4 + static_cast<std::size_t>(i)] = distortion.at<double>(i);
  for (int i = 8; i < std::min(n, 12); ++i)
    camera[1 + static_cast<std::size_t>(i)] = distortion.at<double>(i);
}

void to_opencv(const std::array<double, kIntrinsics>& camera, int coefficients, cv::Matx33d& K,
               cv::Mat& distortion) {
  K = {std::exp(camera[0]), 0, camera[2], 0, std::exp(camera[1]), camera[3], 0, 0, 1};
  // A new array: assigning zeros() would write into one that copies of the record share.
  distortion = cv::Mat(1, coefficients, CV_64F, cv::Scalar(0));
  for (int i = 0; i < 5; ++i) distortion.at<double>(i) = camera[4 + static_cast<std::size_t>(i)];
  for (int i = 8; i < coefficients; ++i)
    distortion.at<double>(i) = camera[1 + static_cast<std::size_t>(i)];
}

/// Orthonormal contrasts that every parabola over `x` annuls: (size - 3) columns.
Eigen::MatrixXd contrasts(const std::vector<double>& x) {
  const auto n = static_cast<Eigen::Index>(x.size());
  if (n < 4) return Eigen::MatrixXd::Zero(n, 0);
  Eigen::MatrixXd powers(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double centred = x[static_cast<std::size_t>(i)] - x[0];
    powers.row(i) << 1, centred, centred * centred;
  }
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(powers);
  const Eigen::MatrixXd q = qr.householderQ() * Eigen::MatrixXd::Identity(n, n);
  return q.rightCols(n - 3);
}

class Bundle {
 public:
  Bundle(const std::vector<ZoomViews>& views, const BoardPattern& board,
         const std::vector<ZoomCalibration>& start, cv::Size image, const BundleOptions& options)
      : views_(views), board_(board), start_(start), image_(image), options_(options) {
    for (std::size_t z = 0; z < views.size(); ++z) {
      x_.push_back(std::log(views[z].zoom));
      ZoomBlocks& blocks = zooms_.emplace_back();
      from_opencv(start[z].camera_matrix_left, start[z].distortion_left, blocks.left);
      from_opencv(start[z].camera_matrix_right, start[z].distortion_right, blocks.right);
      cv::Vec3d rotation;
      cv::Rodrigues(start[z].R, rotation);
      for (std::size_t i = 0; i < 3; ++i) {
        blocks.extrinsics.at(i) = rotation[static_cast<int>(i)];
        blocks.extrinsics.at(3 + i) = start[z].T[static_cast<int>(i)];
      }
      for (const BoardPair& pair : views[z].pairs) {
        zoom_of_pose_.push_back(z);
        pair_of_pose_.push_back(&pair);
      }
    }
    place_boards(start);
    if (options.is_joint) contrasts_ = contrasts(x_);
    smooth_sigma_ = first_smooth_sigma();
  }

  BundleResult run(const BundleNoise* known) {
    BundleResult result;
    if (known != nullptr) {
      corner_sigma_px_ = known->corner_sigma_px;
      smooth_sigma_ = known->smooth_sigma;
    } else {
      // A crude start tilts some boards the wrong way, and a bound against outliers would keep them
      // there: first with a wide bound, then with the boards placed anew.
      corner_sigma_px_ = 3;
      (void)solve();
      place_boards(opencv_zooms());
      corner_sigma_px_ = 0.3;
    }
    for (int round = 0; round < kRounds; ++round) {
      result.has_converged = solve();
      if (known == nullptr) corner_sigma_px_ = estimated_sigma();
      covariance_ = camera_covariance();
      // Expectation maximisation creeps near its end; a factor of 1.2 in a deviation changes
      // little.
      if (known != nullptr || (learn_smoothness() < 0.2 && round > 0)) break;
    }
    return filled(result);
  }

 private:
  static constexpr int kRounds = 5;

  /// The boards' poses, triangulated: both views together, as one alone leaves a board's tilt
  /// ambiguous at a long focal length.
  void place_boards(const std::vector<ZoomCalibration>& zooms) {
    poses_.clear();
    for (std::size_t v = 0; v < pair_of_pose_.size(); ++v) {
      const BoardPair& pair = *pair_of_pose_[v];
      std::vector<Eigen::Vector3d> seen;
      for (const auto& point : triangulate(pair.left, pair.right, zooms[zoom_of_pose_[v]]))
        seen.push_back(point.p_camera_mm);
      const Eigen::Isometry3d T_camera_board = rigid_fit(board_.points_mm(), seen);
      const Eigen::AngleAxisd turn(T_camera_board.linear());
      const Eigen::Vector3d r = turn.angle() * turn.axis(), t = T_camera_board.translation();
      poses_.push_back({r.x(), r.y(), r.z(), t.x(), t.y(), t.z()});
    }
  }

  [[nodiscard]] std::vector<Corner> corners(const BoardPair& pair) const {
    const auto points = board_.points_mm();
    const double half_x = 0.5 * (board_.columns - 1) * board_.square_mm;
    const double half_y = 0.5 * (board_.rows - 1) * board_.square_mm;
    std::vector<Corner> list;
    for (std::size_t i = 0; i < points.size(); ++i)
      list.push_back({points[i].x(),
                      points[i].y(),
                      points[i].x() / half_x,
                      points[i].y() / half_y,
                      {pair.left[i].x, pair.left[i].y},
                      {pair.right[i].x, pair.right[i].y}});
    return list;
  }

  /// 1 sigma of each intrinsic parameter, before any image was seen.
  [[nodiscard]] Prior camera_prior(const std::array<double, kIntrinsics>& camera) const {
    const double f = std::exp(camera[0]), w = image_.width, h = image_.height;
    const double r = 0.5 * std::hypot(w, h) / f;  // of the image's corner
    const double s = options_.distortion_prior_px / f;
    Prior prior;
    prior.mean = {
        std::log(f), std::log(f), 0.5 * (w - 1), 0.5 * (h - 1), 0, 0, 0, 0, 0, 0, 0, 0, 0};
    prior.sigma = {1.0,
                   1.0,
                   0.2 * w,
                   0.2 * h,
                   s / std::pow(r, 3),
                   s / std::pow(r, 5),
                   s / std::pow(r, 2),
                   s / std::pow(r, 2),
                   s / std::pow(r, 7),
                   s / std::pow(r, 2),
                   s / std::pow(r, 4),
                   s / std::pow(r, 2),
                   s / std::pow(r, 4)};
    return prior;
  }

  static void add_prior(ceres::Problem& problem, const Prior& prior, double* block) {
    const int n = static_cast<int>(prior.mean.size());
    auto* cost = new ceres::DynamicAutoDiffCostFunction<Prior, 32>(new Prior(prior));
    cost->AddParameterBlock(n);
    cost->SetNumResiduals(n);
    problem.AddResidualBlock(cost, nullptr, block);
  }

  void add_corners(ceres::Problem& problem) {
    for (std::size_t v = 0; v < poses_.size(); ++v) {
      ZoomBlocks& zoom = zooms_[zoom_of_pose_[v]];
      for (const Corner& corner : corners(*pair_of_pose_[v])) {
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<LeftResidual, 2, kIntrinsics, kPose, kBend>(
                new LeftResidual{corner, corner_sigma_px_}),
            new ceres::HuberLoss(options_.outlier_sigma), zoom.left.data(), poses_[v].data(),
            bend_.data());
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<RightResidual, 2, kIntrinsics, kExtrinsics, kPose,
                                            kBend>(new RightResidual{corner, corner_sigma_px_}),
            new ceres::HuberLoss(options_.outlier_sigma), zoom.right.data(), zoom.extrinsics.data(),
            poses_[v].data(), bend_.data());
      }
    }
  }

  void add_priors(ceres::Problem& problem) {
    for (ZoomBlocks& zoom : zooms_)
      for (auto* camera : {&zoom.left, &zoom.right}) {
        add_prior(problem, camera_prior(*camera), camera->data());
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<AspectPrior, 1, kIntrinsics>(new AspectPrior), nullptr,
            camera->data());
        if (options_.coefficients == 5)
          problem.SetManifold(camera->data(),
                              new ceres::SubsetManifold(kIntrinsics, {9, 10, 11, 12}));
      }
    if (options_.is_joint)
      add_prior(problem,
                Prior{std::vector<double>(kBend, 0.0),
                      std::vector<double>(kBend, options_.bend_prior_mm)},
                bend_.data());
    else
      problem.SetParameterBlockConstant(bend_.data());
    for (Eigen::Index k = 0; k < contrasts_.cols(); ++k) add_smoothness(problem, k);
  }

  void add_smoothness(ceres::Problem& problem, Eigen::Index k) {
    std::vector<double*> left, right, extrinsics;
    for (ZoomBlocks& zoom : zooms_) {
      left.push_back(zoom.left.data());
      right.push_back(zoom.right.data());
      extrinsics.push_back(zoom.extrinsics.data());
    }
    const auto add = [&](const std::vector<double*>& blocks, Eigen::Index at, Eigen::Index size) {
      problem.AddResidualBlock(
          new SmoothResidual(contrasts_.col(k), smooth_sigma_.segment(at, size)), nullptr, blocks);
    };
    add(left, 0, kIntrinsics);
    add(right, kIntrinsics, kIntrinsics);
    add(extrinsics, 2 * kIntrinsics, kExtrinsics);
  }

  void build(ceres::Problem& problem) {
    add_corners(problem);
    add_priors(problem);
  }

  bool solve() {
    ceres::Problem problem;
    build(problem);
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::DENSE_SCHUR;
    solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    for (auto& pose : poses_) solver.linear_solver_ordering->AddElementToGroup(pose.data(), 0);
    for (ZoomBlocks& zoom : zooms_)
      for (double* block : {zoom.left.data(), zoom.right.data(), zoom.extrinsics.data()})
        solver.linear_solver_ordering->AddElementToGroup(block, 1);
    solver.linear_solver_ordering->AddElementToGroup(bend_.data(), 1);
    solver.max_num_iterations = 50;
    solver.function_tolerance = 1e-6;
    solver.logging_type = ceres::SILENT;
    solver.minimizer_progress_to_stdout = false;
    solver.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem, &summary);
    return summary.IsSolutionUsable();
  }

  /// Huber-weighted residual of the corners, per degree of freedom.
  double estimated_sigma() {
    double sum = 0, count = 0;
    for (std::size_t v = 0; v < poses_.size(); ++v) {
      const ZoomBlocks& zoom = zooms_[zoom_of_pose_[v]];
      for (const Corner& corner : corners(*pair_of_pose_[v])) {
        double left[2] = {}, right[2] = {};
        LeftResidual{corner, 1}(zoom.left.data(), poses_[v].data(), bend_.data(), left);
        RightResidual{corner, 1}(zoom.right.data(), zoom.extrinsics.data(), poses_[v].data(),
                                 bend_.data(), right);
        for (const double* r : {left, right}) {
          const double norm = std::hypot(r[0], r[1]);
          const double bound = options_.outlier_sigma * corner_sigma_px_;
          sum += norm <= bound ? norm * norm : norm * bound;
          count += 2;
        }
      }
    }
    const double unknowns =
        static_cast<double>(poses_.size() * kPose) + static_cast<double>(zooms_.size() * kOfZoom);
    return std::max(std::sqrt(sum / std::max(count - unknowns, 1.0)), 1e-4);
  }

  /// Of all zooms' parameters, zoom by zoom in ZoomBlocks' order; poses and bend marginalised.
  Eigen::MatrixXd camera_covariance() {
    ceres::Problem problem;
    build(problem);
    ceres::Problem::EvaluateOptions evaluate;
    for (ZoomBlocks& zoom : zooms_)
      for (double* block : {zoom.left.data(), zoom.right.data(), zoom.extrinsics.data()})
        evaluate.parameter_blocks.push_back(block);
    if (options_.is_joint) evaluate.parameter_blocks.push_back(bend_.data());
    for (auto& pose : poses_) evaluate.parameter_blocks.push_back(pose.data());
    ceres::CRSMatrix jacobian;
    problem.Evaluate(evaluate, nullptr, nullptr, nullptr, &jacobian);
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(jacobian.num_cols, jacobian.num_cols);
    for (int r = 0; r < jacobian.num_rows; ++r) {
      const auto first = static_cast<std::size_t>(jacobian.rows[static_cast<std::size_t>(r)]);
      const auto last = static_cast<std::size_t>(jacobian.rows[static_cast<std::size_t>(r) + 1]);
      for (std::size_t a = first; a < last; ++a)
        for (std::size_t b = first; b <= a; ++b)
          normal(std::max(jacobian.cols[a], jacobian.cols[b]),
                 std::min(jacobian.cols[a], jacobian.cols[b])) +=
              jacobian.values[a] * jacobian.values[b];
    }
    const Eigen::VectorXd scale =
        normal.diagonal().unaryExpr([](double d) { return d > 0 ? 1 / std::sqrt(d) : 1.0; });
    normal = Eigen::MatrixXd(normal.selfadjointView<Eigen::Lower>());
    normal = scale.asDiagonal() * normal * scale.asDiagonal();
    const Eigen::Index free_cameras = cameras_size();
    const Eigen::MatrixXd selected = Eigen::MatrixXd::Identity(normal.rows(), free_cameras);
    const Eigen::MatrixXd inverse = normal.llt().solve(selected).topRows(free_cameras);
    const Eigen::VectorXd camera_scale = scale.head(free_cameras);
    return expanded(camera_scale.asDiagonal() * inverse * camera_scale.asDiagonal());
  }

  [[nodiscard]] Eigen::Index cameras_size() const {
    const Eigen::Index held = options_.coefficients == 5 ? 8 : 0;
    return static_cast<Eigen::Index>(zooms_.size()) * (kOfZoom - held);
  }

  /// With zero rows and columns where the coefficients are held.
  [[nodiscard]] Eigen::MatrixXd expanded(const Eigen::MatrixXd& covariance) const {
    if (options_.coefficients != 5) return covariance;
    std::vector<Eigen::Index> place;
    for (Eigen::Index z = 0; z < static_cast<Eigen::Index>(zooms_.size()); ++z)
      for (Eigen::Index i = 0; i < kOfZoom; ++i)
        if (i >= 2 * kIntrinsics || i % kIntrinsics < 9) place.push_back(z * kOfZoom + i);
    const auto size = static_cast<Eigen::Index>(zooms_.size()) * kOfZoom;
    Eigen::MatrixXd whole = Eigen::MatrixXd::Zero(size, size);
    for (Eigen::Index r = 0; r < covariance.rows(); ++r)
      for (Eigen::Index c = 0; c < covariance.cols(); ++c)
        whole(place[static_cast<std::size_t>(r)], place[static_cast<std::size_t>(c)]) =
            covariance(r, c);
    return whole;
  }

  [[nodiscard]] Eigen::VectorXd zoom_vector(const ZoomBlocks& zoom) const {
    Eigen::VectorXd vector(kOfZoom);
    vector << Eigen::Map<const Eigen::VectorXd>(zoom.left.data(), kIntrinsics),
        Eigen::Map<const Eigen::VectorXd>(zoom.right.data(), kIntrinsics),
        Eigen::Map<const Eigen::VectorXd>(zoom.extrinsics.data(), kExtrinsics);
    return vector;
  }

  /// Loose: what a badly made zoom might do. The first rounds learn the real size.
  [[nodiscard]] Eigen::VectorXd first_smooth_sigma() const {
    Eigen::VectorXd sigma(kOfZoom);
    for (const int side : {0, 1}) {
      const auto& camera = side == 0 ? zooms_[0].left : zooms_[0].right;
      const Prior prior = camera_prior(camera);
      for (int i = 0; i < kIntrinsics; ++i)
        sigma[side * kIntrinsics + i] =
            i < 2 ? 0.02 : (i < 4 ? 20 : 0.3 * prior.sigma[static_cast<std::size_t>(i)]);
    }
    sigma.segment(2 * kIntrinsics, 3).setConstant(5e-3);
    sigma.segment(2 * kIntrinsics + 3, 3).setConstant(1);
    return sigma;
  }

  /// One step of expectation maximisation; returns the largest relative change. Both cameras are of
  /// one make and share what is learnt. One pseudo-observation keeps a lucky zero from locking it.
  double learn_smoothness() {
    if (contrasts_.cols() == 0) return 0;
    Eigen::VectorXd squares = Eigen::VectorXd::Zero(kOfZoom);
    for (Eigen::Index k = 0; k < contrasts_.cols(); ++k) {
      Eigen::VectorXd deviation = Eigen::VectorXd::Zero(kOfZoom);
      Eigen::VectorXd variance = Eigen::VectorXd::Zero(kOfZoom);
      for (std::size_t z = 0; z < zooms_.size(); ++z) {
        const auto row = static_cast<Eigen::Index>(z);
        deviation += contrasts_(row, k) * zoom_vector(zooms_[z]);
        for (std::size_t y = 0; y < zooms_.size(); ++y) {
          const auto column = static_cast<Eigen::Index>(y);
          variance +=
              contrasts_(row, k) * contrasts_(column, k) *
              covariance_.block(row * kOfZoom, column * kOfZoom, kOfZoom, kOfZoom).diagonal();
        }
      }
      squares += deviation.cwiseAbs2() + variance;
    }
    const double count = static_cast<double>(contrasts_.cols());
    Eigen::VectorXd learnt(kOfZoom);
    for (Eigen::Index i = 0; i < kIntrinsics; ++i) {
      const double both = squares[i] + squares[kIntrinsics + i];
      learnt[i] = learnt[kIntrinsics + i] = std::sqrt(both / (2 * count));
    }
    for (Eigen::Index i = 2 * kIntrinsics; i < kOfZoom; ++i)
      learnt[i] = std::sqrt(squares[i] / count);
    double change = 0;
    for (Eigen::Index i = 0; i < kOfZoom; ++i) {
      learnt[i] = std::max(learnt[i], 1e-3 * smooth_sigma_[i]);
      change = std::max(change, std::abs(std::log(learnt[i] / smooth_sigma_[i])));
    }
    smooth_sigma_ = learnt;
    return change;
  }

  /// Of one zoom, in parameter_vector()'s order and units.
  [[nodiscard]] Eigen::MatrixXd opencv_covariance(std::size_t z) const {
    const int n = options_.coefficients;
    Eigen::MatrixXd change = Eigen::MatrixXd::Zero(2 * (4 + n) + kExtrinsics, kOfZoom);
    for (Eigen::Index side = 0; side < 2; ++side) {
      const auto& camera = side == 0 ? zooms_[z].left : zooms_[z].right;
      const Eigen::Index row = side * (4 + n), column = side * kIntrinsics;
      for (Eigen::Index i = 0; i < 9; ++i)
        change(row + i, column + i) = i < 2 ? std::exp(camera.at(static_cast<std::size_t>(i))) : 1;
      for (Eigen::Index i = 12; i < 4 + n; ++i) change(row + i, column + i - 3) = 1;
    }
    change.bottomRightCorner(kExtrinsics, kExtrinsics).setIdentity();
    const auto at = static_cast<Eigen::Index>(z) * kOfZoom;
    const Eigen::MatrixXd covariance =
        change * covariance_.block(at, at, kOfZoom, kOfZoom) * change.transpose();
    return 0.5 * (covariance + covariance.transpose());
  }

  [[nodiscard]] std::vector<ZoomCalibration> opencv_zooms() const {
    std::vector<ZoomCalibration> list;
    for (std::size_t z = 0; z < zooms_.size(); ++z) {
      ZoomCalibration zoom = start_[z];
      zoom.zoom = views_[z].zoom;
      const int n = options_.coefficients;
      to_opencv(zooms_[z].left, n, zoom.camera_matrix_left, zoom.distortion_left);
      to_opencv(zooms_[z].right, n, zoom.camera_matrix_right, zoom.distortion_right);
      const auto& e = zooms_[z].extrinsics;
      cv::Rodrigues(cv::Vec3d(e[0], e[1], e[2]), zoom.R);
      zoom.T = {e[3], e[4], e[5]};
      zoom.pairs_used = static_cast<int>(views_[z].pairs.size());
      list.push_back(zoom);
    }
    return list;
  }

  BundleResult filled(BundleResult result) const {
    result.noise = {corner_sigma_px_, smooth_sigma_};
    result.bend_mm = {bend_[0], bend_[1], bend_[2]};
    result.zooms = opencv_zooms();
    for (std::size_t z = 0; z < zooms_.size(); ++z)
      result.zooms[z].parameter_covariance = opencv_covariance(z);
    const BoardPair none{"", std::vector<cv::Point2d>(static_cast<std::size_t>(board_.corners())),
                         std::vector<cv::Point2d>(static_cast<std::size_t>(board_.corners()))};
    for (const Corner& c : corners(none))
      result.board_mm.emplace_back(
          c.x_mm, c.y_mm, bend_[0] * c.u * c.u + bend_[1] * c.u * c.v + bend_[2] * c.v * c.v);
    return result;
  }

  const std::vector<ZoomViews>& views_;
  BoardPattern board_;
  const std::vector<ZoomCalibration>& start_;
  cv::Size image_;
  BundleOptions options_;
  std::vector<double> x_;
  std::vector<ZoomBlocks> zooms_;
  std::vector<std::array<double, kPose>> poses_;
  std::vector<std::size_t> zoom_of_pose_;
  std::vector<const BoardPair*> pair_of_pose_;
  std::array<double, kBend> bend_{};
  Eigen::MatrixXd contrasts_;
  Eigen::VectorXd smooth_sigma_;
  Eigen::MatrixXd covariance_;
  double corner_sigma_px_ = 0.1;
};

}  // namespace

std::vector<Eigen::Vector3d> BoardPattern::points_mm() const {
  std::vector<Eigen::Vector3d> points;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c)
      points.emplace_back((c - 0.5 * (columns - 1)) * square_mm, (r - 0.5 * (rows - 1)) * square_mm,
                          0);
  return points;
}

BundleResult adjust_bundle(const std::vector<ZoomViews>& views, const BoardPattern& board,
                           const std::vector<ZoomCalibration>& start, int image_width_px,
                           int image_height_px, const BundleOptions& options,
                           const BundleNoise* known) {
  return Bundle(views, board, start, {image_width_px, image_height_px}, options).run(known);
}

}  // namespace holdfast::registration
