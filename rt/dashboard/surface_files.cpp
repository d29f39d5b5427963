// SPDX-License-Identifier: Apache-2.0
#include "rt/dashboard/surface_files.hpp"

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "registration/mesh_file.hpp"
#include "registration/registration_file.hpp"
#include "registration/triangle_tree.hpp"
#include "rt/core/error.hpp"

namespace holdfast::dashboard {
namespace {

using registration::TriangleMesh;

void append(std::string& bytes, std::uint32_t value) {
  for (int i = 0; i < 4; ++i) bytes += static_cast<char>((value >> (8 * i)) & 0xFFU);
}
void append(std::string& bytes, float value) {
  append(bytes, std::bit_cast<std::uint32_t>(value));
}

std::string packed(const TriangleMesh& mesh, const std::vector<float>& distance_mm) {
  std::string bytes = "HFM1";
  bytes.reserve(16 + 16 * mesh.vertices_mm.size() + 12 * mesh.triangles.size());
  append(bytes, static_cast<std::uint32_t>(mesh.vertices_mm.size()));
  append(bytes, static_cast<std::uint32_t>(mesh.triangles.size()));
  append(bytes, distance_mm.empty() ? 0U : 1U);
  for (const Eigen::Vector3f& v : mesh.vertices_mm)
    for (const float x : {v.x(), v.y(), v.z()}) append(bytes, x);
  for (const float d : distance_mm) append(bytes, d);
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t corner : triangle) append(bytes, corner);
  return bytes;
}

TriangleMesh read(const std::filesystem::path& file) {
  TriangleMesh mesh = registration::read_mesh(file.string());
  if (mesh.triangles.size() > kTrianglesMax)
    throw InputError(fmt::format("{}: {} triangles, more than the {} that a page may show",
                                 file.string(), mesh.triangles.size(), kTrianglesMax));
  return mesh;
}

void move(TriangleMesh& mesh, const Eigen::Isometry3d& T_camera_mesh) {
  const Eigen::Isometry3f T = T_camera_mesh.cast<float>();
  for (Eigen::Vector3f& v : mesh.vertices_mm) v = T * v;
}

std::vector<float> distances(const TriangleMesh& surface, const TriangleMesh& reference) {
  const registration::TriangleTree tree(reference);
  std::vector<float> result;
  result.reserve(surface.vertices_mm.size());
  for (const Eigen::Vector3f& v : surface.vertices_mm) {
    const auto found = tree.closest(v.cast<double>(), kHeatMapMaxMm);
    result.push_back(found.is_found ? static_cast<float>(found.distance_mm)
                                    : std::numeric_limits<float>::quiet_NaN());
  }
  return result;
}

}  // namespace

std::vector<PackedSurface> read_surfaces(const SurfaceFiles& files) {
  std::vector<PackedSurface> result;
  TriangleMesh ct;
  if (!files.ct.empty()) {
    if (files.registration.empty())
      throw InputError(fmt::format("{}: a registration is needed to place it", files.ct.string()));
    ct = read(files.ct);
    move(ct, registration::load_registration(files.registration).T_camera_ct);
    result.push_back({"ct", packed(ct, {})});
  }
  if (files.reconstruction.empty()) return result;
  TriangleMesh mire = read(files.reconstruction);
  if (mire.R_rectified_camera) {
    Eigen::Isometry3d T_camera_rectified = Eigen::Isometry3d::Identity();
    T_camera_rectified.linear() = mire.R_rectified_camera->transpose();
    move(mire, T_camera_rectified);
  }
  result.push_back({"reconstruction", packed(mire, ct.triangles.empty() ? std::vector<float>()
                                                                        : distances(mire, ct))});
  return result;
}

}  // namespace holdfast::dashboard
