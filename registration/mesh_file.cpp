// SPDX-License-Identifier: Apache-2.0
#include "registration/mesh_file.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <unordered_map>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "registration/ply_reader.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

static_assert(std::endian::native == std::endian::little, "both formats are little-endian");

constexpr std::uintmax_t kSizeMaxBytes = 4ULL * 1024 * 1024 * 1024;
constexpr std::size_t kTrianglesMax = 100'000'000;
constexpr std::size_t kStlHeaderBytes = 80, kStlStartBytes = 84, kStlTriangleBytes = 50;

std::string read_file(const std::string& path) {
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  if (error) throw InputError(path + ": cannot be read: " + error.message());
  if (size > kSizeMaxBytes) throw InputError(path + ": is larger than 4 GiB");
  std::ifstream file(path, std::ios::binary);
  std::string bytes(size, '\0');
  if (!file.read(bytes.data(), static_cast<std::streamsize>(size)))
    throw InputError(path + ": cannot be read");
  return bytes;
}

struct BitwiseHash {
  std::size_t operator()(const std::array<std::uint32_t, 3>& bits) const {
    std::size_t hash = 1469598103934665603ULL;
    for (const std::uint32_t word : bits) hash = (hash ^ word) * 1099511628211ULL;
    return hash ^ (hash >> 29U);
  }
};

/// STL repeats every corner; equal corners become one vertex again.
class StlMesh {
 public:
  explicit StlMesh(const std::string& path) : path_(path) {}

  void add(const std::array<std::array<float, 3>, 3>& corners) {
    std::array<std::uint32_t, 3> triangle{};
    for (std::size_t k = 0; k < 3; ++k) {
      std::array<std::uint32_t, 3> bits{};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        if (!std::isfinite(corners[k][axis]))
          throw InputError(path_ + ": has a vertex that is not a point");
        bits[axis] = std::bit_cast<std::uint32_t>(corners[k][axis] + 0.F);  // -0 becomes 0
      }
      const auto [it, is_new] =
          index_.try_emplace(bits, static_cast<std::uint32_t>(mesh_.vertices_mm.size()));
      if (is_new) mesh_.vertices_mm.emplace_back(corners[k][0], corners[k][1], corners[k][2]);
      triangle[k] = it->second;
    }
    mesh_.triangles.push_back(triangle);
  }
  TriangleMesh take() {
    if (mesh_.triangles.empty()) throw InputError(path_ + ": holds no triangle");
    return std::move(mesh_);
  }

 private:
  const std::string& path_;
  TriangleMesh mesh_;
  std::unordered_map<std::array<std::uint32_t, 3>, std::uint32_t, BitwiseHash> index_;
};

/// Nothing when `bytes` cannot be a binary STL: its size follows from its triangle count.
std::optional<TriangleMesh> binary_stl(const std::string& path, const std::string& bytes) {
  std::uint32_t count = 0;
  if (bytes.size() < kStlStartBytes) return std::nullopt;
  std::memcpy(&count, bytes.data() + kStlHeaderBytes, sizeof count);
  if (bytes.size() != kStlStartBytes + kStlTriangleBytes * count) return std::nullopt;
  StlMesh mesh(path);
  for (std::size_t i = 0; i < count; ++i) {
    std::array<std::array<float, 3>, 3> corners{};
    std::memcpy(corners.data(), bytes.data() + kStlStartBytes + kStlTriangleBytes * i + 12, 36);
    mesh.add(corners);
  }
  return mesh.take();
}

TriangleMesh ascii_stl(const std::string& path, const std::string& bytes) {
  StlMesh mesh(path);
  TextScanner words(bytes);
  std::array<std::array<float, 3>, 3> corners{};
  std::size_t corner = 0;
  std::string_view word;
  while (!(word = words.word()).empty()) {
    if (word == "endsolid") return mesh.take();
    if (word == "facet") corner = 0;
    if (word == "endfacet" && corner != 3) break;
    if (word != "vertex") continue;
    if (corner == 3) break;
    for (float& value : corners[corner]) {
      const auto number = words.number();
      if (!number) throw InputError(path + ": has a broken vertex");
      value = static_cast<float>(*number);
    }
    if (++corner == 3) mesh.add(corners);
  }
  throw InputError(path + ": is truncated, or no STL of triangles");
}

template <class T>
void append(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string on_one_line(std::string text) {
  for (char& c : text)
    if (static_cast<unsigned char>(c) < ' ') c = ' ';
  return text;
}

std::string ply_header(const TriangleMesh& mesh) {
  std::string header = "ply\nformat binary_little_endian 1.0\n";
  if (mesh.R_rectified_camera) {
    header += "comment R1";
    for (int k = 0; k < 9; ++k)
      header += fmt::format(" {}", (*mesh.R_rectified_camera)(k / 3, k % 3));
    header += '\n';
  }
  for (const std::string& comment : mesh.comments)
    header += "comment " + on_one_line(comment) + '\n';
  header += fmt::format("element vertex {}\nproperty float x\nproperty float y\nproperty float z\n",
                        mesh.vertices_mm.size());
  if (!mesh.triangles.empty())
    header += fmt::format("element face {}\nproperty list uchar int vertex_indices\n",
                          mesh.triangles.size());
  return header + "end_header\n";
}

}  // namespace

TriangleMesh read_mesh(const std::string& path) {
  const std::string bytes = read_file(path);
  if (bytes.starts_with("ply\n") || bytes.starts_with("ply\r")) return read_ply(path, bytes);
  if (auto mesh = binary_stl(path, bytes)) return *std::move(mesh);
  if (bytes.starts_with("solid")) return ascii_stl(path, bytes);
  throw InputError(path + ": is neither a PLY nor a whole STL file");
}

std::string ply_bytes(const TriangleMesh& mesh) {
  std::string bytes = ply_header(mesh);
  const std::size_t header = bytes.size(), points = 12 * mesh.vertices_mm.size();
  bytes.resize(header + points + 13 * mesh.triangles.size());
  char* to = bytes.data() + header;
  for (const Eigen::Vector3f& p : mesh.vertices_mm) {
    std::memcpy(to, p.data(), 12);
    to += 12;
  }
  for (const auto& triangle : mesh.triangles) {
    *to = 3;
    std::memcpy(to + 1, triangle.data(), 12);
    to += 13;
  }
  return bytes;
}

std::string stl_bytes(const TriangleMesh& mesh) {
  if (mesh.triangles.size() > kTrianglesMax)
    throw InputError(
        fmt::format("{} triangles, an STL holds at most {}", mesh.triangles.size(), kTrianglesMax));
  std::string bytes = "binary STL, mm";  // never starts with `solid`
  for (const std::string& comment : mesh.comments) bytes += "; " + on_one_line(comment);
  bytes.resize(kStlHeaderBytes, ' ');
  bytes.reserve(kStlStartBytes + kStlTriangleBytes * mesh.triangles.size());
  append(bytes, static_cast<std::uint32_t>(mesh.triangles.size()));
  for (const auto& [i, j, k] : mesh.triangles) {
    const Eigen::Vector3f &a = mesh.vertices_mm[i], &b = mesh.vertices_mm[j],
                          &c = mesh.vertices_mm[k];
    const Eigen::Vector3f normal = (b - a).cross(c - a).normalized();
    for (const Eigen::Vector3f& v : {normal, a, b, c})
      bytes.append(reinterpret_cast<const char*>(v.data()), 12);
    append(bytes, std::uint16_t{0});
  }
  return bytes;
}

}  // namespace holdfast::registration
