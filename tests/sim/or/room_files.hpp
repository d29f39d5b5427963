// SPDX-License-Identifier: Apache-2.0
// The virtual room's images as files, for work offline; the truth goes into a file of its own, to
// a place that the pipeline is never told.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "tests/sim/or/room.hpp"

namespace holdfast::sim {

/// Called with what is done and the whole; a long job ends by an exception from it.
using Progress = std::function<void(int done, int all)>;

/// What was written, and the truth about it (JSON text).
struct RoomFiles {
  int files = 0;
  std::string truth;
  int frames = 0;      ///< of a sequence
  cv::Rect region_px;  ///< of the left camera's image that it shows
};

/// out/zoom_1.1/left_00.png, right_00.png ...; held-out sets in out/held_out_1/zoom_1.1/...
[[nodiscard]] RoomFiles write_calibration_images(const RoomConfig& config,
                                                 const std::filesystem::path& out,
                                                 const Progress& progress);

/// out/pose_00/left.png, right.png: as the lights are; left_off.png, right_off.png: without the
/// pattern, for the markers (only where there is a pattern). One pose: directly in `out`.
[[nodiscard]] RoomFiles write_stereo_images(const RoomConfig& config,
                                            const std::filesystem::path& out,
                                            const Progress& progress);

/// A phantom before the renderer: made once for all that is rendered of it.
struct RoomScene {
  explicit RoomScene(const RoomConfig& config);
  Phantom phantom;
  Renderer renderer;
};

struct StereoWish {
  std::optional<int> only_pose;        ///< its images stand directly in `out`
  std::optional<double> off_or_light;  ///< or_light of the frames without the pattern
  bool has_off = true;                 ///< whether these are wanted
};
/// The same of a scene that is there already.
[[nodiscard]] RoomFiles write_stereo_images(const RoomConfig& config, RoomScene& scene,
                                            const std::filesystem::path& out,
                                            const StereoWish& wish, const Progress& progress);

/// out/frame_00000.png ... of 1920x1080 px and timestamps.csv, along the configuration's motion.
/// Does nothing but say the truth again when `out` already holds this configuration's sequence.
[[nodiscard]] RoomFiles write_sequence(const RoomConfig& config, const std::filesystem::path& out,
                                       const Progress& progress);
/// The same of a scene that is there already.
[[nodiscard]] RoomFiles write_sequence(const RoomConfig& config, RoomScene& scene,
                                       const std::filesystem::path& out, const Progress& progress);

}  // namespace holdfast::sim
