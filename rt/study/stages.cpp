// SPDX-License-Identifier: Apache-2.0
#include "rt/study/stages.hpp"

#include <fmt/format.h>

#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "registration/calibration_images.hpp"
#include "registration/ct/bead_search.hpp"
#include "registration/ct/dicom_series.hpp"
#include "registration/ct/isosurface.hpp"
#include "registration/marker_detection.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

void check_interrupt() {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
}

}  // namespace

registration::CalibrationOutcome calibrate_images(
    const std::filesystem::path& images, const SetupParameters& parameters,
    const std::function<void(const std::string&)>& tell) {
  const registration::BoardSearch search = registration::find_boards(
      registration::list_calibration_images(images.string()), parameters.board, parameters.threads,
      [](const std::string& path) {
        check_interrupt();
        return bridge::read_image_file(path);
      },
      [&](int done, int all) { tell(fmt::format("board in pair {} of {}", done, all)); });
  registration::CalibrationOptions options;
  options.board = parameters.board;
  return registration::calibrate_stereo(search.views, search.image.width, search.image.height,
                                        options, [&](const std::string& what) {
                                          check_interrupt();
                                          tell(what);
                                        });
}

CtSide read_ct_side(const std::filesystem::path& dicom, const SetupParameters& parameters) {
  registration::SeriesOptions series;
  series.threads = parameters.threads;
  series.progress = [](std::size_t, std::size_t) { check_interrupt(); };
  const registration::CtVolume volume = registration::read_ct_series(dicom.string(), series);
  registration::IsosurfaceOptions iso;
  iso.iso_hu = parameters.iso_hu;
  iso.is_largest_only = true;
  CtSide side;
  side.surface = registration::isosurface(volume, iso);
  side.surface.comments = {"SPACE=LPS", "ct_series " + volume.identity.series_uid,
                           "ct_frame_of_reference " + volume.identity.frame_of_reference_uid};
  side.beads.points =
      registration::bead_points(registration::find_beads(volume, parameters.bead_diameter_mm), {});
  side.beads.properties = {
      {registration::kCtSeriesUid, volume.identity.series_uid},
      {registration::kCtStudyUid, volume.identity.study_uid},
      {registration::kCtFrameOfReferenceUid, volume.identity.frame_of_reference_uid}};
  return side;
}

registration::MarkerSet locate_beads(const registration::StereoShot& frames,
                                     const registration::ZoomCalibration& calibration,
                                     const SetupParameters& parameters) {
  const int dictionary = registration::marker_dictionary("4x4_50");
  registration::MarkerOptions options;
  options.offset_mm = parameters.bead_below_marker_mm;
  options.marker_mm = parameters.marker_mm;
  return registration::locate_markers(
      registration::detect_markers(frames.left, dictionary, calibration.camera_matrix_left,
                                   calibration.distortion_left),
      registration::detect_markers(frames.right, dictionary, calibration.camera_matrix_right,
                                   calibration.distortion_right),
      calibration, options);
}

}  // namespace holdfast::rt
