// SPDX-License-Identifier: Apache-2.0
#include "rt/study/tracking_stages.hpp"

#include <fstream>
#include <limits>

#include <fmt/format.h>

#include "bridge/atomic_file.hpp"
#include "registration/pattern.hpp"
#include "registration/reconstruction.hpp"
#include "rt/core/error.hpp"
#include "rt/study/illumination.hpp"
#include "rt/study/setup_flow.hpp"
#include "rt/study/study_files.hpp"
#include "rt/study/trajectory_file.hpp"

namespace holdfast::rt {

namespace fs = std::filesystem;

perception::CameraModel camera_of(const registration::ZoomCalibration& zoom,
                                  const cv::Rect& region_px) {
  perception::CameraModel camera;
  camera.width_px = region_px.width;
  camera.height_px = region_px.height;
  const cv::Matx33d& K = zoom.camera_matrix_left;
  camera.fx_px = K(0, 0);
  camera.fy_px = K(1, 1);
  camera.cx_px = K(0, 2) - region_px.x;
  camera.cy_px = K(1, 2) - region_px.y;
  camera.distortion = zoom.distortion_left.clone();
  return camera;
}

registration::ZoomCalibration calibrate_rig(Rig& rig, double zoom, int pairs,
                                            const SetupParameters& setup, const fs::path& folder,
                                            const Tell& tell) {
  const fs::path images = folder / "boards", out = folder / "stereo.yaml",
                 made_of = folder / "calibrated.txt";
  const std::string stamp = fmt::format("{}, zoom {:g}, {} pairs\n", rig.command(), zoom, pairs);
  std::string former;
  std::getline(std::ifstream(made_of), former);
  if (former + "\n" == stamp && fs::exists(out))
    return registration::calibration_at_zoom(registration::read_stereo_calibration(out.string()),
                                             zoom);
  fs::remove(made_of);
  fs::remove_all(images);
  tell(fmt::format("calibration images at zoom {:g}", zoom));
  rig.boards(zoom, pairs, images);
  const auto outcome = calibrate_images(images, setup, tell);
  bridge::write_file_atomically(out.string(),
                                registration::stereo_calibration_text(outcome.calibration));
  bridge::write_file_atomically(made_of.string(), stamp);
  fs::remove_all(images);
  return registration::calibration_at_zoom(outcome.calibration, zoom);
}

cv::Mat1f reconstruct_rig(Rig& rig, const registration::ZoomCalibration& zoom,
                          const SetupParameters& setup, const fs::path& out) {
  const fs::path pattern = out / "pattern.png";
  write_png(pattern, registration::make_pattern({}));
  PairRequest request = lit_by(Illumination::adaptive, pattern);
  request.out = out / "pair";
  request.zoom = zoom.zoom;
  request.has_off = false;
  const RigPair pair = rig.pair(request);
  registration::ReconstructionOptions options;
  options.threads = setup.threads;
  registration::Reconstructor reconstructor(zoom, pair.shot.left.size(), options);
  const registration::Reconstruction surface = reconstructor.reconstruct({&pair.shot, 1});
  if (surface.status != registration::ReconstructionStatus::done)
    throw RefusedError(fmt::format("reconstruction: {}: {}", registration::name(surface.status),
                                   surface.evidence));
  const registration::Rectification& geometry = reconstructor.rectification();
  const cv::Mat1f whole =
      registration::on_whole_grid(surface.depth_mm, surface.region_px, geometry.size_px,
                                  std::numeric_limits<float>::quiet_NaN());
  return depth_for_camera(whole, geometry, zoom.camera_matrix_left);
}

std::string poses_csv(const std::vector<perception::MotionEstimate>& estimates) {
  std::string csv = trajectory_header();
  int frame = 0;
  for (const perception::MotionEstimate& estimate : estimates)
    csv += trajectory_row(frame++, estimate.t_exposure, estimate);
  return csv;
}

}  // namespace holdfast::rt
