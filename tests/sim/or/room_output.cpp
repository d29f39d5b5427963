// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room_output.hpp"

#include <string>
#include <system_error>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::sim {

using nlohmann::json;
namespace fs = std::filesystem;

namespace {

json as_json(const cv::Matx33d& m) {
  json rows = json::array();
  for (int i = 0; i < 3; ++i) rows.push_back({m(i, 0), m(i, 1), m(i, 2)});
  return rows;
}

}  // namespace

void make_folder(const fs::path& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error)
    throw InputError(fmt::format("{}: cannot be made: {}", path.string(), error.message()));
}

void write_image(const fs::path& path, const cv::Mat& image) {
  std::vector<std::uint8_t> bytes;
  if (!cv::imencode(path.extension().string(), image, bytes,
                    {cv::IMWRITE_PNG_COMPRESSION, 1, cv::IMWRITE_JPEG_QUALITY, 80}))
    throw InputError(fmt::format("{}: cannot be encoded", path.string()));
  bridge::write_file_atomically(path.string(),
                                {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

json as_json(const Eigen::Isometry3d& T) {
  json rows = json::array();
  for (int i = 0; i < 4; ++i)
    rows.push_back({T.matrix()(i, 0), T.matrix()(i, 1), T.matrix()(i, 2), T.matrix()(i, 3)});
  return rows;
}

json as_json(const Eigen::Vector3d& p) {
  return {p.x(), p.y(), p.z()};
}

json as_json(const registration::ZoomCalibration& z) {
  return {{"zoom", z.zoom},
          {"focus_mm", z.focus_mm},
          {"camera_matrix_left", as_json(z.camera_matrix_left)},
          {"camera_matrix_right", as_json(z.camera_matrix_right)},
          {"distortion_left",
           std::vector<double>(z.distortion_left.begin<double>(), z.distortion_left.end<double>())},
          {"distortion_right", std::vector<double>(z.distortion_right.begin<double>(),
                                                   z.distortion_right.end<double>())},
          {"R", as_json(z.R)},
          {"T", {z.T[0], z.T[1], z.T[2]}},
          {"rms_px", z.rms_px}};
}

json ct_truth(const Phantom& phantom, const DicomSeries& series) {
  json markers = json::array();
  for (const TrueMarker& m : phantom.markers)
    markers.push_back({{"id", m.aruco_id},
                       {"side_mm", m.side_mm},
                       {"T_ct_marker", as_json(m.T_ct_marker)},
                       {"bead_ct_mm", as_json(m.p_bead_ct_mm)}});
  const Eigen::Vector3d low = phantom.region_of_interest_mm.min();
  const Eigen::Vector3d high = phantom.region_of_interest_mm.max();
  return {{"phantom", phantom.name},
          {"series_uid", series.series_uid},
          {"study_uid", series.study_uid},
          {"frame_of_reference_uid", series.frame_of_reference_uid},
          {"markers", markers},
          {"roi_min_mm", as_json(low)},
          {"roi_max_mm", as_json(high)}};
}

json markers_json(const Phantom& phantom, const Eigen::Isometry3d& T_camera_ct) {
  json list = json::array();
  for (const TrueMarker& m : phantom.markers) {
    const Eigen::Vector3d p_ct = m.T_ct_marker.translation();
    list.push_back({{"label", std::to_string(m.aruco_id)},
                    {"side_mm", m.side_mm},
                    {"marker_ct", as_json(p_ct)},
                    {"marker_camera", as_json(Eigen::Vector3d(T_camera_ct * p_ct))},
                    {"bead_ct", as_json(m.p_bead_ct_mm)},
                    {"bead_camera", as_json(Eigen::Vector3d(T_camera_ct * m.p_bead_ct_mm))}});
  }
  return list;
}

}  // namespace holdfast::sim
