// SPDX-License-Identifier: Apache-2.0
// A folder of calibration images (zoom_1.1/left_00.png, right_00.png, …) to the board's corners.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "registration/calibration_views.hpp"

namespace holdfast::registration {

struct ImagePair {
  std::string left, right;  ///< paths
};

struct ZoomImages {
  double zoom = 0;
  std::vector<ImagePair> pairs;
};

/// The pairs below `folder`, ascending in zoom and name. Throws InputError when there is no folder
/// zoom_<number> or one twice; RefusedError naming an image without its partner.
[[nodiscard]] std::vector<ZoomImages> list_calibration_images(const std::string& folder);

struct SkippedPair {
  std::string name, reason;
};

struct BoardSearch {
  std::vector<ZoomViews> views;  ///< zooms as given; pairs that show the whole board
  std::vector<SkippedPair> skipped;
  cv::Size image{0, 0};
};

/// Finds the board in all images, `threads` at a time. `read` gives the 8-bit grey image of a path;
/// it is called by one thread at a time, as is `progress` (pairs done, of all). Their exceptions
/// end the search and come out. Throws RefusedError: images of different sizes (named), or no pair
/// that shows the board (saying what is seen instead).
[[nodiscard]] BoardSearch find_boards(const std::vector<ZoomImages>& images,
                                      const BoardPattern& board, int threads,
                                      const std::function<cv::Mat(const std::string&)>& read,
                                      const std::function<void(int, int)>& progress);

}  // namespace holdfast::registration
