// SPDX-License-Identifier: Apache-2.0
// The virtual operating room as a rig that another program uses without linking it: requests and
// answers of one JSON object each (see answer()). What the room costs to build is kept between
// them.
#pragma once

#include <memory>

#include <nlohmann/json_fwd.hpp>

#include "tests/sim/or/room_files.hpp"

namespace holdfast::sim {

class RoomServer {
 public:
  /// `request` has a member `do` and `config` (a room's file, see config/or.toml), and
  ///  - "calibration": `out`: as write_calibration_images;
  ///  - "ct": `out`: a folder for the DICOM files of the phantom's CT;
  ///  - "stereo": `out`, `pose`: as write_stereo_images, of one pose; `off_or_light`, if given, for
  ///    the frames without the pattern;
  ///  - "depth-error": `calibration` (stereo.yaml), `depth` (TIFF, rectified left), `pose`: the
  ///    answer is a DepthError, `*_mm` null where nothing is known. Nothing else answers truth.
  /// Other answers: {"files": count}. Throws holdfast::Error; InputError for such a request.
  [[nodiscard]] nlohmann::json answer(const nlohmann::json& request, const Progress& progress);

 private:
  RoomScene& scene_of(const RoomConfig& config);
  std::unique_ptr<RoomScene> scene_;
  std::string scene_name_;
};

}  // namespace holdfast::sim
