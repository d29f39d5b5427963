// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/tre/rendered_registration.hpp"

#include <fmt/format.h>

#include "registration/stereo_calibration.hpp"
#include "rt/core/error.hpp"
#include "rt/study/setup_flow.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast::registration::test {

RenderedMeasurement render_measurement(const RenderedRig& rig,
                                       const std::filesystem::path& folder) {
  if (!std::filesystem::exists(folder / "registration.json")) {
    rt::SetupSettings settings;
    settings.zoom = rig.zoom;
    settings.calibration_pairs = rig.pairs;
    settings.rig = rt::virtual_rig({"--seed", fmt::format("{}", rig.seed), "--phantom-seed",
                                    fmt::format("{}", rig.phantom_seed)});
    const rt::SetupOutcome outcome = rt::run_setup(settings, folder, [](const std::string&) {});
    if (!outcome.refusal.empty()) throw RefusedError(outcome.refusal);
  }
  RenderedMeasurement measured;
  measured.input.fixed = read_markups_file((folder / "fiducials.mrk.json").string());
  measured.input.moving = read_markups_file((folder / "markers.mrk.json").string());
  measured.input.fixed_surface = read_mesh((folder / "ct.ply").string());
  measured.input.moving_surface = read_mesh((folder / "mire.ply").string());

  sim::RoomConfig room;
  room.seed = room.optics.seed = rig.seed;
  const sim::Phantom phantom =
      sim::make_ear_phantom(rig.phantom_seed, sim::PhantomParts::scan_only);
  const sim::Microscope microscope(room.optics);
  measured.focus_mm = microscope.focus_mm();
  measured.T_ct_head = sim::head_poses(room, phantom, microscope.focus_mm()).front();
  const StereoCalibration calibration = read_stereo_calibration((folder / "stereo.yaml").string());
  measured.T_camera_ct = sim::frame_of(calibration.zooms.front(), microscope.at(rig.zoom)) *
                         measured.T_ct_head.inverse();
  return measured;
}

}  // namespace holdfast::registration::test
