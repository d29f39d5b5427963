// SPDX-License-Identifier: Apache-2.0
#include "perception/direct_alignment.hpp"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "perception/patch_sighting.hpp"

namespace holdfast::perception {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix26d = Eigen::Matrix<double, 2, 6>;

constexpr auto kCells =
    static_cast<std::size_t>(kSightingCells) * static_cast<std::size_t>(kSightingCells);
constexpr double kCut2 = 25;            // Tukey's cut, squared, in units of the scale
constexpr double kMedianOfTwo = 1.386;  // median of chi^2 with two degrees of freedom
constexpr double kScale2Min = 0.3;
constexpr double kReachPx = 5;     // a gradient says nothing of a displacement beyond this
constexpr double kZnccRamp = 0.2;  // from no say to full say
constexpr int kPatchFreedoms = kPatchCount - 3;  // mean, contrast, and a little motion
constexpr int kPatchesMin = 8;
constexpr double kZnccMinRough = 0.2;  // on a smaller level's first step
constexpr double kNoise2Start = 8;     // grey levels^2
/// Of the noise of both images, what is left between them: the one is interpolated, which takes
/// noise of high frequency, that which does no harm.
constexpr double kNoiseLeft = 0.83;
constexpr double kTextureShareMin = 0.1;  // of what a patch tells

/// A sighting with its say in the normal equations.
struct Row : PatchSighting {
  Eigen::Matrix2d weight;          // inverse covariance of the displacement
  Eigen::Vector2d residual;        // displacement left after the step
  Vector6d gradient;               // -J^T W d
  std::array<double, 21> hessian;  // J^T W J, upper triangle by columns
  double trust, robust;
};

/// Exp(r)(T p - T pivot) + T pivot + t: the parametrisation of MotionEstimate::covariance.
Eigen::Isometry3d moved(const Eigen::Isometry3d& T, const Eigen::Vector3d& pivot_site,
                        const Vector6d& step) {
  const Eigen::Vector3d r = step.tail<3>();
  const double angle = r.norm();
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  if (angle > 0) R = Eigen::AngleAxisd(angle, r / angle).toRotationMatrix();
  const Eigen::Vector3d pivot_camera = T * pivot_site;
  Eigen::Isometry3d out;
  out.linear() = Eigen::Quaterniond(R * T.linear()).normalized().toRotationMatrix();
  out.translation() = pivot_camera + step.head<3>() - out.linear() * pivot_site;
  return out;
}

/// What the row adds to the normal equations, for a weight of one.
void prepare(Row& row) {
  const Matrix26d WJ = row.weight * row.jacobian;
  row.gradient.noalias() = -WJ.transpose() * row.displacement;
  std::size_t k = 0;
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i <= j; ++i) row.hessian[k++] = row.jacobian.col(i).dot(WJ.col(j));
}

void fix_tilt(Matrix6d& H) {
  H.middleRows<2>(3).setZero();
  H.middleCols<2>(3).setZero();
}

}  // namespace

struct DirectAligner::Impl {
  PatchObserver observer;
  DirectParameters parameters;
  UncertaintyParameters uncertainty;
  Freedom freedom;
  Eigen::Vector3d p_pivot_site_mm;
  double f_px;
  int width_px, height_px;
  double noise2 = kNoise2Start;  // follows the images
  std::vector<Row> rows;
  std::vector<double> scratch;
  Matrix6d hessian, inverse;

  Impl(const CameraModel& camera, const TrackerParameters& p, Freedom f,
       const Eigen::Vector3d& pivot)
      : observer(
            camera, f, pivot,
            f == Freedom::planar ? p.uncertainty.relief_sigma_mm : p.uncertainty.depth_sigma_mm),
        parameters(p.direct),
        uncertainty(p.uncertainty),
        freedom(f),
        p_pivot_site_mm(pivot),
        f_px(camera.f_px()),
        width_px(camera.width_px),
        height_px(camera.height_px) {}

  void linearise(const TemplateLevel& patches, const cv::Mat& image, int level,
                 const Eigen::Isometry3d& T, Interpolation interpolation, double zncc_min);
  bool solve(Vector6d& step);
  [[nodiscard]] bool invert(const Matrix6d& H);
  double scale2();
  double median_of_scratch();
  [[nodiscard]] double step_px(const Vector6d& step) const;
  bool descend(const TemplateLevel& patches, const cv::Mat& image, int level,
               Interpolation interpolation, int iterations, double settled_px,
               Eigen::Isometry3d& T);
  AlignmentQuality quality(int visible);
  double middle_of_inliers(float Row::*value);
  double sharpness(const TemplateLevel& coarse, const cv::Mat& image, int level,
                   const Eigen::Isometry3d& T);
  Matrix6d covariance();
  static Matrix6d sloping(const std::array<Vector6d, kCells>& by_cell);
};

void DirectAligner::Impl::linearise(const TemplateLevel& patches, const cv::Mat& image, int level,
                                    const Eigen::Isometry3d& T, Interpolation interpolation,
                                    double zncc_min) {
  rows.clear();
  const double shared2 = parameters.shared_error_px * parameters.shared_error_px;
  for (std::size_t k = 0; k < patches.size(); ++k) {
    Row row;
    if (!observer.look(patches.pixels[k], patches.geometry[k], image, level, T, interpolation, row))
      continue;
    row.trust = std::clamp((row.zncc - zncc_min) / kZnccRamp, 0.0, 1.0);
    if (!(row.displacement.squaredNorm() < kReachPx * kReachPx)) row.trust = 0;
    row.robust = row.trust;
    Eigen::Matrix2d C = noise2 * row.geometry->unit_covariance_px2;
    C.diagonal().array() += shared2;
    C += row.by_depth * row.by_depth.transpose();
    row.weight = C.inverse();
    row.residual = row.displacement;
    prepare(row);
    rows.push_back(row);
  }
}

/// Of at least one value; reorders them.
double DirectAligner::Impl::median_of_scratch() {
  const auto middle = scratch.begin() + static_cast<std::ptrdiff_t>(scratch.size() / 2);
  std::nth_element(scratch.begin(), middle, scratch.end());
  return *middle;
}

/// Square of the robust scale of the residuals, in units of what was expected.
double DirectAligner::Impl::scale2() {
  scratch.clear();
  for (const Row& row : rows)
    if (row.trust > 0) scratch.push_back(row.residual.dot(row.weight * row.residual));
  if (scratch.size() < static_cast<std::size_t>(kPatchesMin)) return kScale2Min;
  return std::max(median_of_scratch() / kMedianOfTwo, kScale2Min);
}

bool DirectAligner::Impl::invert(const Matrix6d& H) {
  const Vector6d scale = H.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  Matrix6d S = scale.asDiagonal() * H * scale.asDiagonal();
  if (freedom == Freedom::planar) {
    fix_tilt(S);
    S(3, 3) = S(4, 4) = 1;
  }
  const Eigen::LDLT<Matrix6d> ldlt(S);
  if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 1e-9)) return false;
  inverse = scale.asDiagonal() * ldlt.solve(Matrix6d::Identity()) * scale.asDiagonal();
  if (freedom == Freedom::planar) fix_tilt(inverse);
  return inverse.allFinite();
}

/// The step that the displacements of all rows agree on best. Reweights without looking at the
/// image again: the displacements are linear in the step.
bool DirectAligner::Impl::solve(Vector6d& step) {
  constexpr int kReweightings = 2;
  for (int pass = 0; pass < kReweightings; ++pass) {
    std::array<double, 21> sums{};
    Vector6d gradient = Vector6d::Zero();
    int inliers = 0;
    for (const Row& row : rows) {
      if (!(row.robust > 0)) continue;
      ++inliers;
      gradient += row.robust * row.gradient;
      for (std::size_t k = 0; k < sums.size(); ++k) sums[k] += row.robust * row.hessian[k];
    }
    std::size_t k = 0;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i <= j; ++i) hessian(i, j) = hessian(j, i) = sums[k++];
    if (inliers < kPatchesMin || !invert(hessian)) return false;
    step = inverse * gradient;
    if (!step.allFinite()) return false;
    for (Row& row : rows) row.residual = row.displacement + row.jacobian * step;
    const double cut2 = kCut2 * scale2();
    for (Row& row : rows) {
      const double u = row.residual.dot(row.weight * row.residual) / cut2;
      row.robust = u < 1 ? row.trust * (1 - u) * (1 - u) : 0;
    }
  }
  return true;
}

/// By how much the step moves a pixel, at most.
double DirectAligner::Impl::step_px(const Vector6d& step) const {
  const double reach_px = 0.5 * std::hypot(width_px, height_px), z_mm = p_pivot_site_mm.z();
  return step.head<2>().norm() * f_px / z_mm +
         reach_px * (std::abs(step[2]) / z_mm + std::abs(step[5])) +
         reach_px * reach_px / f_px * step.segment<2>(3).norm();
}

bool DirectAligner::Impl::descend(const TemplateLevel& patches, const cv::Mat& image, int level,
                                  Interpolation interpolation, int iterations, double settled_px,
                                  Eigen::Isometry3d& T) {
  for (int i = 0; i < iterations; ++i) {
    const bool is_rough = i == 0 && level > 0;
    linearise(patches, image, level, T, interpolation,
              is_rough ? kZnccMinRough : parameters.zncc_min);
    Vector6d step;
    if (!solve(step)) return false;
    if (!(step_px(step) < 0.5 * std::max(width_px, height_px))) return false;
    T = moved(T, p_pivot_site_mm, step);
    if (step_px(step) < settled_px) break;
  }
  return true;
}

double DirectAligner::Impl::middle_of_inliers(float Row::*value) {
  scratch.clear();
  for (const Row& row : rows)
    if (row.robust > 0) scratch.push_back(static_cast<double>(row.*value));
  return scratch.empty() ? 1 : median_of_scratch();
}

/// Of the rows at full size against `coarse`, patches of a smaller level seen at the same pose.
double DirectAligner::Impl::sharpness(const TemplateLevel& coarse, const cv::Mat& image, int level,
                                      const Eigen::Isometry3d& T) {
  const auto explained = [](const PatchSighting& s) {
    return s.zncc * static_cast<double>(s.contrast);
  };
  PatchSighting seen;
  scratch.clear();
  for (std::size_t k = 0; k < coarse.size(); ++k)
    if (observer.look(coarse.pixels[k], coarse.geometry[k], image, level, T,
                      Interpolation::bilinear, seen) &&
        seen.zncc > parameters.zncc_min)
      scratch.push_back(explained(seen));
  if (scratch.size() < static_cast<std::size_t>(kPatchesMin)) return 1;
  const double coarse_explained = median_of_scratch();
  scratch.clear();
  for (const Row& row : rows)
    if (row.robust > 0) scratch.push_back(explained(row));
  return scratch.empty() ? 1 : median_of_scratch() / std::max(coarse_explained, 1e-3);
}

AlignmentQuality DirectAligner::Impl::quality(int visible) {
  AlignmentQuality q;
  q.visible = visible;
  std::bitset<kCells> cells;
  double squares = 0;
  for (const Row& row : rows) {
    if (!(row.robust > 0)) continue;
    ++q.inliers;
    q.zncc += row.zncc;
    squares += row.residual.squaredNorm();
    cells.set(static_cast<std::size_t>(row.cell));
  }
  if (q.inliers == 0) return q;
  q.zncc /= q.inliers;
  q.residual_px = std::sqrt(squares / q.inliers);
  q.spread = static_cast<double>(cells.count()) / kCells;
  q.brightness = middle_of_inliers(&Row::brightness);
  q.contrast = middle_of_inliers(&Row::contrast);
  scratch.clear();
  for (const Row& row : rows)
    if (row.robust > 0)
      scratch.push_back(static_cast<double>(row.geometry->squares) * (1 - row.zncc * row.zncc) /
                        kPatchFreedoms);
  const double left2 = std::clamp(median_of_scratch(), 0.1, 400.0);
  q.noise = std::sqrt(left2);
  noise2 = left2 / kNoiseLeft;
  return q;
}

/// Relief is smooth: it also slopes across the image, in both directions, and what slopes turns and
/// scales the picture as the site moves.
Matrix6d DirectAligner::Impl::sloping(const std::array<Vector6d, kCells>& by_cell) {
  constexpr double kMiddle = 0.5 * (kSightingCells - 1);
  const double rms = std::sqrt((kSightingCells * kSightingCells - 1) / 12.0);  // of a coordinate
  Eigen::Matrix<double, 6, 2> slopes = Eigen::Matrix<double, 6, 2>::Zero();
  for (std::size_t k = 0; k < kCells; ++k) {
    const std::size_t column = k % kSightingCells, row = k / kSightingCells;
    slopes.col(0) += (static_cast<double>(column) - kMiddle) / rms * by_cell[k];
    slopes.col(1) += (static_cast<double>(row) - kMiddle) / rms * by_cell[k];
  }
  return slopes * slopes.transpose();
}

/// H^-1 (sum over the error's causes of what each does to the gradient) H^-1: noise and the shared
/// error patch by patch, the depth in common within a cell and over the image, interpolation in
/// common within a cell and over the image. H is what texture tells: noise has gradients as well,
/// but they do not move with the site.
Matrix6d DirectAligner::Impl::covariance() {
  constexpr double kGradientNoise = 0.25 * kPatchFreedoms;  // of central differences, in one image
  const double shared2 = parameters.shared_error_px * parameters.shared_error_px;
  Matrix6d spread = Matrix6d::Zero();
  std::array<Vector6d, kCells> by_cell;
  by_cell.fill(Vector6d::Zero());
  Vector6d by_depth = Vector6d::Zero();
  Eigen::Matrix<double, 6, 2> common = Eigen::Matrix<double, 6, 2>::Zero();
  std::array<Eigen::Matrix<double, 6, 2>, kCells> common_by_cell;
  common_by_cell.fill(common);
  Matrix6d told = Matrix6d::Zero();
  for (const Row& row : rows) {
    if (!(row.robust > 0)) continue;
    const double by_noise =
        0.5 * kGradientNoise * noise2 * row.geometry->unit_covariance_px2.trace();
    const double weight = row.robust * std::clamp(1 - by_noise, kTextureShareMin, 1.0);
    std::size_t k = 0;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i <= j; ++i) told(i, j) += weight * row.hessian[k++];
    const Eigen::Matrix<double, 6, 2> JW = row.jacobian.transpose() * (row.robust * row.weight);
    Eigen::Matrix2d C = noise2 * row.geometry->unit_covariance_px2;
    C.diagonal().array() += shared2;
    spread.noalias() += JW * C * JW.transpose();
    const Vector6d depth = JW * row.by_depth;
    by_cell[static_cast<std::size_t>(row.cell)] += depth;
    by_depth += depth;
    const Eigen::Matrix<double, 6, 2> as_one = JW * row.to_patch;
    common += parameters.common_error_px * as_one;
    common_by_cell[static_cast<std::size_t>(row.cell)] += uncertainty.shared_error_px * as_one;
  }
  for (const auto& cell : common_by_cell) spread.noalias() += cell * cell.transpose();
  for (const Vector6d& cell : by_cell) spread.noalias() += 0.5 * cell * cell.transpose();
  spread.noalias() += 0.5 * by_depth * by_depth.transpose() + common * common.transpose();
  if (freedom == Freedom::planar) spread += sloping(by_cell);
  if (!invert(told.selfadjointView<Eigen::Upper>()))
    return Matrix6d::Constant(std::numeric_limits<double>::quiet_NaN());
  Matrix6d out = inverse * spread * inverse;
  if (freedom == Freedom::planar)
    out.diagonal().segment<2>(3).array() += uncertainty.tilt_sigma_rad * uncertainty.tilt_sigma_rad;
  return 0.5 * (out + out.transpose());
}

DirectAligner::DirectAligner(const CameraModel& camera, const TrackerParameters& parameters,
                             Freedom freedom, const Eigen::Vector3d& p_pivot_site_mm)
    : impl_(std::make_unique<Impl>(camera, parameters, freedom, p_pivot_site_mm)) {}
DirectAligner::~DirectAligner() = default;
DirectAligner::DirectAligner(DirectAligner&&) noexcept = default;
DirectAligner& DirectAligner::operator=(DirectAligner&&) noexcept = default;

void DirectAligner::reserve(std::size_t patches) {
  impl_->rows.reserve(patches);
  impl_->scratch.reserve(patches);
}

Alignment DirectAligner::align(const DirectTemplate& patches, const Pyramid& image,
                               const Eigen::Isometry3d& T_start, int coarsest) {
  constexpr int kIterations = 5;
  constexpr std::array<double, kPyramidLevels> kSettledPx = {0.2, 0.7, 1.5};  // the rest converges
  constexpr double kExactPx = 0.03;  // of the last step; what is left is a hundredth of it
  Impl& s = *impl_;
  Alignment out;
  Eigen::Isometry3d T = T_start;
  for (int level = coarsest; level > 0; --level) {
    const auto l = static_cast<std::size_t>(level);
    // A small image may have no patches there: the next level then starts where this one did.
    if (patches[l].size() < static_cast<std::size_t>(kPatchesMin)) continue;
    if (!s.descend(patches[l], image.levels[l], level, Interpolation::bilinear, kIterations,
                   kSettledPx[l], T))
      return out;
  }
  if (!s.descend(patches[0], image.levels[0], 0, Interpolation::bilinear, kIterations,
                 kSettledPx[0], T) ||
      !s.descend(patches[0], image.levels[0], 0, Interpolation::bicubic, 3, kExactPx, T))
    return out;
  out.T_camera_site = T;
  constexpr std::size_t kCoarse = kPyramidLevels - 1;
  out.quality = s.quality(static_cast<int>(s.rows.size()));
  out.quality.sharpness =
      s.sharpness(patches[kCoarse], image.levels[kCoarse], static_cast<int>(kCoarse), T);
  out.covariance = s.covariance();
  out.is_solved = out.covariance.allFinite();
  return out;
}

Testimony DirectAligner::ask(const TemplateLevel& witnesses, const Pyramid& image,
                             const Eigen::Isometry3d& T_camera_site) const {
  constexpr double kToleratedPx = 0.5, kSigmas2 = 9, kLikenessMin = 0.5;
  const Impl& s = *impl_;
  Testimony out;
  PatchSighting row;
  for (std::size_t k = 0; k < witnesses.size(); ++k) {
    const PatchGeometry& geometry = witnesses.geometry[k];
    if (!s.observer.look(witnesses.pixels[k], geometry, image.levels[0], 0, T_camera_site,
                         Interpolation::bilinear, row))
      continue;
    ++out.visible;
    // Weak texture is less alike under noise.
    const double squares = static_cast<double>(geometry.squares);
    const double expected = squares / (squares + kPatchCount * s.noise2);
    const double variance_px2 =
        s.noise2 * geometry.unit_covariance_px2.trace() + row.by_depth.squaredNorm();
    const bool is_near =
        row.displacement.squaredNorm() < kToleratedPx * kToleratedPx + kSigmas2 * variance_px2;
    if (row.zncc > kLikenessMin * expected && is_near) ++out.agreeing;
  }
  return out;
}

double DirectAligner::similarity(const DirectTemplate& patches, const Pyramid& image, int level,
                                 const Eigen::Isometry3d& T_camera_site) const {
  const Impl& s = *impl_;
  const auto l = static_cast<std::size_t>(level);
  double sum = 0;
  int visible = 0;
  PatchSighting row;
  for (std::size_t k = 0; k < patches[l].size(); ++k) {
    if (!s.observer.look(patches[l].pixels[k], patches[l].geometry[k], image.levels[l], level,
                         T_camera_site, Interpolation::bilinear, row))
      continue;
    ++visible;
    sum += row.zncc;
  }
  return visible < kPatchesMin ? -1 : sum / visible;
}

}  // namespace holdfast::perception
