// SPDX-License-Identifier: Apache-2.0
#include "registration/spot_detection.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using Bell = Eigen::Matrix<double, 7, 1>;  // background, height, x, y, inverse covariance a, b, c

constexpr double kSmoothingPx = 1.5;      // finds spots, not pixels
constexpr double kNormalMad = 0.6744898;  // median absolute deviation of a standard normal
constexpr double kLeastNoiseGrey = 0.3;   // of the rounding to whole grey values
constexpr double kWindow = 3;             // half the fit's window, in radii of the spot

struct Blob {
  cv::Point peak;
  double height_grey = 0;
};

double median_of(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return static_cast<double>(*middle);
}

/// What the beam has added, its surroundings at zero, and the noise of one pixel.
struct Light {
  cv::Mat1f grey;
  double noise_grey = 0;
};

Light light_of(const cv::Mat1b& on, const cv::Mat1b& off) {
  Light light;
  on.convertTo(light.grey, CV_32F);
  if (!off.empty()) {
    cv::Mat1f dark;
    off.convertTo(dark, CV_32F);
    light.grey -= dark;
  }
  std::vector<float> sample;
  const int step =
      std::max(1, static_cast<int>(std::sqrt(static_cast<double>(on.total()) / 50'000)));
  for (int y = 0; y < on.rows; y += step)
    for (int x = 0; x < on.cols; x += step) sample.push_back(light.grey(y, x));
  const double level = median_of(sample);
  for (float& value : sample) value = std::abs(value - static_cast<float>(level));
  light.noise_grey = std::max(median_of(std::move(sample)) / kNormalMad, kLeastNoiseGrey);
  light.grey -= level;
  return light;
}

/// Brightest first: every connected patch above half of its own peak, of those above `floor_grey`.
std::vector<Blob> blobs_of(const cv::Mat1f& smooth, double floor_grey) {
  cv::Mat1b above;
  cv::compare(smooth, floor_grey, above, cv::CMP_GT);
  cv::Mat1i labels;
  const int count = cv::connectedComponents(above, labels, 8, CV_32S);
  std::vector<Blob> blobs(static_cast<std::size_t>(count));
  for (int y = 0; y < smooth.rows; ++y)
    for (int x = 0; x < smooth.cols; ++x) {
      if (labels(y, x) == 0) continue;
      Blob& blob = blobs[static_cast<std::size_t>(labels(y, x))];
      if (const auto value = static_cast<double>(smooth(y, x)); value > blob.height_grey)
        blob = {{x, y}, value};
    }
  blobs.erase(blobs.begin());  // label 0: all the rest
  std::sort(blobs.begin(), blobs.end(),
            [](const Blob& a, const Blob& b) { return a.height_grey > b.height_grey; });
  return blobs;
}

/// The bell's value at a pixel and its derivatives.
double bell_at(const Bell& bell, double x, double y, Bell& slope) {
  const double dx = x - bell[2], dy = y - bell[3];
  const double e = std::exp(-0.5 * (bell[4] * dx * dx + 2 * bell[5] * dx * dy + bell[6] * dy * dy));
  const double h = bell[1] * e;
  slope << 1, e, h * (bell[4] * dx + bell[5] * dy), h * (bell[5] * dx + bell[6] * dy),
      -0.5 * h * dx * dx, -h * dx * dy, -0.5 * h * dy * dy;
  return bell[0] + h;
}

struct BellFit {
  Bell bell;
  Eigen::Matrix2d covariance;
  bool is_found = false;
};

/// Residuals of neighbours are alike (texture, speckle): as if there were so many fewer of them.
double likeness_factor(const cv::Mat1f& residual) {
  double products = 0, squares = 0;
  for (int y = 0; y + 1 < residual.rows; ++y)
    for (int x = 0; x + 1 < residual.cols; ++x) {
      const auto r = static_cast<double>(residual(y, x));
      products += 0.5 * r * static_cast<double>(residual(y, x + 1) + residual(y + 1, x));
      squares += r * r;
    }
  const double rho = squares > 0 ? std::clamp(products / squares, 0.0, 0.95) : 0;
  return std::pow((1 + rho) / (1 - rho), 2);
}

/// Levenberg-Marquardt from `start` on the window.
BellFit fit_bell(const cv::Mat1f& grey, const cv::Rect& window, const Bell& start) {
  BellFit fit{start, Eigen::Matrix2d::Zero(), false};
  cv::Mat1f residual(window.size());
  Eigen::Matrix<double, 7, 7> normal;
  Bell right, slope;
  const auto evaluate = [&](const Bell& bell) {
    normal.setZero();
    right.setZero();
    double cost = 0;
    for (int y = 0; y < window.height; ++y)
      for (int x = 0; x < window.width; ++x) {
        const double r = static_cast<double>(grey(window.y + y, window.x + x)) -
                         bell_at(bell, window.x + x, window.y + y, slope);
        residual(y, x) = static_cast<float>(r);
        cost += r * r;
        normal.selfadjointView<Eigen::Lower>().rankUpdate(slope);
        right += r * slope;
      }
    normal = normal.selfadjointView<Eigen::Lower>();
    return cost;
  };
  constexpr int kStepsMax = 60;
  constexpr double kCentreAtRestPx = 1e-5;
  double cost = evaluate(fit.bell), damping = 1e-3;
  for (int i = 0; i < kStepsMax; ++i) {
    Eigen::Matrix<double, 7, 7> damped = normal;
    damped.diagonal() *= 1 + damping;
    const Bell step = damped.ldlt().solve(right);
    if (!step.allFinite()) return fit;
    const Bell next = fit.bell + step;
    const double next_cost = evaluate(next);
    if (next_cost <= cost) {
      fit.bell = next;
      cost = next_cost;
      damping *= 0.1;
      if (step.segment<2>(2).norm() < kCentreAtRestPx) break;
    } else {
      (void)evaluate(fit.bell);
      damping *= 10;
    }
  }
  (void)evaluate(fit.bell);
  const double count = window.area();
  const Eigen::Matrix<double, 7, 7> inverse =
      normal.ldlt().solve(Eigen::Matrix<double, 7, 7>::Identity());
  fit.covariance =
      cost / std::max(count - 7, 1.0) * likeness_factor(residual) * inverse.block<2, 2>(2, 2);
  fit.is_found = fit.bell.allFinite() && fit.covariance.allFinite();
  return fit;
}

/// Height, centre and width of the patch above half of the peak.
Bell start_of(const cv::Mat1f& smooth, const Blob& blob, cv::Rect& patch) {
  cv::Mat1b filled;
  cv::compare(smooth, 0.5 * blob.height_grey, filled, cv::CMP_GT);
  cv::floodFill(filled, blob.peak, 128, &patch, 0, 0, 8);
  cv::Mat1b mask;
  cv::compare(filled(patch), 128, mask, cv::CMP_EQ);
  const cv::Moments m = cv::moments(mask, true);
  const double pixels = std::max(m.m00, 1.0);
  // A patch above half of a bell's height is a disc of 1.18 standard deviations.
  constexpr double kBellOfDisc = 4 / (1.17741 * 1.17741);
  const double xx = kBellOfDisc * std::max(m.mu20 / pixels, 0.1);
  const double yy = kBellOfDisc * std::max(m.mu02 / pixels, 0.1);
  Bell bell;
  bell << 0, blob.height_grey, patch.x + m.m10 / pixels, patch.y + m.m01 / pixels, 1 / xx, 0,
      1 / yy;
  return bell;
}

int saturated_in(const cv::Mat1b& on, const cv::Rect& window, int grey) {
  return cv::countNonZero(on(window) >= grey);
}

cv::Rect window_about(const Bell& start, int radius_px) {
  return {static_cast<int>(std::lround(start[2])) - radius_px,
          static_cast<int>(std::lround(start[3])) - radius_px, 2 * radius_px + 1,
          2 * radius_px + 1};
}

void check_blobs(const std::vector<Blob>& blobs, const Light& light, double least_grey,
                 const std::string& name, const SpotLimits& limits) {
  if (blobs.empty())
    throw RefusedError(
        fmt::format("{}: no spot: nothing stands {:.1f} grey above its surroundings (noise {:.1f})",
                    name, least_grey, light.noise_grey));
  if (blobs.size() > 1 && blobs[1].height_grey > limits.rival_share * blobs[0].height_grey)
    throw RefusedError(fmt::format("{}: two spots: {:.0f} grey at {},{} px and {:.0f} at {},{} px",
                                   name, blobs[0].height_grey, blobs[0].peak.x, blobs[0].peak.y,
                                   blobs[1].height_grey, blobs[1].peak.x, blobs[1].peak.y));
}

}  // namespace

ImageSpot find_spot(const cv::Mat1b& on, const cv::Mat1b& off, const std::string& name,
                    const SpotLimits& limits) {
  if (!off.empty() && off.size() != on.size())
    throw InputError(fmt::format("{}: is {}x{} px, without the beam {}x{} px", name, on.cols,
                                 on.rows, off.cols, off.rows));
  const Light light = light_of(on, off);
  cv::Mat1f smooth;
  cv::GaussianBlur(light.grey, smooth, cv::Size(), kSmoothingPx);
  const double least_grey =
      std::max(limits.least_contrast_grey, limits.least_contrast_sigma * light.noise_grey);
  double brightest = 0;
  cv::minMaxLoc(smooth, nullptr, &brightest);
  // A rival must be seen as a patch of its own, so the floor lies below what it is judged by.
  const auto blobs =
      brightest < least_grey
          ? std::vector<Blob>{}
          : blobs_of(smooth, std::max(0.8 * limits.rival_share * brightest, 0.5 * least_grey));
  check_blobs(blobs, light, least_grey, name, limits);

  cv::Rect patch;
  const Bell start = start_of(smooth, blobs[0], patch);
  const double share = static_cast<double>(patch.area()) / static_cast<double>(on.total());
  if (!(share < limits.largest_share))
    throw RefusedError(
        fmt::format("{}: the bright patch takes {:.1f} % of the image, a spot must be below {:g} %",
                    name, 100 * share, 100 * limits.largest_share));
  const double radius_px = std::sqrt(std::max(1 / start[4], 1 / start[6]));
  const cv::Rect window =
      window_about(start, std::max(4, static_cast<int>(std::ceil(kWindow * radius_px))));
  if ((window & cv::Rect({}, on.size())) != window)
    throw RefusedError(fmt::format("{}: the spot at {:.0f},{:.0f} px is cut off by the border",
                                   name, start[2], start[3]));
  if (const int count = saturated_in(on, window, limits.saturated_grey);
      count > limits.saturated_max_px)
    throw RefusedError(fmt::format(
        "{}: the spot at {:.0f},{:.0f} px is saturated: {} pixels at {} grey or more, at most {}; "
        "less light or a shorter exposure",
        name, start[2], start[3], count, limits.saturated_grey, limits.saturated_max_px));

  const BellFit fit = fit_bell(light.grey, window, start);
  Eigen::Matrix2d shape;
  shape << fit.bell[4], fit.bell[5], fit.bell[5], fit.bell[6];
  const Eigen::Vector2d widths =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(shape).eigenvalues();
  const double slimness = widths[0] > 0 ? std::sqrt(widths[0] / widths[1]) : 0;
  ImageSpot spot;
  spot.centre_px = fit.bell.segment<2>(2);
  if (!fit.is_found || !(slimness > limits.slimmest) ||
      (spot.centre_px - start.segment<2>(2)).norm() > radius_px)
    throw RefusedError(fmt::format(
        "{}: the bright patch at {:.0f},{:.0f} px is no round spot (short axis {:.2f} of the long "
        "one, at least {:g})",
        name, start[2], start[3], slimness, limits.slimmest));
  spot.covariance_px2 =
      fit.covariance + limits.least_sigma_px * limits.least_sigma_px * Eigen::Matrix2d::Identity();
  spot.contrast_grey = fit.bell[1];
  spot.radius_px = std::pow(shape.determinant(), -0.25);
  return spot;
}

}  // namespace holdfast::registration
