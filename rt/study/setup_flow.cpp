// SPDX-License-Identifier: Apache-2.0
#include "rt/study/setup_flow.hpp"

#include <chrono>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/depth_file.hpp"
#include "registration/ct_registration.hpp"
#include "registration/pattern_table.hpp"
#include "registration/transform_file.hpp"
#include "rt/core/error.hpp"
#include "rt/study/fiducial_region.hpp"
#include "rt/study/illumination.hpp"
#include "rt/study/rig.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using registration::Reconstruction;

constexpr int kMeshStepPx = 2;

std::string camera_text(const cv::Size& size, const registration::ZoomCalibration& zoom) {
  cv::FileStorage file(".yaml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY);
  file << "image_width" << size.width << "image_height" << size.height << "camera_matrix"
       << cv::Mat(zoom.camera_matrix_left) << "distortion_coefficients" << zoom.distortion_left;
  return file.releaseAndGetString();
}

class Setup {
 public:
  Setup(const SetupSettings& settings, const fs::path& folder,
        const std::function<void(const std::string&)>& tell)
      : settings_(settings), folder_(fs::absolute(folder)), rig_(settings.rig), tell_(tell) {}

  SetupOutcome run() {
    prepare_folder();
    try {
      refuse_lattice();
      stage("calibration", [this] { return calibrate(); });
      stage("CT", [this] { return scan(); });
      stage("pattern", [this] { return project(); });
      stage("reconstruction", [this] { return reconstruct(); });
      stage("registration", [this] { return register_ct(); });
    } catch (const RefusedError& refusal) {
      outcome_.refusal = refusal.what();
    }
    return std::move(outcome_);
  }

 private:
  template <typename Work>
  void stage(const char* name, const Work& work) {
    tell_(name);
    const auto start = std::chrono::steady_clock::now();
    std::string measured = work();
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - start;
    outcome_.stages.push_back({name, std::move(measured), passed.count()});
  }

  /// Before anything is asked of the rig. What the rig really projected is asked of the images.
  void refuse_lattice() const {
    if (settings_.pattern.kind == registration::PatternKind::lattice)
      throw RefusedError(
          "pattern: a lattice is for comparisons: a surface under it may be a period off");
  }
  void prepare_folder() const {
    std::error_code error;
    fs::create_directories(folder_, error);
    if (error)
      throw InputError(fmt::format("{}: cannot be made: {}", folder_.string(), error.message()));
    fs::remove(folder_ / "registration.json", error);
    for (const char* name : {"boards", "dicom", "pair"}) fs::remove_all(folder_ / name, error);
  }
  void write(const char* name, const std::string& bytes) const {
    bridge::write_file_atomically((folder_ / name).string(), bytes);
  }
  void write_png(const char* name, const cv::Mat& image) const {
    std::vector<uchar> bytes;
    cv::imencode(".png", image, bytes);
    write(name, {bytes.begin(), bytes.end()});
  }
  std::string calibrate() {
    rig_.boards(settings_.zoom, settings_.calibration_pairs, folder_ / "boards");
    const auto outcome = calibrate_images(folder_ / "boards", settings_.parameters, tell_);
    write("stereo.yaml", registration::stereo_calibration_text(outcome.calibration));
    size_ = {outcome.calibration.image_width_px, outcome.calibration.image_height_px};
    zoom_ = registration::calibration_at_zoom(outcome.calibration, settings_.zoom);
    return fmt::format("{} pairs, {:.3f} px rms, non-rigid error predicted {:.3f} mm",
                       zoom_.pairs_used, zoom_.rms_px, outcome.zooms.front().predicted_nonrigid_mm);
  }

  std::string scan() {
    rig_.ct(folder_ / "dicom");
    ct_ = read_ct_side(folder_ / "dicom", settings_.parameters);
    write("ct.ply", registration::ply_bytes(ct_.surface));
    write("fiducials.mrk.json", registration::markups_text(ct_.beads));
    return fmt::format("{} beads, surface of {} triangles", ct_.beads.points.size(),
                       ct_.surface.triangles.size());
  }

  std::string project() {
    write_png("pattern.png", registration::make_pattern(settings_.pattern));
    PairRequest request = lit_by(Illumination::adaptive, folder_ / "pattern.png");
    request.out = folder_ / "pair";
    request.zoom = settings_.zoom;
    const RigPair pair = rig_.pair(request);
    shot_ = pair.shot;
    off_ = pair.off;
    // The keyframe in the light in which a surgeon works, and the tracker will: the pattern's
    // filter leaves a site too dark and flat to be followed.
    PairRequest at_work;
    at_work.out = folder_ / "at_work";
    at_work.zoom = settings_.zoom;
    at_work.lamps = "microscope";
    keyframe_ = rig_.pair(at_work).shot.left;
    return fmt::format("dots of {:g} px, {:g} px apart, {}", settings_.pattern.dot_px,
                       settings_.pattern.distance_px, registration::name(settings_.pattern.kind));
  }

  /// The markers come first: they show how the zoom is seated at this visit.
  std::string reconstruct() {
    const registration::MarkerSet markers = locate_beads(off_, zoom_, settings_.parameters);
    beads_ = registration::markups_of(markers);
    write("markers.mrk.json", registration::markups_text(beads_));
    zoom_ = markers.calibration;
    write("seated.yaml",
          registration::stereo_calibration_text({size_.width, size_.height, {zoom_}}));
    write("camera.yaml", camera_text(size_, zoom_));
    registration::ReconstructionOptions options;
    options.threads = settings_.parameters.threads;
    registration::Reconstructor reconstructor(zoom_, size_, options);
    const Reconstruction surface = reconstructor.reconstruct({&shot_, 1});
    if (surface.status != registration::ReconstructionStatus::done)
      throw RefusedError(fmt::format("reconstruction: {}: {}", registration::name(surface.status),
                                     surface.evidence));
    const registration::Rectification& geometry = reconstructor.rectification();
    mire_ = registration::mesh_of(surface, geometry, kMeshStepPx);
    write("mire.ply", registration::ply_bytes(mire_));
    const cv::Mat1f whole =
        registration::on_whole_grid(surface.depth_mm, surface.region_px, geometry.size_px,
                                    std::numeric_limits<float>::quiet_NaN());
    bridge::write_depth_file((folder_ / "depth.tiff").string(),
                             depth_for_camera(whole, geometry, zoom_.camera_matrix_left));
    write_png("keyframe.png", keyframe_);
    return fmt::format("{} points, {:.1f} % of the image, {:.0f} ms", surface.points,
                       100 * surface.density,
                       std::chrono::duration<double, std::milli>(surface.times.total).count());
  }

  /// On the CT's surface in the middle between the beads, and deeper along the line of sight.
  [[nodiscard]] std::vector<Eigen::Vector3d> targets(const Eigen::Isometry3d& T_camera_ct) const {
    const Eigen::Vector3d middle = FiducialRegion(ct_.beads).centre_mm();
    Eigen::Vector3d nearest = middle;
    double best = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3f& vertex : ct_.surface.vertices_mm) {
      const Eigen::Vector3d p = vertex.cast<double>();
      if (const double d = (p - middle).squaredNorm(); d < best) {
        best = d;
        nearest = p;
      }
    }
    const Eigen::Vector3d down = T_camera_ct.linear().transpose().col(2);
    return {nearest, nearest + settings_.deep_target_mm * down};
  }

  static registration::CtRegistration registered(const registration::RegistrationInput& input) {
    registration::CtRegistration result = registration::register_ct(input);
    if (result.status != registration::RegistrationStatus::registered)
      throw RefusedError("registration: " + result.reason);
    return result;
  }

  std::string register_ct() {
    registration::RegistrationInput input;
    input.fixed = ct_.beads;
    input.moving = beads_;
    input.targets_ct_mm = targets(registered(input).registration.T_camera_ct);
    input.fixed_surface = ct_.surface;
    input.moving_surface = mire_;
    // The surface is asked whether it contradicts the fiducials, no more: fused, it made rendered
    // ears worse (docs/virtual_or.md).
    input.is_refined = false;
    registration::CtRegistration result = registered(input);
    registration::Registration& registration = result.registration;
    registration.zoom = settings_.zoom;
    registration.focus_mm = zoom_.focus_mm;
    registration.keyframe = folder_ / "keyframe.png";
    registration.depth = folder_ / "depth.tiff";
    if (result.surface_fit)
      registration.closest_point = registration::SurfaceAgreement{
          result.surface_fit->closest_point_mean_mm, result.surface_fit->closest_point_rmse_mm,
          result.surface_fit->overlap};
    write("T.tfm", registration::transform_text(registration.T_camera_ct));
    write("registration.json", registration::sealed_registration(registration, folder_));
    outcome_.fre_mm = registration.fre_mm;
    const char* names[] = {"surface", "deep"};
    std::string tre;
    for (std::size_t i = 0; i < registration.tre.size(); ++i) {
      outcome_.predicted_tre_mm.emplace_back(names[i], registration.tre[i].rms_mm);
      tre += fmt::format(", predicted TRE {} {:.3f} mm", names[i], registration.tre[i].rms_mm);
    }
    return fmt::format("{} fiducials, FRE {:.3f} mm{}", result.labels.size(), registration.fre_mm,
                       tre);
  }

  const SetupSettings& settings_;
  const fs::path folder_;
  Rig rig_;
  const std::function<void(const std::string&)>& tell_;
  SetupOutcome outcome_;
  cv::Size size_;
  registration::ZoomCalibration zoom_;
  CtSide ct_;
  registration::StereoShot shot_, off_;
  cv::Mat keyframe_;
  registration::Markups beads_;  // below the markers, frame camera
  registration::TriangleMesh mire_;
};

}  // namespace

cv::Mat1f depth_for_camera(const cv::Mat1f& rectified_mm,
                           const registration::Rectification& geometry,
                           const cv::Matx33d& camera_matrix) {
  cv::Mat1f depth(rectified_mm.size(), std::numeric_limits<float>::quiet_NaN());
  const cv::Matx33d to_rays = geometry.R1 * camera_matrix.inv();
  for (int y = 0; y < depth.rows; ++y)
    for (int x = 0; x < depth.cols; ++x) {
      const cv::Vec3d ray = to_rays * cv::Vec3d(x, y, 1);  // rectified frame; z = 1 in the camera's
      const double u = geometry.P1(0, 0) * ray[0] / ray[2] + geometry.P1(0, 2);
      const double v = geometry.P1(1, 1) * ray[1] / ray[2] + geometry.P1(1, 2);
      if (!(u > -0.5 && v > -0.5 && u < rectified_mm.cols - 0.5 && v < rectified_mm.rows - 0.5))
        continue;
      const auto z_rectified = static_cast<double>(
          rectified_mm(static_cast<int>(std::lround(v)), static_cast<int>(std::lround(u))));
      depth(y, x) = static_cast<float>(z_rectified / ray[2]);
    }
  return depth;
}

SetupOutcome run_setup(const SetupSettings& settings, const fs::path& folder,
                       const std::function<void(const std::string&)>& tell) {
  return Setup(settings, folder, tell).run();
}

}  // namespace holdfast::rt
