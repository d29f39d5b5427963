// SPDX-License-Identifier: Apache-2.0
#include "registration/rectified_image.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <immintrin.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace holdfast::registration {
namespace {

constexpr int kStep = 8;  // px between the exact positions: one AVX2 register of floats
constexpr int kRowsPerTask = 64;

/// One row's way through the raw image: eight pixels from node to node.
struct RowPath {
  const float *u, *v;  // raw positions at every 8th pixel, and one more
  int cells;
};

struct RawView {
  const uchar* pixels;
  int stride;
  float u_end, v_end;  // positions below these have all their neighbours
};

void resample_scalar(const RawView& raw, const RowPath& path, uchar* out, uchar* is_covered) {
  for (int cell = 0; cell < path.cells; ++cell) {
    const float du = (path.u[cell + 1] - path.u[cell]) * 0.125F;
    const float dv = (path.v[cell + 1] - path.v[cell]) * 0.125F;
    for (int i = 0; i < kStep; ++i) {
      const int x = kStep * cell + i;
      const float u = path.u[cell] + static_cast<float>(i) * du;
      const float v = path.v[cell] + static_cast<float>(i) * dv;
      const bool is_in = u >= 0 && u < raw.u_end && v >= 0 && v < raw.v_end;
      is_covered[x] = is_in ? 255 : 0;
      out[x] = 0;
      if (!is_in) continue;
      const float iu = std::floor(u), iv = std::floor(v), fu = u - iu, fv = v - iv;
      const uchar* p = raw.pixels + static_cast<int>(iv) * raw.stride + static_cast<int>(iu);
      const float a = p[0], b = p[1], c = p[raw.stride], d = p[raw.stride + 1];
      const float above = a + (b - a) * fu, below = c + (d - c) * fu;
      // Half is added before the cast, which cuts: the value is never negative.
      const float rounded = above + (below - above) * fv + 0.5F;
      out[x] = static_cast<uchar>(static_cast<int>(rounded));
    }
  }
}

__attribute__((target("avx2"))) void resample_avx2(const RawView& raw, const RowPath& path,
                                                   uchar* out, uchar* is_covered) {
  const __m256 steps = _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7), zero = _mm256_setzero_ps();
  const __m256i low = _mm256_set1_epi32(255), stride = _mm256_set1_epi32(raw.stride);
  const auto* base = reinterpret_cast<const int*>(raw.pixels);
  for (int cell = 0; cell < path.cells; ++cell) {
    const float u0 = path.u[cell], v0 = path.v[cell];
    const __m256 du = _mm256_set1_ps((path.u[cell + 1] - u0) * 0.125F);
    const __m256 dv = _mm256_set1_ps((path.v[cell + 1] - v0) * 0.125F);
    const __m256 u = _mm256_add_ps(_mm256_set1_ps(u0), _mm256_mul_ps(steps, du));
    const __m256 v = _mm256_add_ps(_mm256_set1_ps(v0), _mm256_mul_ps(steps, dv));
    const __m256 is_in =
        _mm256_and_ps(_mm256_and_ps(_mm256_cmp_ps(u, zero, _CMP_GE_OQ),
                                    _mm256_cmp_ps(u, _mm256_set1_ps(raw.u_end), _CMP_LT_OQ)),
                      _mm256_and_ps(_mm256_cmp_ps(v, zero, _CMP_GE_OQ),
                                    _mm256_cmp_ps(v, _mm256_set1_ps(raw.v_end), _CMP_LT_OQ)));
    const __m256 iu = _mm256_floor_ps(u), iv = _mm256_floor_ps(v);
    const __m256 fu = _mm256_sub_ps(u, iu), fv = _mm256_sub_ps(v, iv);
    const __m256i inside = _mm256_castps_si256(is_in);
    const __m256i at =
        _mm256_and_si256(_mm256_add_epi32(_mm256_mullo_epi32(_mm256_cvtps_epi32(iv), stride),
                                          _mm256_cvtps_epi32(iu)),
                         inside);
    // Four bytes from each position on, of which two are used.
    const __m256i top = _mm256_i32gather_epi32(base, at, 1);
    const __m256i bottom = _mm256_i32gather_epi32(base, _mm256_add_epi32(at, stride), 1);
    const __m256 a = _mm256_cvtepi32_ps(_mm256_and_si256(top, low));
    const __m256 b = _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(top, 8), low));
    const __m256 c = _mm256_cvtepi32_ps(_mm256_and_si256(bottom, low));
    const __m256 d = _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(bottom, 8), low));
    const __m256 above = _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), fu));
    const __m256 below = _mm256_add_ps(c, _mm256_mul_ps(_mm256_sub_ps(d, c), fu));
    const __m256 value = _mm256_add_ps(above, _mm256_mul_ps(_mm256_sub_ps(below, above), fv));
    const __m256i grey =
        _mm256_and_si256(_mm256_cvttps_epi32(_mm256_add_ps(value, _mm256_set1_ps(0.5F))), inside);
    const __m256i words = _mm256_packs_epi32(grey, inside);  // grey, mask | grey, mask
    const __m256i bytes = _mm256_shuffle_epi8(
        words, _mm256_set1_epi64x(0x0e0c0a0806040200));  // the low byte of each word
    const __m128i lower = _mm256_castsi256_si128(bytes), upper = _mm256_extracti128_si256(bytes, 1);
    const __m128i both = _mm_unpacklo_epi32(lower, upper);  // 8 greys, then 8 masks
    _mm_storel_epi64(reinterpret_cast<__m128i*>(out + kStep * cell), both);
    _mm_storeh_pd(reinterpret_cast<double*>(is_covered + kStep * cell), _mm_castsi128_pd(both));
  }
}

cv::Range covered_columns(const uchar* is_covered, int width) {
  const uchar* end = is_covered + width;
  const uchar* first = std::find(is_covered, end, uchar{255});
  if (first == end) return {0, 0};
  while (end[-1] == 0) --end;
  return {static_cast<int>(first - is_covered), static_cast<int>(end - is_covered)};
}

}  // namespace

cv::Mat1b grey_of(const cv::Mat& image) {
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  if (grey.depth() == CV_16U) grey.convertTo(grey, CV_8U, 1.0 / 257);
  return grey;
}

Rectifier::Rectifier(const cv::Matx33d& camera_matrix, const cv::Mat& distortion,
                     const cv::Matx33d& R_, const cv::Matx34d& projection, cv::Size raw_size_px,
                     const cv::Rect& region)
    : raw_size_px_(raw_size_px), region_(region) {
  // A camera whose pixels are the nodes of the grid.
  const cv::Matx33d nodes(projection(0, 0) / kStep, 0, (projection(0, 2) - region.x) / kStep, 0,
                          projection(1, 1) / kStep, (projection(1, 2) - region.y) / kStep, 0, 0, 1);
  const cv::Size size(region.width / kStep + 2, region.height / kStep + 2);
  cv::initUndistortRectifyMap(camera_matrix, distortion, R_, nodes, size, CV_32FC1, u_, v_);
}

void Rectifier::apply(const cv::Mat1b& raw, WorkerPool& pool, RectifiedImage& out,
                      Simd simd) const {
  const int cells = (region_.width + kStep - 1) / kStep, width = region_.width;
  out.pixels.create(region_.size());
  out.covered.resize(static_cast<std::size_t>(region_.height));
  const RawView view{raw.data, static_cast<int>(raw.step),
                     static_cast<float>(raw_size_px_.width - 3),
                     static_cast<float>(raw_size_px_.height - 1)};
  const auto rows = [&](int task) {
    std::vector<float> u(static_cast<std::size_t>(cells) + 1), v(u.size());
    std::vector<uchar> pixels(static_cast<std::size_t>(cells) * kStep), is_covered(pixels.size());
    const int end = std::min((task + 1) * kRowsPerTask, region_.height);
    for (int y = task * kRowsPerTask; y < end; ++y) {
      const int node = y / kStep;
      const float share = static_cast<float>(y % kStep) / kStep;
      for (std::size_t i = 0; i < u.size(); ++i) {
        const int column = static_cast<int>(i);
        u[i] = u_(node, column) + (u_(node + 1, column) - u_(node, column)) * share;
        v[i] = v_(node, column) + (v_(node + 1, column) - v_(node, column)) * share;
      }
      const RowPath path{u.data(), v.data(), cells};
      (simd == Simd::avx2 ? resample_avx2 : resample_scalar)(view, path, pixels.data(),
                                                             is_covered.data());
      std::copy_n(pixels.data(), width, out.pixels[y]);
      out.covered[static_cast<std::size_t>(y)] = covered_columns(is_covered.data(), width);
    }
  };
  pool.run((region_.height + kRowsPerTask - 1) / kRowsPerTask, rows);
}

cv::Mat1b rectified_left(const cv::Mat& raw_left, const ZoomCalibration& zoom,
                         const Rectification& geometry) {
  const Rectifier rectifier(zoom.camera_matrix_left, zoom.distortion_left, geometry.R1, geometry.P1,
                            raw_left.size(), cv::Rect({}, geometry.size_px));
  WorkerPool pool(1);
  RectifiedImage out;
  rectifier.apply(grey_of(raw_left), pool, out);
  return out.pixels;
}

}  // namespace holdfast::registration
