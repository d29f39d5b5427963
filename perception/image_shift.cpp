// SPDX-License-Identifier: Apache-2.0
#include "perception/image_shift.hpp"

#include <opencv2/imgproc.hpp>

namespace holdfast::perception {
namespace {

constexpr double kToFull = 8;        // pixels of the full image in one of these
constexpr double kPeakMinSigma = 6;  // above the correlation's own spread

}  // namespace

void ImageShift::reduce(const cv::Mat& quarter, cv::Mat& out) {
  const cv::Size size(quarter.cols / 2, quarter.rows / 2);
  cv::resize(quarter, small_, size, 0, 0, cv::INTER_AREA);
  small_.convertTo(out, CV_32F);
  if (window_.size() != size) cv::createHanningWindow(window_, size, CV_32F);
  out -= cv::mean(out);
  cv::multiply(out, window_, out);
}

void ImageShift::remember(const cv::Mat& quarter) {
  has_previous_ = quarter.cols >= 32 && quarter.rows >= 32;
  if (has_previous_) quarter.copyTo(previous_);
}

std::optional<cv::Point2d> ImageShift::find(const cv::Mat& quarter) {
  if (!has_previous_ || previous_.size() != quarter.size()) return std::nullopt;
  reduce(previous_, now_);
  cv::dft(now_, spectrum_before_);
  reduce(quarter, now_);
  cv::dft(now_, spectrum_now_);
  cv::mulSpectrums(spectrum_now_, spectrum_before_, spectrum_now_, 0, true);
  // Half way between cross and phase correlation: noise that fills the spectrum has less to say.
  const int stride = 2;
  for (int y = 0; y < spectrum_now_.rows; ++y) {
    auto* row = spectrum_now_.ptr<float>(y);
    for (int x = 1; x + 1 < spectrum_now_.cols; x += stride) {
      const float power = std::sqrt(row[x] * row[x] + row[x + 1] * row[x + 1]);
      const float scale = 1 / std::sqrt(power + 1e-6F);
      row[x] *= scale;
      row[x + 1] *= scale;
    }
    row[0] = 0;
    if (spectrum_now_.cols % 2 == 0) row[spectrum_now_.cols - 1] = 0;
  }
  cv::idft(spectrum_now_, correlation_, cv::DFT_SCALE);
  cv::Point peak;
  double highest = 0;
  cv::minMaxLoc(correlation_, nullptr, &highest, nullptr, &peak);
  cv::Scalar mean, deviation;
  cv::meanStdDev(correlation_, mean, deviation);
  if (!(highest > mean[0] + kPeakMinSigma * deviation[0])) return std::nullopt;
  if (peak.x > correlation_.cols / 2) peak.x -= correlation_.cols;
  if (peak.y > correlation_.rows / 2) peak.y -= correlation_.rows;
  return kToFull * cv::Point2d(peak);
}

}  // namespace holdfast::perception
