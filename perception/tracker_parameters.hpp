// SPDX-License-Identifier: Apache-2.0
// Every setting of the tracker, with its default and its reason. Pixels are those of the full-size
// image unless a name says otherwise.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace holdfast::perception {

struct ReflectionMaskParameters {
  bool is_enabled = true;
  double tau_intensity = 0.8;        ///< tau_1 of paper B, Eq. 2; of the image's maximum
  double tau_saturation = 0.2;       ///< tau_2 of paper B, Eq. 2; of full saturation
  double tau_intensity_grey = 0.94;  ///< grey frames: brightness alone decides, so nearer the top
  int intensity_min = 180;  ///< darker than this is never a glint: a dim frame keeps its texture
  int dilation_px = 4;      ///< grown by this: a glint's rim is as fixed to the light as its core
};

struct FeatureParameters {
  int count = 900;            ///< features kept per frame, spread over a grid
  bool is_full_size = false;  ///< detect on the full image (slower) instead of at half size;
                              ///< images below 0.6 megapixels always are
  int fast_threshold = 7;     ///< grey levels, the lowest; rises where corners abound
  int levels = 3;             ///< pyramid levels
  double level_scale = 1.3;   ///< between two levels
  int cell_px = 128;          ///< side of a cell of the grid that spreads them
};

struct MatchParameters {
  int distance_max = 64;         ///< of 256 bits
  double ratio_max = 0.85;       ///< best distance below this share of the second best
  double search_radius_px = 64;  ///< around the predicted place, when there is a prediction
};

struct ModelParameters {
  std::uint32_t seed = 1;          ///< of the random samples: same input, same result
  int iterations = 300;            ///< samples at most; fewer when the inlier share allows
  double coarse_threshold_px = 4;  ///< feature positions are good to about one half-size pixel
  double parallax_px = 40;  ///< SiteDepth: what relief may add to the first, planar consensus
  double fine_threshold_px = 1.0;  ///< an inlier, after sub-pixel alignment
  double zncc_min = 0.8;           ///< of an aligned patch with its template
  int points_max = 300;            ///< patches aligned per frame
};

struct UncertaintyParameters {
  double noise_floor_px = 0.02;  ///< no feature is trusted beyond this
  double shared_error_px =
      0.02;  ///< common to all features of one image cell (interpolation, light)
  double tilt_sigma_rad = 0.005;  ///< SitePlane: rx, ry are not estimated; this is their sigma
  double relief_sigma_mm = 1.0;   ///< SitePlane: how far the site departs from the plane
  double depth_sigma_mm = 0.1;    ///< SiteDepth: of the depth map, smooth part
};

struct HealthParameters {
  int features_min = 60;            ///< below: lost
  int inliers_min = 20;             ///< below: lost
  int inliers_good = 40;            ///< below: degraded
  double inlier_share_min = 0.25;   ///< of the matches; below: lost
  double inlier_share_good = 0.45;  ///< below: degraded
  double spread_min = 0.06;         ///< of the 8x8 cells; below: lost
  double spread_good = 0.15;        ///< below: degraded
  double rival_share_min = 0.25;    ///< a second motion with this share of the inliers: degraded
  double rival_share_lost = 0.5;    ///< and with this share: lost
  double rms_good_px = 0.6;         ///< of the inliers after alignment; above: degraded
  double scale_change_max = 0.3;    ///< |scale - 1| beyond this is not the site's motion
  double rotation_max_rad = 0.7;    ///< any axis
  double drift_good_um = 100;       ///< above: degraded, and the keyframe is searched anew
  int chain_length_max = 300;       ///< frames after which a chain that agrees is anchored again
  double change_share_max = 0.6;  ///< of the blocks of an image that is said not to have moved ...
  double change_spread_max =
      0.7;  ///< ... and of its cells: from both on, something fixed is followed
};

/// DirectTracker: patches of the keyframe, aligned directly.
struct DirectParameters {
  int patches = 480;  ///< wanted at full size; a quarter of that on each smaller level
  double texture_min =
      300;                ///< of a patch: smaller eigenvalue of the sum of its gradient products,
                          ///< grey levels^2/px^2; three times what a noise of 2 levels looks like
  double zncc_min = 0.5;  ///< a patch less like its template has no say
  double recall_zncc = 0.5;  ///< below this mean at the predicted pose the motion is looked for
  double shared_error_px = 0.01;   ///< of each patch, beyond noise: interpolation, shading
  double common_error_px = 0.005;  ///< likewise, common to all patches
  int inliers_min = 30;            ///< below: lost
  int inliers_good = 60;           ///< below: degraded
  double share_min = 0.25;         ///< inliers of the visible patches; below: lost
  double share_good = 0.5;         ///< below: degraded
  double sharpness_ratio_good =
      1.15;  ///< of the image's fine detail to the keyframe's, coarse detail being equal, or the
             ///< inverse; above: degraded. Smoke and light stay below 1.09; a blur that costs a
             ///< tenth of a millimetre in depth is at 1.3
  int witnesses = 160;              ///< patches that are only asked whether they agree
  double witness_share_good = 0.5;  ///< of them that agree; below: degraded
  int chain_patches = 80;           ///< followed from frame to frame
};

/// DirectTracker: the features' independent view of the same motion.
struct CheckParameters {
  bool is_threaded = false;  ///< on a second thread, when it is idle, and judged one frame later;
                             ///< otherwise at once: same frames, same result
  int every_frames = 3;      ///< 10 Hz at 30 frames/s; 0: never
  double limit_um = 100;     ///< a difference beyond this is a disagreement ...
  double limit_sigma = 5;    ///< ... and one beyond this and a fifth of limit_um
  int failures_max = 30;     ///< checks in a row that find no motion; beyond: degraded
};

/// DirectTracker: keyframes taken later, tied to the first. Strain: how far a pose is from its
/// keyframe; 1 at the smallest overlap, or at HealthParameters' largest scale change or rotation.
struct TieParameters {
  int keyframes_max = 4;       ///< tied ones kept; 0: none is made
  double overlap_min = 0.2;    ///< share of a keyframe's patches in view, at a strain of 1
  double strain_new = 0.5;     ///< above: another keyframe is made; below: the first is used again
  double strain_leave = 0.75;  ///< above: a tied keyframe that sees more takes over
  double share_good = 0.7;     ///< inliers of the visible patches: below, none is made or proved,
                               ///< and by a tied one it is degraded
  int proofs = 2;              ///< other frames that must agree before one is used
  int watch_every = 1;         ///< frames; so often the first is looked for from a tied one
  double limit_um = 5, limit_sigma = 6;  ///< a difference beyond both is a wrong tie
  double sigma_max_um = 25;              ///< in the image plane: beyond, degraded, and none is made
  double rotation_sigma_max_rad = 1e-3;  ///< likewise, about any axis
};

struct TrackerParameters {
  ReflectionMaskParameters mask;
  FeatureParameters features;
  MatchParameters match;
  ModelParameters model;
  UncertaintyParameters uncertainty;
  HealthParameters health;
  DirectParameters direct;
  CheckParameters check;
  TieParameters ties;
};

/// The first parameter out of its range, in one line with value, limit and unit; empty when all are
/// usable. NaN is out of every range.
[[nodiscard]] std::optional<std::string> invalid_parameter(const TrackerParameters& parameters);

}  // namespace holdfast::perception
