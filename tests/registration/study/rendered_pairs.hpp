// SPDX-License-Identifier: Apache-2.0
// Pairs of the virtual microscope whose depth is known at every pixel. Rendering takes seconds a
// pair, so pairs are kept in a folder.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "registration/pattern.hpp"
#include "registration/reconstruction.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast::test {

struct RenderedScene {
  std::string name;
  sim::RoomConfig room;  ///< its last pose is rendered
  registration::PatternParameters pattern;
  bool has_pattern = true;
  int shots = 1;  ///< a burst: as many patterns, of seeds pattern.seed on
};

/// What is true of a pixel of the rectified left grid.
enum SeenBits : std::uint8_t {
  seen_by_both = 1,  ///< its surface is, and lies in the phantom's region of interest
  seen_lit = 2       ///< and the projector shines on it
};

struct RenderedPair {
  std::string name;
  std::vector<registration::StereoShot> shots;
  registration::StereoCalibration calibration;
  cv::Mat1f depth_mm;  ///< rectified left grid; NaN: nothing, or the right camera does not see it
  cv::Mat1b seen;      ///< SeenBits
};

/// Of shapes and optics of seeds below 1000: what parameters were chosen on.
[[nodiscard]] std::vector<RenderedScene> training_scenes();
/// Seeds from 1000 on: parameters were frozen before these were rendered.
[[nodiscard]] std::vector<RenderedScene> held_out_scenes();
/// The finest dots, overexposed, underexposed: what a second pattern could do something about.
[[nodiscard]] std::vector<RenderedScene> refinement_scenes();

/// The room of one scene, to be lit by patterns as they come.
class RenderedRoom {
 public:
  explicit RenderedRoom(const RenderedScene& scene);
  ~RenderedRoom();
  RenderedRoom(const RenderedRoom&) = delete;
  RenderedRoom& operator=(const RenderedRoom&) = delete;
  /// `shot`: whose noise it has; rendered_pair()'s own are 0 to shots - 1.
  [[nodiscard]] registration::StereoShot under(const cv::Mat& pattern, int shot);

 private:
  friend RenderedPair rendered_pair(const RenderedScene& scene, const std::filesystem::path& cache);
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// From `cache`, or rendered into it.
[[nodiscard]] RenderedPair rendered_pair(const RenderedScene& scene,
                                         const std::filesystem::path& cache);

}  // namespace holdfast::test
