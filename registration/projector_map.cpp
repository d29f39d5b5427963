// SPDX-License-Identifier: Apache-2.0
#include "registration/projector_map.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <queue>
#include <vector>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "registration/pattern.hpp"

namespace holdfast::registration {
namespace {

constexpr int kPartPx = 64;  // side of the first part looked for, projector pixels
constexpr int kNextPx = 48;  // of the parts beside one that was found
constexpr int kReachPx = 8;  // how far from where its neighbour expects it
constexpr double kFirstMin = 0.4, kNextMin = 0.5;  // correlation
constexpr double kScaleStep = 0.08, kTurnStep = 0.087;
constexpr int kGridPx = 64;  // camera pixels between parts
constexpr std::size_t kFirstParts = 3;
constexpr int kProofParts = 24;      // neighbours that are asked whether a first part is right
constexpr double kProofShare = 0.6;  // and must say so

/// Looked for at this scale and roll: p_projector = turn(p_camera - at) / scale + found.
struct Pose {
  double scale = 1, turn_rad = 0;
};
struct Anchor {
  cv::Point cell, at_px;  // of the grid; rectified left
  cv::Vec3f p_mm;
  cv::Point2d projector_px;
};

/// The least distance along a row at which an image is no longer like itself.
double half_width_px(const cv::Mat1f& image) {
  cv::Mat1f values;
  cv::subtract(image, cv::mean(image), values);
  const double whole = values.dot(values) / static_cast<double>(values.total());
  double before = 1;
  for (int shift = 1; shift < std::min(60, image.cols / 4); ++shift) {
    const cv::Mat1f a = values.colRange(0, values.cols - shift).clone();
    const cv::Mat1f b = values.colRange(shift, values.cols).clone();
    const double alike = a.dot(b) / static_cast<double>(a.total()) / whole;
    if (alike < 0.5) return shift - (0.5 - alike) / std::max(before - alike, 1e-9);
    before = alike;
  }
  return 1;
}

class Search {
 public:
  Search(const cv::Mat1b& pattern, const cv::Mat1b& left, const Reconstruction& surface,
         const ProjectorSearch& options)
      : surface_(surface), options_(options) {
    constexpr double kBlurPx = 1;  // of the optics, about; and it forgives a scale a little off
    pattern.convertTo(pattern_, CV_32F);
    cv::GaussianBlur(pattern_, pattern_, {}, kBlurPx);
    left.convertTo(left_, CV_32F);
    grid_ = {surface.region_px.width / kGridPx, surface.region_px.height / kGridPx};
  }

  std::vector<Anchor> anchors() {
    const std::vector<cv::Point> firsts = first_cells();
    for (const Pose& pose : poses()) {
      shrink(pose.scale);
      for (const cv::Point cell : firsts)
        if (const auto first = look_for(cell, pose, {}, kPartPx, kFirstMin)) {
          std::vector<Anchor> grown = grow(*first, pose);
          if (!grown.empty()) return grown;
        }
    }
    return {};
  }

 private:
  /// Likely scales first: as the widths of what is seen and what was projected say.
  [[nodiscard]] std::vector<Pose> poses() const {
    const cv::Rect middle(left_.cols / 4, left_.rows / 4, left_.cols / 2, left_.rows / 2);
    const double likely = half_width_px(left_(middle)) / half_width_px(pattern_);
    std::vector<Pose> all;
    const int turns = static_cast<int>(options_.turn_max_rad / kTurnStep);
    for (double s = options_.scale_min; s <= options_.scale_max; s *= 1 + kScaleStep)
      for (int t = -turns; t <= turns; ++t) all.push_back({s, t * kTurnStep});
    const auto unlikely = [likely](const Pose& pose) {
      return std::abs(std::log(pose.scale / likely)) / kScaleStep +
             std::abs(pose.turn_rad) / kTurnStep;
    };
    std::stable_sort(all.begin(), all.end(),
                     [&](const Pose& a, const Pose& b) { return unlikely(a) < unlikely(b); });
    return all;
  }

  [[nodiscard]] cv::Point at(cv::Point cell) const {
    return {cell.x * kGridPx + kGridPx / 2, cell.y * kGridPx + kGridPx / 2};
  }

  /// Where the surface is known, faces the camera best and is lit well.
  [[nodiscard]] std::vector<cv::Point> first_cells() const {
    struct Cell {
      cv::Point cell;
      double relief_mm;
    };
    std::vector<Cell> cells;
    const int reach = static_cast<int>(0.4 * kPartPx * options_.scale_min * 2);
    const cv::Rect whole({}, surface_.depth_mm.size());
    for (int j = 0; j < grid_.height; ++j)
      for (int i = 0; i < grid_.width; ++i) {
        const cv::Point middle = at({i, j});
        const cv::Rect part(middle.x - reach, middle.y - reach, 2 * reach, 2 * reach);
        if ((part & whole) != part) continue;
        const cv::Mat1f depth = surface_.depth_mm(part);
        double sum = 0, squares = 0;
        int known = 0, asked = 0;
        for (int y = 0; y < part.height; y += 8)
          for (int x = 0; x < part.width; x += 8) {
            ++asked;
            const auto z = static_cast<double>(depth(y, x) - depth(reach, reach));
            if (std::isnan(z)) continue;
            ++known;
            sum += z;
            squares += z * z;
          }
        if (known < 9 * asked / 10) continue;
        const double mean = sum / known;
        cells.push_back({{i, j}, squares / known - mean * mean});
      }
    std::sort(cells.begin(), cells.end(),
              [](const Cell& a, const Cell& b) { return a.relief_mm < b.relief_mm; });
    std::vector<cv::Point> chosen;
    for (const Cell& cell : cells) {
      const bool is_apart = std::all_of(chosen.begin(), chosen.end(), [&](const cv::Point& p) {
        return std::abs(p.x - cell.cell.x) + std::abs(p.y - cell.cell.y) > 4;
      });
      if (is_apart) chosen.push_back(cell.cell);
      if (chosen.size() == kFirstParts) break;
    }
    return chosen;
  }

  void shrink(double scale) {
    if (scale == scale_) return;
    scale_ = scale;
    cv::resize(left_, small_, {}, 1 / scale, 1 / scale, cv::INTER_AREA);
  }

  /// The part around a cell as it looks to the projector; empty where the image ends.
  [[nodiscard]] cv::Mat1f part_at(cv::Point cell, const Pose& pose, int side) const {
    const cv::Point middle = at(cell) + surface_.region_px.tl();
    const double c = std::cos(pose.turn_rad), s = std::sin(pose.turn_rad);
    const double u = (middle.x + 0.5) / scale_ - 0.5, v = (middle.y + 0.5) / scale_ - 0.5;
    const double half = 0.5 * (side - 1), reach = half * (std::abs(c) + std::abs(s)) + 1;
    if (u < reach || v < reach || u > small_.cols - 1 - reach || v > small_.rows - 1 - reach)
      return {};
    const cv::Matx23d to_small(c, -s, u - c * half + s * half, s, c, v - s * half - c * half);
    cv::Mat1f part;
    cv::warpAffine(small_, part, to_small, {side, side}, cv::INTER_LINEAR | cv::WARP_INVERSE_MAP);
    return part;
  }

  /// In the whole pattern, or around where it is expected.
  [[nodiscard]] std::optional<Anchor> look_for(cv::Point cell, const Pose& pose,
                                               std::optional<cv::Point2d> expected, int side,
                                               double correlation_min) const {
    const cv::Point middle = at(cell);
    const cv::Vec3f p_mm = surface_.points_mm(middle);
    if (std::isnan(p_mm[2])) return {};
    const cv::Mat1f part = part_at(cell, pose, side);
    if (part.empty()) return {};
    cv::Rect where({}, pattern_.size());
    if (expected) {
      const int reach = side / 2 + kReachPx;
      where &= cv::Rect(static_cast<int>(std::lround(expected->x)) - reach,
                        static_cast<int>(std::lround(expected->y)) - reach, 2 * reach, 2 * reach);
      if (where.width < side || where.height < side) return {};
    }
    cv::Mat1f alike;
    cv::matchTemplate(pattern_(where), part, alike, cv::TM_CCOEFF_NORMED);
    double most = 0;
    cv::Point found;
    cv::minMaxLoc(alike, nullptr, &most, nullptr, &found);
    if (!(most >= correlation_min)) return {};
    const cv::Point2d corner = found + where.tl();
    return Anchor{cell, middle, p_mm, corner + cv::Point2d(0.5 * (side - 1), 0.5 * (side - 1))};
  }

  /// From one part to all that hang together with it; nothing when its neighbours deny it.
  [[nodiscard]] std::vector<Anchor> grow(const Anchor& first, const Pose& pose) const {
    cv::Mat1b asked(grid_, uchar{0});
    std::queue<Anchor> open;
    std::vector<Anchor> found{first};
    asked(first.cell) = 1;
    open.push(first);
    int tried = 0;
    const double c = std::cos(pose.turn_rad) / pose.scale, s = std::sin(pose.turn_rad) / pose.scale;
    while (!open.empty()) {
      const Anchor from = open.front();
      open.pop();
      for (const cv::Point step :
           {cv::Point(1, 0), cv::Point(-1, 0), cv::Point(0, 1), cv::Point(0, -1)}) {
        const cv::Point cell = from.cell + step;
        if (!cv::Rect({}, grid_).contains(cell) || asked(cell) != 0) continue;
        const cv::Point way = kGridPx * step;
        const cv::Point2d expected =
            from.projector_px + cv::Point2d(c * way.x + s * way.y, -s * way.x + c * way.y);
        const auto next = look_for(cell, pose, expected, kNextPx, kNextMin);
        ++tried;
        if (next) {
          asked(cell) = 1;
          found.push_back(*next);
          open.push(*next);
        }
        if (tried == kProofParts &&
            static_cast<double>(found.size() - 1) < kProofShare * kProofParts)
          return {};
      }
    }
    return tried < kProofParts ? std::vector<Anchor>{} : found;
  }

  const Reconstruction& surface_;
  const ProjectorSearch& options_;
  cv::Mat1f pattern_, left_, small_;
  double scale_ = 0;
  cv::Size grid_;
};

/// Projective least squares of (x/z, y/z, 1, z0/z - 1) to projector pixels. On a plane the last
/// coordinate says nothing new: a little weight keeps its coefficients at zero there.
cv::Matx34d fitted(const std::vector<Anchor>& anchors) {
  constexpr double kSpread = 5;  // brings rays and relief to the order of 1
  constexpr double kDamping = 1e-4, kHalfWidthPx = 0.5 * kPatternWidthPx,
                   kHalfHeightPx = 0.5 * kPatternHeightPx;
  double z0 = 0;
  for (const Anchor& a : anchors) z0 += static_cast<double>(a.p_mm[2]);
  z0 /= static_cast<double>(anchors.size());
  cv::Matx<double, 12, 12> normal = cv::Matx<double, 12, 12>::zeros();
  for (const Anchor& a : anchors) {
    const cv::Vec3d p = a.p_mm;
    const double m[4] = {kSpread * p[0] / p[2], kSpread * p[1] / p[2], 1,
                         kSpread * (z0 / p[2] - 1)};
    const double at[2] = {a.projector_px.x / kHalfWidthPx - 1,
                          a.projector_px.y / kHalfHeightPx - 1};
    for (int k = 0; k < 2; ++k) {
      cv::Vec<double, 12> row = cv::Vec<double, 12>::all(0);
      for (int i = 0; i < 4; ++i) {
        row[4 * k + i] = m[i];
        row[8 + i] = -at[k] * m[i];
      }
      normal += row * row.t();
    }
  }
  for (const int i : {3, 7, 11}) normal(i, i) += kDamping * static_cast<double>(anchors.size());
  cv::Matx<double, 12, 1> values;
  cv::Matx<double, 12, 12> vectors;
  cv::eigen(normal, values, vectors);
  cv::Matx34d P;
  for (int r = 0; r < 3; ++r) {
    const double h[4] = {kSpread * vectors(11, 4 * r), kSpread * vectors(11, 4 * r + 1),
                         vectors(11, 4 * r + 2), kSpread * vectors(11, 4 * r + 3)};
    P(r, 0) = h[0];
    P(r, 1) = h[1];
    P(r, 2) = h[2] - h[3];
    P(r, 3) = h[3] * z0;
  }
  const cv::Matx33d to_pixels(kHalfWidthPx, 0, kHalfWidthPx, 0, kHalfHeightPx, kHalfHeightPx, 0, 0,
                              1);
  return to_pixels * P;
}

double distance_px(const ProjectorMap& map, const Anchor& anchor) {
  return cv::norm(map.project(anchor.p_mm) - anchor.projector_px);
}

}  // namespace

cv::Point2d ProjectorMap::project(const cv::Vec3f& p) const {
  const cv::Vec3d q = projection * cv::Vec4d(static_cast<double>(p[0]), static_cast<double>(p[1]),
                                             static_cast<double>(p[2]), 1);
  return {q[0] / q[2], q[1] / q[2]};
}

cv::Mat1b rectified_left(const cv::Mat& raw_left, const ZoomCalibration& zoom,
                         const Rectification& geometry) {
  cv::Mat grey = raw_left;
  if (grey.channels() == 3) cv::cvtColor(raw_left, grey, cv::COLOR_BGR2GRAY);
  if (grey.depth() == CV_16U) grey.convertTo(grey, CV_8U, 1.0 / 257);
  cv::Mat u, v, rectified;
  cv::initUndistortRectifyMap(zoom.camera_matrix_left, zoom.distortion_left, geometry.R1,
                              geometry.P1, geometry.size_px, CV_32FC1, u, v);
  cv::remap(grey, rectified, u, v, cv::INTER_LINEAR);
  return rectified;
}

ProjectorMap find_projector(const cv::Mat1b& pattern, const cv::Mat1b& left,
                            const Reconstruction& surface, const ProjectorSearch& search) {
  constexpr int kRounds = 6;
  constexpr double kOutlierPx = 1, kOutlierMedians = 3;
  ProjectorMap map;
  std::vector<Anchor> anchors = Search(pattern, left, surface, search).anchors();
  const auto too_few = [&] {
    map.anchors = static_cast<int>(anchors.size());
    map.evidence = fmt::format("{} parts of the image were found in the pattern, must be {}",
                               map.anchors, search.anchors_min);
    return map.anchors < search.anchors_min;
  };
  if (too_few()) return map;
  std::vector<Anchor> used = anchors;
  for (int round = 0; round < kRounds; ++round) {
    map.projection = fitted(used);
    std::vector<double> distances;
    for (const Anchor& a : anchors) distances.push_back(distance_px(map, a));
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    const double limit = std::max(kOutlierPx, kOutlierMedians * *middle);
    used.clear();
    std::copy_if(anchors.begin(), anchors.end(), std::back_inserter(used),
                 [&](const Anchor& a) { return distance_px(map, a) < limit; });
  }
  anchors = used;
  if (too_few()) return map;
  double squares = 0;
  for (const Anchor& a : anchors) squares += std::pow(distance_px(map, a), 2);
  map.residual_px = std::sqrt(squares / map.anchors);
  map.is_found = map.residual_px <= search.residual_max_px;
  map.evidence = map.is_found ? std::string()
                              : fmt::format(
                                    "parts of the pattern lie {:.2f} projector pixels from "
                                    "where one projector would have them, limit {:.2f}",
                                    map.residual_px, search.residual_max_px);
  return map;
}

}  // namespace holdfast::registration
