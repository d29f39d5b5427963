// SPDX-License-Identifier: Apache-2.0
// The virtual operating room as a rig that another program uses without linking it: requests and
// answers of one JSON object each (docs/interfaces.md, "Rig"). What the room costs to build is kept
// between them.
#pragma once

#include <memory>

#include <nlohmann/json_fwd.hpp>

#include "tests/sim/or/room_files.hpp"

namespace holdfast::sim {

class RoomServer {
 public:
  /// `config`: everything that a request does not say.
  explicit RoomServer(RoomConfig config);

  /// `request` has a member `do`:
  ///  - "boards": `zoom`, `pairs`, `out`: as write_calibration_images;
  ///  - "ct": `out`: a folder for the DICOM files of the phantom's CT;
  ///  - "pair": `zoom`, `out`, and if not the configuration's: `pose` (0), `lamps` ("filtered":
  ///    what the pattern's filter lets through; "or"; "microscope"), `pattern` (a file, or
  ///    "random"; none), `off` (false: also a pair without the pattern): as write_stereo_images;
  ///  - "depth-error": `zoom`, `pose`, `calibration` (stereo.yaml), `depth` (TIFF, rectified
  ///    left): the answer is a DepthError, `*_mm` null where nothing is known. Of the truth nothing
  ///    else is answered, but by "tracking-error" and "beam-error";
  ///  - "sequence": `zoom`, `motion`, `rate_hz`, `out`, `lamps`, and if wanted `frames_max`: as
  ///    write_sequence: {"frames", "region_px": [x, y, width, height]};
  ///  - "tracking-error": the same `zoom`, `motion` and `rate_hz`, `calibration` (stereo.yaml),
  ///    `poses` (poses.csv of `holdfast track`), `rows` (a CSV to be written: the error of each
  ///    frame): the answer is a TrackingError;
  ///  - "robot": {"lag_ms"}: how late its beam follows;
  ///  - "beam-error": as "tracking-error", but `commands` (what the robot was told, CSV) for
  ///    `poses`: the answer is a BeamError.
  /// Other answers: {"files": count}. Throws holdfast::Error; InputError for such a request.
  [[nodiscard]] nlohmann::json answer(const nlohmann::json& request, const Progress& progress);

 private:
  RoomScene& scene();
  RoomConfig config_;
  std::unique_ptr<RoomScene> scene_;
};

}  // namespace holdfast::sim
