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
  static const auto kHalfWidths = disc_half_widths();
  const auto step = static_cast<std::ptrdiff_t>(image.step1());
  const uchar* centre = image.ptr(cvRound(corner.y)) + cvRound(corner.x);
  int m01 = 0, m10 = 0;
  for (int u = -kPatchRadius; u <= kPatchRadius; ++u) m10 += u * centre[u];
  for (int v = 1; v <= kPatchRadius; ++v) {
    const uchar *above = centre - v * step, *below = centre + v * step;
    const int half_width = kHalfWidths[static_cast<std::size_t>(v)];
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

}  // namespace

struct FeatureDetector::Impl {
  FeatureParameters parameters;
  cv::Ptr<cv::ORB> orb;
  cv::Mat level, smaller;
  std::vector<cv::KeyPoint> corners;
  std::vector<std::vector<cv::KeyPoint>> cells;
  cv::Mat descriptors;

  void find_corners(const cv::Mat& image, const cv::Mat& keep, double scale, int wanted,
                    int threshold);
  void spread(cv::Size size, int cell_px, int wanted);
  void describe(const cv::Mat& image, double to_full, Features& out);
  void detect(const cv::Mat& base, const cv::Mat& keep, double base_scale, int threshold,
              Features& out);
};

/// Corners of one pyramid level in the kept region, at most `wanted`, spread over the cells.
void FeatureDetector::Impl::find_corners(const cv::Mat& image, const cv::Mat& keep, double scale,
                                         int wanted, int threshold) {
  cv::FAST(image, corners, threshold, true);
  const double to_keep_x = static_cast<double>(keep.cols) / image.cols;
  const double to_keep_y = static_cast<double>(keep.rows) / image.rows;
  const auto is_unusable = [&](const cv::KeyPoint& corner) {
    const float x = corner.pt.x, y = corner.pt.y;
    if (x < kBorder || y < kBorder || x >= static_cast<float>(image.cols - kBorder) ||
        y >= static_cast<float>(image.rows - kBorder))
      return true;
    const int column =
        std::min(static_cast<int>((static_cast<double>(x) + 0.5) * to_keep_x), keep.cols - 1);
    const int row =
        std::min(static_cast<int>((static_cast<double>(y) + 0.5) * to_keep_y), keep.rows - 1);
    return keep.at<uchar>(row, column) == 0;
  };
  corners.erase(std::remove_if(corners.begin(), corners.end(), is_unusable), corners.end());
  spread(image.size(), std::max(8, static_cast<int>(parameters.cell_px / scale)), wanted);
}

/// Keeps the strongest of each cell, so many that the cells together hold half as many again as
/// wanted, and of those the strongest.
void FeatureDetector::Impl::spread(cv::Size size, int cell_px, int wanted) {
  if (corners.size() <= static_cast<std::size_t>(wanted)) return;
  const int columns = size.width / cell_px + 1, rows = size.height / cell_px + 1;
  cells.resize(std::max(cells.size(), static_cast<std::size_t>(columns * rows)));
  for (auto& cell : cells) cell.clear();
  for (const cv::KeyPoint& corner : corners)
    cells[static_cast<std::size_t>(static_cast<int>(corner.pt.y) / cell_px * columns +
                                   static_cast<int>(corner.pt.x) / cell_px)]
        .push_back(corner);
  const auto share = static_cast<std::size_t>(1.5 * wanted / (columns * rows)) + 1;
  corners.clear();
  for (auto& cell : cells) {
    keep_strongest(cell, share);
    corners.insert(corners.end(), cell.begin(), cell.end());
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

void FeatureDetector::Impl::detect(const cv::Mat& base, const cv::Mat& keep, double base_scale,
                                   int threshold, Features& out) {
  out.pixels.clear();
  out.descriptors.clear();
  out.strengths.clear();
  double weights = 0;
  for (int l = 0; l < parameters.levels; ++l) weights += std::pow(parameters.level_scale, -2.0 * l);
  cv::Mat image = base;
  for (int l = 0; l < parameters.levels; ++l) {
    const double scale = std::pow(parameters.level_scale, l);
    if (l > 0) {
      const cv::Size size(cvRound(base.cols / scale), cvRound(base.rows / scale));
      if (size.width <= 2 * kBorder || size.height <= 2 * kBorder) break;
      cv::resize(image, smaller, size, 0, 0, cv::INTER_LINEAR);
      std::swap(level, smaller);
      image = level;
    }
    const int wanted = cvRound(parameters.count / (scale * scale) / weights);
    find_corners(image, keep, base_scale * scale, wanted, threshold);
    describe(image, base_scale * scale, out);
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

void FeatureDetector::detect(const cv::Mat& grey, const cv::Mat& half, const cv::Mat& keep_half,
                             Features& out) {
  // A small image has too few pixels to give half of each side away.
  constexpr std::size_t kSmallPx = 600'000;
  const bool is_full = impl_->parameters.is_full_size || grey.total() < kSmallPx;
  const cv::Mat& base = is_full ? grey : half;
  const int threshold = impl_->parameters.fast_threshold;
  impl_->detect(base, keep_half, is_full ? 1 : 2, threshold, out);
  // A frame that starves gets a second, finer look.
  if (out.size() < impl_->parameters.count / 4 && threshold >= 4)
    impl_->detect(base, keep_half, is_full ? 1 : 2, threshold / 2, out);
}

}  // namespace holdfast::perception
