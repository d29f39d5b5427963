// SPDX-License-Identifier: Apache-2.0
// The rig that projects a pattern and takes a pair, as an executable that somebody else provides: a
// real microscope or the virtual one. It is started as
//   COMMAND --zoom Z --pattern FILE.png --out FOLDER
// and has done its work when it ends with 0: FOLDER/left.png and FOLDER/right.png are then the raw
// pair at that zoom under that pattern (800x600, 8 bit), in the pose that the registration is for.
#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "registration/reconstruction.hpp"

namespace holdfast::rt {

class PatternRig {
 public:
  /// `command` is split at spaces; the first part is looked up in PATH. Makes a folder of its own
  /// for the images, and removes it at the end.
  explicit PatternRig(const std::string& command);
  ~PatternRig();
  PatternRig(const PatternRig&) = delete;
  PatternRig& operator=(const PatternRig&) = delete;

  /// Throws UnavailableError when the command cannot be started or fails (its exit code is named),
  /// InputError on a missing or unreadable image, InterruptedError when asked to end meanwhile.
  [[nodiscard]] registration::StereoShot take(double zoom, const cv::Mat& pattern);

 private:
  std::vector<std::string> command_;
  std::string folder_;
};

}  // namespace holdfast::rt
