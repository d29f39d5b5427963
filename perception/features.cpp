// SPDX-License-Identifier: Apache-2.0
#include "perception/features.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

namespace holdfast::perception {
namespace {

constexpr int kPatchRadius = 15;  // of the orientation, as in ORB
constexpr int kBorder = 20;       // ORB's rotated tests reach 19 pixels from the corner, blurred

/// Half the width of each row of the disc the orientation is measured on.
std::array<int, kPatchRadius + 1> disc_half_widths() {
  std::array<int, kPatchRadius + 1> half_widths{};
  for (int v = 0; v <= kPatchRadius; ++v)
    half_widths[static_cast<std::size_t>(v)] =
        static_cast<int>(std::lround(std::sqrt(kPatchRadius * kPatchRadius - v * v)));
  return half_widths;
}

/// Direction of the intensity centroid of the disc around a corner, in degrees, 0 to 360.
float orientation_deg(const cv::Mat& image, cv::Point2f corner) {
  static const auto disc = disc_half_widths();
  const auto step = static_cast<std::ptrdiff_t>(image.step1());
  const uchar* centre = image.ptr(cvRound(corner.y)) + cvRound(corner.x);
  int m01 = 0, m10 = 0;
  for (int u = -kPatchRadius; u <= kPatchRadius; ++u) m10 += u * centre[u];
  for (int v = 1; v <= kPatchRadius; ++v) {
    const uchar *above = centre - v * step, *below = centre + v * step;
    const int half_width = disc[static_cast<std::size_t>(v)];
    int difference = 0;
    for (int u = -half_width; u <= half_width; ++u) {
      difference += below[u] - above[u];
      m10 += u * (below[u] + above[u]);
    }
    m01 += v * difference;
  }
  return cv::fastAtan2(static_cast<float>(m01), static_cast<float>(m10));
}

bool is_stronger(const cv::KeyPoint& a, const cv::KeyPoint& b) {
  if (a.response != b.response) return a.response > b.response;
  return a.pt.y != b.pt.y ? a.pt.y < b.pt.y : a.pt.x < b.pt.x;  // deterministic
}

void keep_strongest(std::vector<cv::KeyPoint>& corners, std::size_t count) {
  if (corners.size() > count) {
    std::nth_element(corners.begin(), corners.begin() + static_cast<std::ptrdiff_t>(count),
                     corners.end(), is_stronger);
    corners.resize(count);
  }
}

/// One pyramid level's grid of cells, each with a FAST threshold of its own that follows the scene:
/// it rises where corners abound and falls where they are few. Most of FAST's time goes into
/// corners that nobody keeps.
struct CellGrid {
  int columns = 0, rows = 0;
  std::vector<int> thresholds;

  void resize(int wanted_columns, int wanted_rows, int threshold) {
    if (columns == wanted_columns && rows == wanted_rows) return;
    columns = wanted_columns;
    rows = wanted_rows;
    thresholds.assign(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows),
                      threshold);
  }
};

}  // namespace

struct FeatureDetector::Impl {
  FeatureParameters parameters;
  cv::Ptr<cv::ORB> orb;
  cv::Mat level, smaller;
  std::vector<CellGrid> grids;  // of each level
  std::vector<cv::KeyPoint> corners, cell_corners;
  cv::Mat descriptors;

  void find_corners(const cv::Mat& image, const cv::Mat& keep, int cell_px, int wanted,
                    CellGrid& grid);
  int find_in_cell(const cv::Mat& image, const cv::Mat& keep, cv::Rect cell, int threshold);
  void describe(const cv::Mat& image, double to_full, Features& out);
};

/// The corners of one cell in the kept region, into cell_corners. Returns how many there were
/// before the mask.
int FeatureDetector::Impl::find_in_cell(const cv::Mat& image, const cv::Mat& keep, cv::Rect cell,
                                        int threshold) {
  // FAST leaves a frame of 3 pixels, and its non-maximum suppression needs one more.
  constexpr int kFrame = 4;
  const cv::Rect reach(cell.x - kFrame, cell.y - kFrame, cell.width + 2 * kFrame,
                       cell.height + 2 * kFrame);
  cv::FAST(image(reach), cell_corners, threshold, true);
  const auto found = static_cast<int>(cell_corners.size());
  const double to_keep_x = static_cast<double>(keep.cols) / image.cols;
  const double to_keep_y = static_cast<double>(keep.rows) / image.rows;
  const auto is_unusable = [&](cv::KeyPoint& corner) {
    corner.pt += cv::Point2f(reach.tl());
    const cv::Point2d p = corner.pt;
    if (!cell.contains(cv::Point(corner.pt))) return true;
    const int column = std::min(static_cast<int>((p.x + 0.5) * to_keep_x), keep.cols - 1);
    const int row = std::min(static_cast<int>((p.y + 0.5) * to_keep_y), keep.rows - 1);
    return keep.at<uchar>(row, column) == 0;
  };
  cell_corners.erase(std::remove_if(cell_corners.begin(), cell_corners.end(), is_unusable),
                     cell_corners.end());
  return found;
}

/// The strongest corners of each cell of one pyramid level, so many that the cells together hold
/// half as many again as wanted, and of those the strongest.
void FeatureDetector::Impl::find_corners(const cv::Mat& image, const cv::Mat& keep, int cell_px,
                                         int wanted, CellGrid& grid) {
  corners.clear();
  const cv::Rect inside(kBorder, kBorder, image.cols - 2 * kBorder, image.rows - 2 * kBorder);
  const int columns = (inside.width + cell_px - 1) / cell_px;
  const int rows = (inside.height + cell_px - 1) / cell_px;
  grid.resize(columns, rows, parameters.fast_threshold);
  const int share = static_cast<int>(1.5 * wanted / (columns * rows)) + 1;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      const cv::Rect cell =
          cv::Rect(kBorder + column * cell_px, kBorder + row * cell_px, cell_px, cell_px) & inside;
      const int index = row * columns + column;
      int& threshold = grid.thresholds[static_cast<std::size_t>(index)];
      const int found = find_in_cell(image, keep, cell, threshold);
      if (found > 3 * share)
        threshold = std::min(threshold + 1 + threshold / 4, 100);
      else if (found < 3 * share / 2)
        threshold = std::max(threshold - 1 - threshold / 5, parameters.fast_threshold);
      keep_strongest(cell_corners, static_cast<std::size_t>(share));
      corners.insert(corners.end(), cell_corners.begin(), cell_corners.end());
    }
  keep_strongest(corners, static_cast<std::size_t>(wanted));
}

void FeatureDetector::Impl::describe(const cv::Mat& image, double to_full, Features& out) {
  if (corners.empty()) return;
  for (cv::KeyPoint& corner : corners) {
    corner.angle = orientation_deg(image, corner.pt);
    corner.octave = 0;
  }
  orb->compute(image, corners, descriptors);
  for (int i = 0; i < descriptors.rows; ++i) {
    const cv::KeyPoint& corner = corners[static_cast<std::size_t>(i)];
    Descriptor descriptor;
    std::memcpy(descriptor.data(), descriptors.ptr(i), sizeof descriptor);
    out.descriptors.push_back(descriptor);
    out.strengths.push_back(corner.response);
    // Centre of pixel i of an image reduced by s lies at (i + 0.5) s - 0.5.
    out.pixels.emplace_back(
        static_cast<float>(std::floor((static_cast<double>(corner.pt.x) + 0.5) * to_full)),
        static_cast<float>(std::floor((static_cast<double>(corner.pt.y) + 0.5) * to_full)));
  }
}

FeatureDetector::FeatureDetector(const FeatureParameters& parameters)
    : impl_(std::make_unique<Impl>()) {
  impl_->parameters = parameters;
  impl_->orb = cv::ORB::create(parameters.count, 1.2F, 1, kBorder - 1, 0, 2, cv::ORB::FAST_SCORE,
                               2 * kPatchRadius + 1);
}
FeatureDetector::~FeatureDetector() = default;
FeatureDetector::FeatureDetector(FeatureDetector&&) noexcept = default;
FeatureDetector& FeatureDetector::operator=(FeatureDetector&&) noexcept = default;

void FeatureDetector::reset() {
  impl_->grids.clear();
}

void FeatureDetector::detect(const cv::Mat& grey, const cv::Mat& half, const cv::Mat& keep_half,
                             Features& out) {
  Impl& s = *impl_;
  const FeatureParameters& p = s.parameters;
  // A small image has too few pixels to give half of each side away.
  constexpr std::size_t kSmallPx = 600'000;
  const bool is_full = p.is_full_size || grey.total() < kSmallPx;
  const cv::Mat& base = is_full ? grey : half;
  out.pixels.clear();
  out.descriptors.clear();
  out.strengths.clear();
  s.grids.resize(static_cast<std::size_t>(p.levels));
  double weights = 0;
  for (int l = 0; l < p.levels; ++l) weights += std::pow(p.level_scale, -2.0 * l);
  cv::Mat image = base;
  for (int l = 0; l < p.levels; ++l) {
    const double scale = std::pow(p.level_scale, l), to_full = (is_full ? 1 : 2) * scale;
    const cv::Size size(cvRound(base.cols / scale), cvRound(base.rows / scale));
    if (size.width <= 2 * kBorder || size.height <= 2 * kBorder) break;
    if (l > 0) {
      cv::resize(image, s.smaller, size, 0, 0, cv::INTER_LINEAR);
      std::swap(s.level, s.smaller);
      image = s.level;
    }
    const int wanted = cvRound(p.count / (scale * scale) / weights);
    const int cell_px = std::max(16, static_cast<int>(p.cell_px / to_full));
    s.find_corners(image, keep_half, cell_px, wanted, s.grids[static_cast<std::size_t>(l)]);
    s.describe(image, to_full, out);
  }
}

}  // namespace holdfast::perception
