// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/slice_stack.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr std::size_t kListedMax = 12;

class Stack {
 public:
  Stack(const std::vector<SliceGeometry>& slices, const SliceLimits& limits)
      : slices_(slices), limits_(limits) {}

  SliceStack build() {
    check_planes();
    sort();
    split_duplicates();
    if (stack_.order.size() < 2)
      throw RefusedError(fmt::format("{}: the series has only {} slice position(s), needs 2",
                                     slices_.front().name, stack_.order.size()));
    check_spacing();
    check_line_and_tilt();
    return std::move(stack_);
  }

 private:
  [[nodiscard]] const SliceGeometry& slice(std::size_t place) const {
    return slices_[stack_.order[place]];
  }

  void check_planes() {
    if (slices_.empty()) throw RefusedError("the series has no slice");
    const SliceGeometry& first = slices_.front();
    for (const SliceGeometry& s : slices_) {
      if (s.rows != first.rows || s.columns != first.columns)
        throw RefusedError(fmt::format("{}: is {}x{} pixels, but {} is {}x{}", s.name, s.columns,
                                       s.rows, first.name, first.columns, first.rows));
      const double width_mm = s.columns * s.column_spacing_mm,
                   height_mm = s.rows * s.row_spacing_mm;
      const double grown_mm = std::max(std::abs(s.columns * first.column_spacing_mm - width_mm),
                                       std::abs(s.rows * first.row_spacing_mm - height_mm));
      if (grown_mm > limits_.corner_mm)
        throw RefusedError(fmt::format("{}: PixelSpacing is {}\\{} mm, but {} has {}\\{} mm",
                                       s.name, s.row_spacing_mm, s.column_spacing_mm, first.name,
                                       first.row_spacing_mm, first.column_spacing_mm));
      const double turned_mm = (s.along_row - first.along_row).norm() * width_mm +
                               (s.along_column - first.along_column).norm() * height_mm;
      if (turned_mm > limits_.corner_mm)
        throw RefusedError(fmt::format(
            "{}: ImageOrientationPatient differs from that of {} by {:.3f} mm at the far corner, "
            "at most {} mm",
            s.name, first.name, turned_mm, limits_.corner_mm));
    }
    normal_ = first.along_row.cross(first.along_column).normalized();
  }

  void sort() {
    for (const SliceGeometry& s : slices_) height_mm_.push_back(normal_.dot(s.origin_mm));
    stack_.order.resize(slices_.size());
    std::iota(stack_.order.begin(), stack_.order.end(), std::size_t{0});
    std::sort(stack_.order.begin(), stack_.order.end(), [&](std::size_t a, std::size_t b) {
      return height_mm_[a] != height_mm_[b] ? height_mm_[a] < height_mm_[b]
                                            : slices_[a].name < slices_[b].name;
    });
  }

  void split_duplicates() {
    std::vector<std::size_t> kept;
    for (const std::size_t k : stack_.order) {
      if (kept.empty() || height_mm_[k] - height_mm_[kept.back()] > limits_.same_position_mm) {
        kept.push_back(k);
        continue;
      }
      const SliceGeometry &a = slices_[kept.back()], &b = slices_[k];
      const double apart_mm = (a.origin_mm - b.origin_mm).norm();
      if (apart_mm > 2 * limits_.same_position_mm)
        throw RefusedError(fmt::format("{} and {}: lie in one plane but {:.3f} mm apart", a.name,
                                       b.name, apart_mm));
      stack_.duplicates.emplace_back(kept.back(), k);
    }
    stack_.order = std::move(kept);
  }

  [[nodiscard]] double height(std::size_t place) const { return height_mm_[stack_.order[place]]; }

  void check_spacing() const {
    std::vector<double> steps;
    for (std::size_t k = 0; k + 1 < stack_.order.size(); ++k)
      steps.push_back(height(k + 1) - height(k));
    std::vector<double> sorted = steps;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>((sorted.size() - 1) / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    const double usual = *middle;
    report_missing(steps, usual);
    for (std::size_t k = 0; k < steps.size(); ++k)
      if (std::abs(steps[k] - usual) > limits_.spacing_mm)
        throw RefusedError(fmt::format(
            "{} and {}: are {:.4f} mm apart, the other slices {:.4f} mm; may differ by {} mm",
            slice(k).name, slice(k + 1).name, steps[k], usual, limits_.spacing_mm));
  }

  void report_missing(const std::vector<double>& steps, double usual) const {
    std::size_t missing = 0;
    std::string where, between;
    for (std::size_t k = 0; k < steps.size(); ++k) {
      const auto share = static_cast<std::size_t>(std::min(std::round(steps[k] / usual), 1e6));
      if (share < 2 || std::abs(steps[k] - usual) <= limits_.spacing_mm) continue;
      for (std::size_t m = 1; m < share; ++m) {
        const double t = static_cast<double>(m) / static_cast<double>(share);
        const Eigen::Vector3d p = (1 - t) * slice(k).origin_mm + t * slice(k + 1).origin_mm;
        if (missing++ < kListedMax)
          where += fmt::format("{}{:.3f}\\{:.3f}\\{:.3f}", missing == 1 ? "" : ", ", p.x(), p.y(),
                               p.z());
      }
      if (between.empty()) between = slice(k).name + " and " + slice(k + 1).name;
    }
    if (missing == 0) return;
    throw RefusedError(
        fmt::format("{}: {} slice(s) missing at ImagePositionPatient {}{} (spacing {:.4f} mm)",
                    between, missing, where, missing > kListedMax ? ", ..." : "", usual));
  }

  void check_line_and_tilt() {
    const std::size_t last = stack_.order.size() - 1;
    const Eigen::Vector3d start = slice(0).origin_mm, whole = slice(last).origin_mm - start;
    for (std::size_t k = 0; k <= last; ++k) {
      const double t = (height(k) - height(0)) / (height(last) - height(0));
      const double off_mm = (slice(k).origin_mm - start - t * whole).norm();
      if (off_mm > limits_.line_mm)
        throw RefusedError(fmt::format(
            "{}: stands {:.3f} mm beside the line through the first and last slice, at most {} mm",
            slice(k).name, off_mm, limits_.line_mm));
    }
    const double sine = whole.normalized().cross(normal_).norm();
    const double tilt_deg = std::asin(std::min(sine, 1.0)) * 180 / std::numbers::pi;
    for (const SliceGeometry& s : slices_)
      if (s.tilt_deg && std::abs(*s.tilt_deg) > limits_.tilt_deg &&
          std::abs(std::abs(*s.tilt_deg) - tilt_deg) > limits_.tilt_deg)
        throw RefusedError(fmt::format(
            "{}: GantryDetectorTilt is {} degrees, but the slices' positions and orientation show "
            "{:.2f}: the tilt cannot be resolved",
            s.name, *s.tilt_deg, tilt_deg));
    if (tilt_deg > 0.01)
      stack_.notes.push_back(fmt::format(
          "slices are tilted by {:.2f} degrees; resolved into patient coordinates", tilt_deg));
  }

  const std::vector<SliceGeometry>& slices_;
  const SliceLimits& limits_;
  Eigen::Vector3d normal_ = Eigen::Vector3d::UnitZ();
  std::vector<double> height_mm_;
  SliceStack stack_;
};

}  // namespace

SliceStack stack_slices(const std::vector<SliceGeometry>& slices, const SliceLimits& limits) {
  return Stack(slices, limits).build();
}

}  // namespace holdfast::registration
