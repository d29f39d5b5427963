// SPDX-License-Identifier: Apache-2.0
#include "perception/direct_alignment.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "perception/alignment_evidence.hpp"
#include "perception/patch_sighting.hpp"

namespace holdfast::perception {
namespace {

using Row = AlignmentRow;
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix26d = Eigen::Matrix<double, 2, 6>;

constexpr double kCut2 = 25;            // Tukey's cut, squared, in units of the scale
constexpr double kMedianOfTwo = 1.386;  // median of chi^2 with two degrees of freedom
constexpr double kScale2Min = 0.3;
constexpr double kReachPx = 5;     // a gradient says nothing of a displacement beyond this
constexpr double kZnccRamp = 0.2;  // from no say to full say
constexpr int kPatchesMin = 8;
constexpr double kZnccMinRough = 0.2;  // on a smaller level's first step
constexpr double kNoise2Start = 8;     // grey levels^2

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
  Matrix6d hessian;

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
  double scale2();
  [[nodiscard]] double step_px(const Vector6d& step) const;
  bool descend(const TemplateLevel& patches, const cv::Mat& image, int level,
               Interpolation interpolation, int iterations, double settled_px,
               Eigen::Isometry3d& T);
  double sharpness(const TemplateLevel& coarse, const cv::Mat& image, int level,
                   const Eigen::Isometry3d& T);
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

/// Square of the robust scale of the residuals, in units of what was expected.
double DirectAligner::Impl::scale2() {
  scratch.clear();
  for (const Row& row : rows)
    if (row.trust > 0) scratch.push_back(row.residual.dot(row.weight * row.residual));
  if (scratch.size() < static_cast<std::size_t>(kPatchesMin)) return kScale2Min;
  return std::max(median(scratch) / kMedianOfTwo, kScale2Min);
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
    const auto inverse = inverse_of(hessian, freedom);
    if (inliers < kPatchesMin || !inverse) return false;
    step = *inverse * gradient;
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
  const double coarse_explained = median(scratch);
  scratch.clear();
  for (const Row& row : rows)
    if (row.robust > 0) scratch.push_back(explained(row));
  return scratch.empty() ? 1 : median(scratch) / std::max(coarse_explained, 1e-3);
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
  out.quality = quality_of(s.rows, s.scratch);
  if (out.quality.inliers > 0) s.noise2 = noise_of_both(out.quality.noise);
  out.quality.sharpness =
      s.sharpness(patches[kCoarse], image.levels[kCoarse], static_cast<int>(kCoarse), T);
  const auto covariance = covariance_of(s.rows, {s.noise2, s.parameters, s.uncertainty, s.freedom});
  out.is_solved = covariance && covariance->allFinite();
  if (covariance) out.covariance = *covariance;
  return out;
}

std::size_t DirectAligner::inliers(std::span<Eigen::Vector3d> p_site_mm) const noexcept {
  std::size_t count = 0;
  for (const Row& row : impl_->rows)
    if (row.robust > 0 && count < p_site_mm.size()) p_site_mm[count++] = row.geometry->p_site_mm;
  return count;
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
