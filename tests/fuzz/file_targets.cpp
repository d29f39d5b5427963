// SPDX-License-Identifier: Apache-2.0
// What is read from files: configuration, calibrations, registration, points, surfaces, depth.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <string>

#include <opencv2/imgcodecs.hpp>
#include <sys/mman.h>
#include <unistd.h>

#include "bridge/camera_file.hpp"
#include "bridge/depth_file.hpp"
#include "registration/markups.hpp"
#include "registration/mesh_file.hpp"
#include "registration/registration_file.hpp"
#include "registration/stereo_calibration.hpp"
#include "registration/transform_file.hpp"
#include "rt/daemon_config.hpp"
#include "tests/fuzz/targets.hpp"

namespace holdfast::fuzz {
namespace {

/// The bytes as a file that exists in memory only.
class MemoryFile {
 public:
  explicit MemoryFile(std::span<const std::uint8_t> bytes) : fd_(memfd_create("fuzz", 0)) {
    const bool is_whole =
        fd_ >= 0 && write(fd_, bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size());
    if (!is_whole) throw std::runtime_error("memfd");
  }
  ~MemoryFile() { close(fd_); }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  [[nodiscard]] std::string path() const { return "/proc/self/fd/" + std::to_string(fd_); }

 private:
  int fd_;
};

Bytes text(const std::string& content) {
  return {content.begin(), content.end()};
}

std::vector<Bytes> no_seeds() {
  return {};
}

std::vector<Bytes> config_seeds() {
  std::vector<Bytes> seeds;
  for (const char* name : {"/holdfastd.toml", "/demo.toml"}) {
    std::ifstream file(std::string(HOLDFAST_CONFIG_DIR) + name, std::ios::binary);
    seeds.emplace_back(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
  }
  return seeds;
}

std::vector<Bytes> mesh_seeds() {
  registration::TriangleMesh mesh;
  for (int i = 0; i < 5; ++i)
    mesh.vertices_mm.emplace_back(static_cast<float>(i), static_cast<float>(i * i), 200.0F);
  mesh.triangles = {{0, 1, 2}, {1, 2, 3}, {2, 3, 4}};
  mesh.R_rectified_camera = Eigen::Matrix3d::Identity();
  return {text(ply_bytes(mesh)), text(stl_bytes(mesh))};
}

std::vector<Bytes> registration_seeds() {
  registration::Registration registration;
  registration.T_camera_ct.translation() = Eigen::Vector3d(1, 2, 200);
  registration.covariance.diagonal().setConstant(1e-3);
  registration.tre.push_back({});
  registration.zoom = 1.1;
  registration.focus_mm = 200;
  return {text(sealed_registration(registration, "/"))};
}

std::vector<Bytes> markup_seeds() {
  registration::Markups markups;
  for (int i = 0; i < 4; ++i)
    markups.points.push_back({std::to_string(i), Eigen::Vector3d(i, 2 * i, 3),
                              Eigen::Matrix3d::Identity() * 0.01, "bead"});
  markups.joint_covariance_mm2 = Eigen::MatrixXd::Identity(12, 12) * 0.01;
  return {text(markups_text(markups))};
}

std::vector<Bytes> transform_seeds() {
  return {text(registration::transform_text(Eigen::Isometry3d::Identity()))};
}

constexpr int kDepthWidth = 8, kDepthHeight = 6;

std::vector<Bytes> depth_seeds() {
  const cv::Mat depth(kDepthHeight, kDepthWidth, CV_32FC1, cv::Scalar(200));
  Bytes bytes;
  cv::imencode(".tiff", depth, bytes);
  return {bytes};
}

void take_config(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const rt::DaemonConfig config = rt::load_daemon_config(file.path());
  require(!safety::invalid_limit(config.limits), "a configuration with unusable limits");
}

void take_camera(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const perception::CameraModel camera = bridge::read_camera_file(file.path());
  require(!perception::invalid_camera(camera), "a camera that is none");
}

void take_stereo(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  (void)registration::read_stereo_calibration(file.path());
}

void take_registration(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const registration::Registration read = registration::load_registration(file.path());
  require(read.T_camera_ct.matrix().allFinite() && read.covariance.allFinite(),
          "a registration that is no number");
}

void take_markups(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  for (const registration::MarkupPoint& point : registration::read_markups_file(file.path()).points)
    require(point.position_mm.allFinite(), "a point that is no number");
}

void take_transform(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  require(registration::read_transform(file.path()).matrix().allFinite(),
          "a transform that is no number");
}

void take_mesh(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const registration::TriangleMesh mesh = registration::read_mesh(file.path());
  require(!mesh.vertices_mm.empty(), "a surface without vertices");
  for (const Eigen::Vector3f& vertex : mesh.vertices_mm)
    require(vertex.allFinite(), "a vertex that is no number");
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t index : triangle)
      require(index < mesh.vertices_mm.size(), "an index out of range");
}

void take_depth(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const cv::Mat depth = bridge::read_depth_file(file.path(), kDepthWidth, kDepthHeight);
  require(depth.type() == CV_32FC1 && depth.cols == kDepthWidth && depth.rows == kDepthHeight,
          "a depth map of another kind");
}

}  // namespace

std::span<const Target> file_targets() {
  static const Target targets[] = {{"config", config_seeds, take_config},
                                   {"camera", no_seeds, take_camera},
                                   {"stereo", no_seeds, take_stereo},
                                   {"registration", registration_seeds, take_registration},
                                   {"markups", markup_seeds, take_markups},
                                   {"transform", transform_seeds, take_transform},
                                   {"mesh", mesh_seeds, take_mesh},
                                   {"depth", depth_seeds, take_depth}};
  return targets;
}

}  // namespace holdfast::fuzz
