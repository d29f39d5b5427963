// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/ct_scanner.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <thread>

#include <fmt/core.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"
#include "tests/sim/or/phantom_field.hpp"
#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr int kFiner = 2;          // samples along a pixel's edge
constexpr int kSubSlices = 3;      // samples through a slice
constexpr std::size_t kChunk = 8;  // slices made together, which share samples
constexpr int kTile = 8;           // fine samples along the edge of a tile that may be skipped
constexpr double kSigmaOfWidth = 0.42466;  // a Gaussian's sigma over its full width at half maximum
constexpr float kLowestHu = -1024.F, kHighestHu = 3071.F;
constexpr double kMarginMm = 1.5;

void require(const char* name, double value, double low, double high, const char* unit) {
  if (!(value >= low && value <= high))
    throw InputError(
        fmt::format("CT scanner: {} = {} {}; must be {} to {}", name, value, unit, low, high));
}

void check(const CtScannerParameters& parameters) {
  require("pixel_mm", parameters.pixel_mm, 0.1, 2, "mm");
  require("slice_mm", parameters.slice_mm, 0.1, 5, "mm");
  require("blur_mm", parameters.blur_mm, 0.1, 3, "mm");
  require("slice_blur_mm", parameters.slice_blur_mm, 0.1, 5, "mm");
  require("noise_hu", parameters.noise_hu, 0, 200, "HU");
  require("oblique_deg", parameters.oblique_deg, -45, 45, "deg");
  require("gantry_tilt_deg", parameters.gantry_tilt_deg, -30, 30, "deg");
}

// A grid that covers the box, its corner off by a part of a voxel.
CtVolume place_grid(const Eigen::AlignedBox3d& box, const CtScannerParameters& parameters,
                    PhantomRandom& random) {
  const Vector3d axis = Vector3d(random.normal(1), random.normal(1), random.normal(1)).normalized();
  const Eigen::Matrix3d R_ct_table =
      Eigen::AngleAxisd(parameters.oblique_deg * std::numbers::pi / 180, axis).toRotationMatrix();
  const double tilt = parameters.gantry_tilt_deg * std::numbers::pi / 180;
  Eigen::Matrix3d steps;  // columns: along a row, down a column, from slice to slice
  steps.col(0) = R_ct_table.col(0) * parameters.pixel_mm;
  steps.col(1) = R_ct_table * Vector3d(0, std::cos(tilt), std::sin(tilt)) * parameters.pixel_mm;
  steps.col(2) = R_ct_table.col(2) * parameters.slice_mm;

  Eigen::AlignedBox3d indices;
  for (int i = 0; i < 8; ++i)
    indices.extend(steps.inverse() * box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(i)));
  const Vector3d margin =
      Vector3d::Constant(kMarginMm).cwiseQuotient(steps.colwise().norm().transpose());
  const Vector3d part{random.uniform(0, 1), random.uniform(0, 1), random.uniform(0, 1)};
  const Vector3d first = indices.min() - margin - part;
  const Eigen::Vector3i count = (indices.max() + margin - first).array().ceil().cast<int>() + 1;
  CtVolume volume;
  volume.origin_mm = steps * first;
  volume.column_step_mm = steps.col(0);
  volume.row_step_mm = steps.col(1);
  volume.slice_step_mm = steps.col(2);
  volume.slice_thickness_mm = parameters.slice_mm;
  volume.slices.resize(static_cast<std::size_t>(count.z()));
  for (auto& slice : volume.slices) slice.create(count.y(), count.x());
  return volume;
}

class Scan {
 public:
  Scan(const Phantom& phantom, const CtScannerParameters& parameters, CtVolume& volume,
       std::uint64_t noise_seed)
      : phantom_(phantom), parameters_(parameters), volume_(volume), noise_seed_(noise_seed) {}

  void make_slices(std::size_t first, std::size_t end) const {
    const double sigma = parameters_.slice_blur_mm * kSigmaOfWidth / parameters_.slice_mm;
    const int reach = static_cast<int>(std::ceil(2.5 * sigma * kSubSlices));
    const int sections = static_cast<int>(end - first - 1) * kSubSlices + 2 * reach + 1;
    double weights = 0;
    for (int sub = -reach; sub <= reach; ++sub) weights += slice_profile(sub, sigma);
    std::vector<cv::Mat_<float>> sums(end - first);
    for (auto& sum : sums) sum = cv::Mat_<float>::zeros(fine_size());
    for (int i = 0; i < sections; ++i) {
      const int sub = i - reach;
      const cv::Mat_<float> fine =
          section(static_cast<double>(first) + static_cast<double>(sub) / kSubSlices);
      for (std::size_t k = 0; k < sums.size(); ++k) {
        const int from_slice = sub - static_cast<int>(k) * kSubSlices;
        if (std::abs(from_slice) <= reach)
          cv::scaleAdd(fine, slice_profile(from_slice, sigma) / weights, sums[k], sums[k]);
      }
    }
    for (std::size_t k = 0; k < sums.size(); ++k) finish(first + k, sums[k]);
  }

 private:
  [[nodiscard]] static double slice_profile(int sub, double sigma) {
    const double z = static_cast<double>(sub) / kSubSlices / sigma;
    return std::exp(-0.5 * z * z);
  }

  [[nodiscard]] cv::Size fine_size() const { return volume_.slices[0].size() * kFiner; }

  // In-plane blur, partial volume, noise, and the range of 12 bits.
  void finish(std::size_t index, cv::Mat_<float>& fine) const {
    const double sigma = parameters_.blur_mm * kSigmaOfWidth * kFiner / parameters_.pixel_mm;
    cv::GaussianBlur(fine, fine, {}, sigma, sigma, cv::BORDER_REPLICATE);
    cv::Mat_<float> slice;
    cv::resize(fine, slice, volume_.slices[index].size(), 0, 0, cv::INTER_AREA);
    cv::add(slice, noise(index), slice);
    cv::min(cv::max(slice, kLowestHu), kHighestHu, slice);
    slice.convertTo(volume_.slices[index], CV_16S);
  }

  // The attenuation in one plane, on the finer grid.
  [[nodiscard]] cv::Mat_<float> section(double slice) const {
    cv::Mat_<float> fine(fine_size());
    for (int row = 0; row < fine.rows; row += kTile)
      for (int column = 0; column < fine.cols; column += kTile)
        fill_tile(fine, {column, row}, slice);
    return fine;
  }

  [[nodiscard]] Vector3f fine_position(double column, double row, double slice) const {
    constexpr double kFirst = 0.5 / kFiner - 0.5;
    return volume_.position(column / kFiner + kFirst, row / kFiner + kFirst, slice).cast<float>();
  }

  void fill_tile(cv::Mat_<float>& fine, const cv::Point& first, double slice) const {
    const int rows = std::min(kTile, fine.rows - first.y);
    const int columns = std::min(kTile, fine.cols - first.x);
    if (phantom_.clearance_mm) {
      const Vector3f middle =
          fine_position(first.x + (kTile - 1) / 2.0, first.y + (kTile - 1) / 2.0, slice);
      const double half_diagonal = std::sqrt(0.5) * kTile / kFiner * parameters_.pixel_mm;
      if (static_cast<double>(phantom_.clearance_mm(middle)) > half_diagonal) {
        fine(cv::Rect(first, cv::Size(columns, rows))) = phantom_.hounsfield(middle);
        return;
      }
    }
    for (int row = first.y; row < first.y + rows; ++row)
      for (int column = first.x; column < first.x + columns; ++column)
        fine(row, column) = phantom_.hounsfield(fine_position(column, row, slice));
  }

  // White noise, smoothed, without its slow part: the hump-shaped spectrum of filtered
  // back-projection.
  [[nodiscard]] cv::Mat_<float> noise(std::size_t index) const {
    cv::Mat_<float> white(volume_.slices[0].size());
    PhantomRandom random(noise_seed_ + 0x9e3779b97f4a7c15ULL * (index + 1));
    for (float& value : white) value = static_cast<float>(random.normal(1));
    const double sigma = parameters_.blur_mm * kSigmaOfWidth / parameters_.pixel_mm;
    cv::Mat_<float> fine, slow;
    cv::GaussianBlur(white, fine, {}, sigma);
    cv::GaussianBlur(white, slow, {}, 3 * sigma);
    fine -= slow;
    cv::Scalar mean, deviation;
    cv::meanStdDev(fine, mean, deviation);
    fine.convertTo(fine, CV_32F, parameters_.noise_hu / deviation[0]);
    return fine;
  }

  const Phantom& phantom_;
  const CtScannerParameters& parameters_;
  CtVolume& volume_;
  std::uint64_t noise_seed_;
};

}  // namespace

CtVolume scan(const Phantom& phantom, const CtScannerParameters& parameters) {
  check(parameters);
  PhantomRandom random(0xc7000000ULL + parameters.seed);
  CtVolume volume = place_grid(phantom.scan_box_mm, parameters, random);
  const Scan scanner(phantom, parameters, volume, random.bits());
  const std::size_t slices = volume.slices.size();
  const std::size_t step = kChunk * std::max(1U, std::thread::hardware_concurrency());
  for (std::size_t first = 0; first < slices; first += step) {
    const std::size_t end = std::min(first + step, slices);
    std::vector<std::jthread> threads;
    for (std::size_t i = first + kChunk; i < end; i += kChunk)
      threads.emplace_back(
          [&scanner, i, end] { scanner.make_slices(i, std::min(i + kChunk, end)); });
    scanner.make_slices(first, std::min(first + kChunk, end));
    threads.clear();
    if (parameters.progress)
      parameters.progress(static_cast<double>(end) / static_cast<double>(slices));
  }
  return volume;
}

Phantom with_filling(Phantom phantom, const Vector3d& p_ct_mm) {
  constexpr float kAmalgamHu = 8000.F;
  const Vector3f centre = p_ct_mm.cast<float>();
  const auto lump = [centre](const Vector3f& p) {
    return std::min(ellipsoid(p, centre, {1.6F, 0.7F, 0.6F}),
                    ellipsoid(p, centre + Vector3f(0.9F, 0.8F, 0.1F), {0.6F, 0.9F, 0.5F}));
  };
  phantom.hounsfield = [lump, inner = std::move(phantom.hounsfield)](const Vector3f& p) {
    return lump(p) < 0.F ? kAmalgamHu : inner(p);
  };
  if (phantom.clearance_mm)
    phantom.clearance_mm = [centre, inner = std::move(phantom.clearance_mm)](const Vector3f& p) {
      return std::min(inner(p), (p - centre).norm() - 2.5F);
    };
  return phantom;
}

}  // namespace holdfast::sim
