// SPDX-License-Identifier: Apache-2.0
// What the tracker says while something goes wrong: shocks, breathing, tilts, blood, smoke,
// flicker, defocus, something held before everything. One sequence of a rig each, followed by the
// direct tracker with the depth that a reconstruction delivers. What counts: no frame is called
// tracked while it is wrong.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "rt/study/stages.hpp"
#include "rt/study/study.hpp"
#include "rt/study/tracking_study.hpp"

namespace holdfast::rt {

struct Disturbance {
  std::string name;
  std::string motion;                   ///< of the site, as the rig names it
  std::string picture;                  ///< what happens to the picture (SequenceRequest)
  std::optional<double> clear_again_s;  ///< from then on the site is to be found again
  /// In this time the encoder reads another zoom than the keyframe's: the daemon voids every
  /// estimate then, whatever the tracker says.
  std::optional<double> other_zoom_from_s, other_zoom_to_s;
};

/// Those of the study, some 1,100 frames at 30/s.
[[nodiscard]] std::vector<Disturbance> all_disturbances();

struct DisturbanceSettings {
  std::vector<TrackingScene> scenes;
  std::vector<Disturbance> disturbances;
  double rate_hz = 30;
  double zoom = 1.3;
  int calibration_pairs = 19;
  SetupParameters setup;
};

/// One frame with a pose. Errors at the site point on the optical axis at the keyframe.
struct DisturbedFrame {
  double t_s = 0;
  std::string status;
  double error_um = 0;        ///< in all three directions
  double plane_error_um = 0;  ///< in the image plane
  double nees = 0;            ///< normalised error squared, six freedoms
};

/// One scene and disturbance. Figures of nothing are NaN.
struct DisturbanceRow {
  std::string scene, name;
  std::string refusal;  ///< why nothing below counts
  int frames = 0;       ///< but the keyframe's
  int voided = 0;  ///< of them taken with another zoom than the keyframe's: not in what follows
  std::map<std::string, int> statuses;
  std::map<std::string, int> reasons;     ///< of what is not tracked
  double rms_um = 0, max_um = 0;          ///< of those called tracking or relocalised
  double plane_rms_um = 0;                ///< likewise, in the image plane
  int silently_wrong = 0;                 ///< of them more than 200 um off, in any direction
  double nees_mean = 0;                   ///< of them; 6 is exact
  double nees_share_in_95 = 0;            ///< of them below the chi-squared bound of 95 %
  std::optional<int> frames_until_found;  ///< from the first clear frame, 0: in it
  double found_in_ms = 0;                 ///< wall time of the tracker for the frame that found it
  std::vector<DisturbedFrame> poses;
};

inline constexpr double kSilentlyWrongUm = 200;
inline constexpr double kChiSquared6Bound95 = 12.592;

struct DisturbanceResult {
  std::vector<DisturbanceRow> rows;
  int resumed = 0;  ///< rows that stood there already
};

/// Works in `folder`; what stands there of the same settings is not made again (frames are removed
/// once they are judged). Throws as the stages and the rig; InputError for a folder of another
/// study.
[[nodiscard]] DisturbanceResult run_disturbance_study(const DisturbanceSettings& settings,
                                                      const std::filesystem::path& folder,
                                                      const StudyProgress& progress);

/// The figures of a row from its poses, voided ones left out.
void summarise(DisturbanceRow& row);

/// A row as JSON text and back; one that is none: nothing.
[[nodiscard]] std::string row_text(const DisturbanceRow& row);
[[nodiscard]] std::optional<DisturbanceRow> row_of(const std::string& text);

[[nodiscard]] std::string disturbance_csv(const DisturbanceResult& result);
/// Self-contained. Pure.
[[nodiscard]] std::string disturbance_html(const DisturbanceSettings& settings,
                                           const DisturbanceResult& result);

}  // namespace holdfast::rt
