// SPDX-License-Identifier: Apache-2.0
// `reconstruct --next-pattern`: what to project next where this reconstruction is poor.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "registration/pattern.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::rt {

struct NextPatternRequest {
  std::string pattern_file;              ///< under which `shot` was taken
  registration::PatternParameters next;  ///< dots where nothing is to be changed
  const registration::StereoShot& shot;  ///< raw
  const registration::ZoomCalibration& zoom;
  const registration::Reconstruction& surface;
  const registration::Rectification& geometry;
};
struct NextPattern {
  std::string png;
  nlohmann::ordered_json report;  ///< `projector` and `needs`
};
/// Throws RefusedError when the pattern is not found in the image, InputError naming its file.
[[nodiscard]] NextPattern next_pattern(const NextPatternRequest& request);

}  // namespace holdfast::rt
