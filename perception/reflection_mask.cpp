// SPDX-License-Identifier: Apache-2.0
#include "perception/reflection_mask.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/core/hal/intrin.hpp>
#include <opencv2/imgproc.hpp>

namespace holdfast::perception {
namespace {

// OpenCV's luma: 0.299 R + 0.587 G + 0.114 B, here in 1/128.
constexpr int kRed = 38, kGreen = 75, kBlue = 15;

/// One row of BGR to luma, and to luma where unsaturated, 0 where saturated enough to be no glint.
/// `tau_256`: tau_2 in 1/256.
void split_row(const uchar* bgr, int width, int tau_256, uchar* grey, uchar* unsaturated) {
  int x = 0;
  const cv::v_uint16x8 red = cv::v_setall_u16(kRed), green = cv::v_setall_u16(kGreen),
                       blue = cv::v_setall_u16(kBlue), half = cv::v_setall_u16(64),
                       tau = cv::v_setall_u16(static_cast<ushort>(tau_256));
  for (; x + 16 <= width; x += 16) {
    cv::v_uint8x16 b, g, r;
    cv::v_load_deinterleave(bgr + 3 * x, b, g, r);
    cv::v_uint16x8 b0, b1, g0, g1, r0, r1, t0, t1;
    cv::v_expand(b, b0, b1);
    cv::v_expand(g, g0, g1);
    cv::v_expand(r, r0, r1);
    using cv::v_mul_wrap;  // nothing wraps: 255 * 128 is the most
    const auto low =
        (v_mul_wrap(b0, blue) + v_mul_wrap(g0, green) + v_mul_wrap(r0, red) + half) >> 7;
    const auto high =
        (v_mul_wrap(b1, blue) + v_mul_wrap(g1, green) + v_mul_wrap(r1, red) + half) >> 7;
    const cv::v_uint8x16 luma = cv::v_pack(low, high);
    const cv::v_uint8x16 top = cv::v_max(b, cv::v_max(g, r));
    const cv::v_uint8x16 chroma = top - cv::v_min(b, cv::v_min(g, r));
    cv::v_expand(top, t0, t1);
    const cv::v_uint8x16 limit = cv::v_pack(v_mul_wrap(t0, tau) >> 8, v_mul_wrap(t1, tau) >> 8);
    const cv::v_uint8x16 is_unsaturated = chroma <= limit;
    cv::v_store(grey + x, luma);
    cv::v_store(unsaturated + x, luma & is_unsaturated);
  }
  for (; x < width; ++x) {
    const int b = bgr[3 * x], g = bgr[3 * x + 1], r = bgr[3 * x + 2];
    const int luma = std::min((kBlue * b + kGreen * g + kRed * r + 64) >> 7, 255);
    const int top = std::max({b, g, r}), chroma = top - std::min({b, g, r});
    grey[x] = static_cast<uchar>(luma);
    unsaturated[x] = chroma <= ((top * tau_256) >> 8) ? grey[x] : uchar{0};
  }
}

/// Two rows to one of half size: the mean of 2x2 grey values and the maximum of 2x2 of `bright`.
/// Returns the largest grey value met.
int halve_rows(const uchar* grey0, const uchar* grey1, const uchar* bright0, const uchar* bright1,
               int half_width, uchar* half, uchar* bright_half) {
  cv::v_uint8x16 brightest = cv::v_setzero_u8();
  const cv::v_uint16x8 two = cv::v_setall_u16(2);
  int x = 0;
  for (; x + 16 <= half_width; x += 16) {
    cv::v_uint8x16 a0, a1, b0, b1;
    cv::v_load_deinterleave(grey0 + 2 * x, a0, a1);
    cv::v_load_deinterleave(grey1 + 2 * x, b0, b1);
    brightest = cv::v_max(brightest, cv::v_max(cv::v_max(a0, a1), cv::v_max(b0, b1)));
    cv::v_uint16x8 p, q, low = two, high = two;
    for (const auto& v : {a0, a1, b0, b1}) {
      cv::v_expand(v, p, q);
      low += p;
      high += q;
    }
    cv::v_store(half + x, cv::v_pack(low >> 2, high >> 2));
    cv::v_load_deinterleave(bright0 + 2 * x, a0, a1);
    cv::v_load_deinterleave(bright1 + 2 * x, b0, b1);
    cv::v_store(bright_half + x, cv::v_max(cv::v_max(a0, a1), cv::v_max(b0, b1)));
  }
  int top = cv::v_reduce_max(brightest);
  for (; x < half_width; ++x) {
    const int i = 2 * x;
    top = std::max({top, int{grey0[i]}, int{grey0[i + 1]}, int{grey1[i]}, int{grey1[i + 1]}});
    half[x] = static_cast<uchar>((grey0[i] + grey0[i + 1] + grey1[i] + grey1[i + 1] + 2) >> 2);
    bright_half[x] = std::max({bright0[i], bright0[i + 1], bright1[i], bright1[i + 1]});
  }
  return top;
}

}  // namespace

void make_grey_and_mask(const cv::Mat& image, const ReflectionMaskParameters& parameters,
                        GreyAndMask& out) {
  const bool is_colour = image.channels() == 3;
  const int width = image.cols, half_width = width / 2, half_height = image.rows / 2;
  out.grey.create(image.size(), CV_8UC1);
  out.half.create(half_height, half_width, CV_8UC1);
  out.keep_half.create(half_height, half_width, CV_8UC1);
  if (!is_colour) image.copyTo(out.grey);

  const int tau_256 = static_cast<int>(std::lround(parameters.tau_saturation * 256));
  std::vector<uchar> bright(is_colour ? static_cast<std::size_t>(width) * 2 : 0);
  int top = 0;
  for (int y = 0; y < half_height; ++y) {
    uchar* grey[] = {out.grey.ptr(2 * y), out.grey.ptr(2 * y + 1)};
    uchar* rows[] = {grey[0], grey[1]};
    for (int k = 0; is_colour && k < 2; ++k) {
      rows[k] = bright.data() + static_cast<std::ptrdiff_t>(k) * width;
      split_row(image.ptr(2 * y + k), width, tau_256, grey[k], rows[k]);
    }
    top = std::max(top, halve_rows(grey[0], grey[1], rows[0], rows[1], half_width, out.half.ptr(y),
                                   out.keep_half.ptr(y)));
  }
  if (is_colour && image.rows % 2 != 0)
    split_row(image.ptr(image.rows - 1), width, tau_256, out.grey.ptr(image.rows - 1),
              bright.data());

  if (!parameters.is_enabled) {
    out.keep_half.setTo(255);
    return;
  }
  const double tau = is_colour ? parameters.tau_intensity : parameters.tau_intensity_grey;
  const double limit = std::max(tau * top, static_cast<double>(parameters.intensity_min));
  // keep = I < limit; the threshold keeps what is at most limit - 1.
  cv::threshold(out.keep_half, out.keep_half, std::ceil(limit) - 1, 255, cv::THRESH_BINARY_INV);
  const int radius = (parameters.dilation_px + 1) / 2;
  if (radius > 0) {
    const cv::Mat square =
        cv::getStructuringElement(cv::MORPH_RECT, cv::Size(2 * radius + 1, 2 * radius + 1));
    cv::erode(out.keep_half, out.keep_half, square);
  }
}

}  // namespace holdfast::perception
