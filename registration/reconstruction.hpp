// SPDX-License-Identifier: Apache-2.0
// A raw stereo pair (or a burst of them) to the metric surface under the microscope: paper A's
// MiRe. Everything is in the rectified left frame (p = R1 · p_camera; x right, y down, z forward,
// mm). Bad input is refused with a status and its evidence; what cannot be known is NaN.
//
// Period slip: a pattern that repeats along the rows (paper A's lattice) fits a period too near or
// too far as well as where it is. An image that shows a lattice is refused before anything is
// matched (pattern_lattice.hpp). What repeats otherwise pattern_repetition.hpp looks for all over
// the scene: where it is common the whole pair is refused, where it is rare those parts are
// unknown.
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include <opencv2/core.hpp>

#include "registration/mesh_file.hpp"
#include "registration/rectification.hpp"
#include "registration/stereo_calibration.hpp"
#include "registration/stereo_matching.hpp"

namespace holdfast::registration {

enum class ReconstructionStatus {
  done,
  wrong_size,     ///< an image has not the calibration's size, or not the format
  too_dark,       ///< nothing exposed
  saturated,      ///< overexposed
  no_pattern,     ///< too little texture: the pattern is not projected, or out of focus
  views_swapped,  ///< left and right
  wrong_optics,   ///< the views do not lie on one another's rows: another zoom, another rig
  lattice,        ///< the pattern is a lattice, which may slip by a period without a trace
  period_slip,    ///< the scene fits nearly as well elsewhere on its rows: the pattern repeats
  no_surface      ///< too few consistent matches
};
[[nodiscard]] std::string_view name(ReconstructionStatus status) noexcept;

/// What one exposure gave. 8- or 16-bit, grey or BGR; 16 bits are taken as full scale.
struct StereoShot {
  cv::Mat left, right;
};

struct ReconstructionOptions {
  std::optional<cv::Rect> roi_px;  ///< of the raw left image (of the rectified one if is_rectified)
  double depth_centre_mm = 0;      ///< 0: the calibration's working distance
  double depth_reach_mm = 30;      ///< searched on both sides of it
  bool is_rectified = false;       ///< images are on the rectified grids already
  MatchMethod method = MatchMethod::sgm;
  std::optional<MatchParameters> match;  ///< empty: match_parameters_for(image size)
  int threads = 2;                       ///< 1 … 64; the result does not depend on it
  double density_min = 0.2;              ///< of the region; less is no_surface
  double vertical_limit_px = 0.35;       ///< rms over the image, of left against right rows
  double ambiguous_share_max = 0.05;     ///< of the scene; more is period_slip
  /// Reconstruct under a lattice all the same, for a comparison: no surface for a registration.
  /// The mesh says so (kForComparison), and register_ct() refuses it.
  bool may_be_lattice = false;
  bool is_explained = false;  ///< fill Reconstruction::reasons (sgm only)
};

struct ReconstructionTimes {
  std::chrono::nanoseconds rectify{0}, match{0}, refine{0}, reproject{0}, total{0};
};

struct Reconstruction {
  ReconstructionStatus status = ReconstructionStatus::no_surface;
  std::string evidence;  ///< one clause: measured value, limit, unit; empty when done
  cv::Rect region_px;    ///< of the rectified left grid; the maps below have its size when done,
                         ///< and are empty when not: a refusal hands out no surface
  cv::Mat1f disparity_px, depth_mm, depth_variance_mm2;  ///< NaN where unknown
  cv::Mat1f confidence;                                  ///< 0 … 1; 0 where unknown
  cv::Mat3f points_mm;                                   ///< rectified left; NaN where unknown
  cv::Mat1b reasons;  ///< PixelReason, if asked for; as large as the maps above
  double nearest_mm = 0, farthest_mm = 0;  ///< depths that were searched
  std::size_t points = 0;
  double density = 0;                ///< share of the region that is known
  double vertical_disparity_px = 0;  ///< rms over the image; what the calibration leaves
  double ambiguous_share = 0;   ///< of the scene: fits elsewhere on its rows too; unknown there
  double image_repetition = 0;  ///< ImageRepetition::share of the left image; the burst's largest
  bool is_for_comparison = false;  ///< may_be_lattice was needed
  ReconstructionTimes times;
};

/// First words of the comment in the file of a surface that may have slipped by a period.
inline constexpr const char* kForComparison = "for_comparison_only";

class Reconstructor {
 public:
  /// For one zoom. Prepares the maps. Throws InputError on a calibration or options that cannot
  /// serve (rig not side by side, region outside the image, range too large).
  Reconstructor(const ZoomCalibration& zoom, cv::Size image_px,
                const ReconstructionOptions& options);
  ~Reconstructor();
  Reconstructor(const Reconstructor&) = delete;
  Reconstructor& operator=(const Reconstructor&) = delete;

  /// One shot or a burst of one unmoved scene (1 … 31). One thread at a time. The maps are fresh
  /// memory, some 140 MB for a whole microscope image: a program that reconstructs again and again
  /// keeps what it frees (mallopt(M_TRIM_THRESHOLD)), which saves a quarter of the CPU time.
  [[nodiscard]] Reconstruction reconstruct(std::span<const StereoShot> shots);
  [[nodiscard]] const Rectification& rectification() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// On the whole rectified left grid: NaN (0 for CV_32F confidence) outside the region.
[[nodiscard]] cv::Mat1f on_whole_grid(const cv::Mat1f& map, const cv::Rect& region_px,
                                      cv::Size image_px, float outside);

/// Every `step`-th pixel's point, two triangles a grid cell; none across a depth edge (steeper than
/// 80 degrees to the image plane). Carries R1, the view (ReconstructedView), how far the image
/// repeats itself, and kForComparison.
[[nodiscard]] TriangleMesh mesh_of(const Reconstruction& reconstruction,
                                   const Rectification& geometry, int step = 1);

}  // namespace holdfast::registration
