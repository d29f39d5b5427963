// SPDX-License-Identifier: Apache-2.0
#include "perception/alignment_evidence.hpp"

#include <algorithm>
#include <bitset>
#include <cmath>

#include <Eigen/Cholesky>

namespace holdfast::perception {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr auto kCells =
    static_cast<std::size_t>(kSightingCells) * static_cast<std::size_t>(kSightingCells);
constexpr int kPatchFreedoms = kPatchCount - 3;  // mean, contrast, and a little motion

void fix_tilt(Matrix6d& H) {
  H.middleRows<2>(3).setZero();
  H.middleCols<2>(3).setZero();
}

double middle_of_inliers(const std::vector<AlignmentRow>& rows, float PatchSighting::*value,
                         std::vector<double>& scratch) {
  scratch.clear();
  for (const AlignmentRow& row : rows)
    if (row.robust > 0) scratch.push_back(static_cast<double>(row.*value));
  return scratch.empty() ? 1 : median(scratch);
}

/// Relief is smooth: it also slopes across the image, in both directions, and what slopes turns and
/// scales the picture as the site moves.
Matrix6d sloping(const std::array<Vector6d, kCells>& by_cell) {
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

}  // namespace

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

AlignmentQuality quality_of(const std::vector<AlignmentRow>& rows, std::vector<double>& scratch) {
  AlignmentQuality q;
  q.visible = static_cast<int>(rows.size());
  std::bitset<kCells> cells;
  double squares = 0;
  for (const AlignmentRow& row : rows) {
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
  q.brightness = middle_of_inliers(rows, &AlignmentRow::brightness, scratch);
  q.contrast = middle_of_inliers(rows, &AlignmentRow::contrast, scratch);
  scratch.clear();
  for (const AlignmentRow& row : rows)
    if (row.robust > 0)
      scratch.push_back(static_cast<double>(row.geometry->squares) * (1 - row.zncc * row.zncc) /
                        kPatchFreedoms);
  q.noise = std::sqrt(std::clamp(median(scratch), 0.1, 400.0));
  return q;
}

double noise_of_both(double left) {
  // Of the noise of both images, what is left between them: the one is interpolated, which takes
  // noise of high frequency, that which does no harm.
  constexpr double kLeft = 0.83;
  return left * left / kLeft;
}

std::optional<Matrix6d> inverse_of(const Matrix6d& H, Freedom freedom) {
  const Vector6d scale = H.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  Matrix6d S = scale.asDiagonal() * H * scale.asDiagonal();
  if (freedom == Freedom::planar) {
    fix_tilt(S);
    S(3, 3) = S(4, 4) = 1;
  }
  const Eigen::LDLT<Matrix6d> ldlt(S);
  if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 1e-9)) return std::nullopt;
  Matrix6d inverse = scale.asDiagonal() * ldlt.solve(Matrix6d::Identity()) * scale.asDiagonal();
  if (freedom == Freedom::planar) fix_tilt(inverse);
  if (!inverse.allFinite()) return std::nullopt;
  return inverse;
}

/// H^-1 (sum over the error's causes of what each does to the gradient) H^-1: noise and the shared
/// error patch by patch, the depth in common within a cell and over the image, interpolation in
/// common within a cell and over the image. H is what texture tells: noise has gradients as well,
/// but they do not move with the site.
std::optional<Matrix6d> covariance_of(const std::vector<AlignmentRow>& rows,
                                      const ErrorModel& model) {
  constexpr double kTextureShareMin = 0.1;                  // of what a patch tells
  constexpr double kGradientNoise = 0.25 * kPatchFreedoms;  // of central differences, in one image
  const double shared2 = model.direct.shared_error_px * model.direct.shared_error_px;
  Matrix6d spread = Matrix6d::Zero();
  std::array<Vector6d, kCells> by_cell;
  by_cell.fill(Vector6d::Zero());
  Vector6d by_depth = Vector6d::Zero();
  Eigen::Matrix<double, 6, 2> common = Eigen::Matrix<double, 6, 2>::Zero();
  std::array<Eigen::Matrix<double, 6, 2>, kCells> common_by_cell;
  common_by_cell.fill(common);
  Matrix6d told = Matrix6d::Zero();
  for (const AlignmentRow& row : rows) {
    if (!(row.robust > 0)) continue;
    const double by_noise =
        0.5 * kGradientNoise * model.noise2 * row.geometry->unit_covariance_px2.trace();
    const double weight = row.robust * std::clamp(1 - by_noise, kTextureShareMin, 1.0);
    std::size_t k = 0;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i <= j; ++i) told(i, j) += weight * row.hessian[k++];
    const Eigen::Matrix<double, 6, 2> JW = row.jacobian.transpose() * (row.robust * row.weight);
    Eigen::Matrix2d C = model.noise2 * row.geometry->unit_covariance_px2;
    C.diagonal().array() += shared2;
    spread.noalias() += JW * C * JW.transpose();
    const Vector6d depth = JW * row.by_depth;
    by_cell[static_cast<std::size_t>(row.cell)] += depth;
    by_depth += depth;
    const Eigen::Matrix<double, 6, 2> as_one = JW * row.to_patch;
    common += model.direct.common_error_px * as_one;
    common_by_cell[static_cast<std::size_t>(row.cell)] +=
        model.uncertainty.shared_error_px * as_one;
  }
  for (const auto& cell : common_by_cell) spread.noalias() += cell * cell.transpose();
  for (const Vector6d& cell : by_cell) spread.noalias() += 0.5 * cell * cell.transpose();
  spread.noalias() += 0.5 * by_depth * by_depth.transpose() + common * common.transpose();
  if (model.freedom == Freedom::planar) spread += sloping(by_cell);
  const auto inverse = inverse_of(told.selfadjointView<Eigen::Upper>(), model.freedom);
  if (!inverse) return std::nullopt;
  Matrix6d out = *inverse * spread * *inverse;
  if (model.freedom == Freedom::planar)
    out.diagonal().segment<2>(3).array() +=
        model.uncertainty.tilt_sigma_rad * model.uncertainty.tilt_sigma_rad;
  return Matrix6d(0.5 * (out + out.transpose()));
}

}  // namespace holdfast::perception
