// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_anchors.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <queue>

#include <opencv2/imgproc.hpp>

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
struct Anchor : PatternAnchor {
  cv::Point cell;  // of the grid
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
         const AnchorSearch& options)
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
    return Anchor{{p_mm, corner + cv::Point2d(0.5 * (side - 1), 0.5 * (side - 1))}, cell};
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
  const AnchorSearch& options_;
  cv::Mat1f pattern_, left_, small_;
  double scale_ = 0;
  cv::Size grid_;
};

}  // namespace

std::vector<PatternAnchor> find_anchors(const cv::Mat1b& pattern, const cv::Mat1b& left,
                                        const Reconstruction& surface, const AnchorSearch& search) {
  const std::vector<Anchor> found = Search(pattern, left, surface, search).anchors();
  return {found.begin(), found.end()};
}

}  // namespace holdfast::registration
