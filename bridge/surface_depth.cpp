// SPDX-License-Identifier: Apache-2.0
#include "bridge/surface_depth.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <optional>
#include <sstream>
#include <vector>

#include <Eigen/LU>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

constexpr std::uintmax_t kSizeMaxBytes = 4ULL * 1024 * 1024 * 1024;
constexpr std::size_t kElementsMax = 100'000'000;

struct Property {
  std::string name, type, count_type;  // count_type: of a list's length; empty for a scalar
};
struct Element {
  std::string name;
  std::size_t count = 0;
  std::vector<Property> properties;
};
struct Mesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::array<std::size_t, 3>> triangles;
  Eigen::Matrix3d R_rectified_camera = Eigen::Matrix3d::Identity();
};

template <typename T>
double load(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

struct Scalar {
  std::size_t size;
  double (*read)(const char*);
};

const Scalar* scalar_of(const std::string& type) {
  static const std::map<std::string, Scalar> types = {
      {"char", {1, load<std::int8_t>}},     {"int8", {1, load<std::int8_t>}},
      {"uchar", {1, load<std::uint8_t>}},   {"uint8", {1, load<std::uint8_t>}},
      {"short", {2, load<std::int16_t>}},   {"int16", {2, load<std::int16_t>}},
      {"ushort", {2, load<std::uint16_t>}}, {"uint16", {2, load<std::uint16_t>}},
      {"int", {4, load<std::int32_t>}},     {"int32", {4, load<std::int32_t>}},
      {"uint", {4, load<std::uint32_t>}},   {"uint32", {4, load<std::uint32_t>}},
      {"float", {4, load<float>}},          {"float32", {4, load<float>}},
      {"double", {8, load<double>}},        {"float64", {8, load<double>}}};
  const auto it = types.find(type);
  return it == types.end() ? nullptr : &it->second;
}

class PlyReader {
 public:
  explicit PlyReader(const std::string& path) : path_(path), file_(path, std::ios::binary) {
    std::error_code error;
    size_bytes_ = std::filesystem::file_size(path, error);
    if (error) fail("cannot be read: " + error.message());
    if (size_bytes_ > kSizeMaxBytes) fail("is larger than 4 GiB");
  }

  Mesh read() {
    read_header();
    Mesh mesh;
    mesh.R_rectified_camera = R1_;
    for (const Element& element : elements_) {
      if (element.count > kElementsMax || element.count > size_bytes_)
        fail("declares more of '" + element.name + "' than the file can hold");
      for (std::size_t i = 0; i < element.count; ++i) read_record(element, mesh);
    }
    if (mesh.triangles.empty()) fail("holds no triangle");
    return mesh;
  }

 private:
  [[noreturn]] void fail(const std::string& what) const { throw InputError(path_ + ": " + what); }

  void read_header() {
    std::string line;
    for (int number = 0; number < 1000; ++number) {
      if (!std::getline(file_, line) || line.size() > 4096) break;
      if (!line.empty() && line.back() == '\r') line.pop_back();
      if (number == 0 && line != "ply") break;
      if (line == "end_header") return check_header();
      read_header_line(line);
    }
    fail("is not a PLY file");
  }

  void read_header_line(const std::string& line) {
    std::istringstream words(line);
    std::string first, second;
    words >> first >> second;
    if (first == "format") {
      is_ascii_ = second == "ascii";
      if (!is_ascii_ && second != "binary_little_endian")
        fail("format is '" + second + "', must be ascii or binary_little_endian");
    } else if (first == "element") {
      Element element{second, 0, {}};
      if (!(words >> element.count)) fail("has a broken header line: " + line);
      elements_.push_back(element);
    } else if (first == "property") {
      if (elements_.empty()) fail("has a property outside an element");
      Property property;
      if (second == "list")
        words >> property.count_type >> property.type >> property.name;
      else
        property.type = second, words >> property.name;
      if (!words || scalar_of(property.type) == nullptr ||
          (!property.count_type.empty() && scalar_of(property.count_type) == nullptr))
        fail("has a broken header line: " + line);
      elements_.back().properties.push_back(property);
    } else if (first == "comment" && second == "R1") {
      for (int k = 0; k < 9; ++k)
        if (!(words >> R1_(k / 3, k % 3))) fail("has a broken R1 comment");
      if (!((R1_ * R1_.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 &&
            R1_.determinant() > 0))
        fail("has an R1 comment that is no rotation");
    }
  }

  void check_header() const {
    for (const Element& element : elements_)
      if (element.properties.empty()) fail("has an element without properties");
  }

  double number(const std::string& type) {
    if (is_ascii_) {
      double value = 0;
      if (!(file_ >> value)) fail("is truncated or broken");
      return value;
    }
    const Scalar* scalar = scalar_of(type);
    std::array<char, 8> bytes{};
    file_.read(bytes.data(), static_cast<std::streamsize>(scalar->size));
    if (!file_) fail("is truncated");
    return scalar->read(bytes.data());
  }

  void read_record(const Element& element, Mesh& mesh) {
    Eigen::Vector3d vertex = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
    for (const Property& property : element.properties) {
      if (!property.count_type.empty()) {
        read_list(element, property, mesh);
        continue;
      }
      const double value = number(property.type);
      if (property.name == "x") vertex.x() = value;
      if (property.name == "y") vertex.y() = value;
      if (property.name == "z") vertex.z() = value;
    }
    if (element.name != "vertex") return;
    if (!vertex.allFinite()) fail("has a vertex that is not a point");
    mesh.vertices.push_back(vertex);
  }

  void read_list(const Element& element, const Property& property, Mesh& mesh) {
    const double count = number(property.count_type);
    const bool is_face = element.name == "face" &&
                         (property.name == "vertex_indices" || property.name == "vertex_index");
    if (is_face && count != 3) fail("must hold triangles only");
    if (!(count >= 0 && count <= 1e6)) fail("has a list of impossible length");
    std::array<std::size_t, 3> triangle{};
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
      const double value = number(property.type);
      if (!is_face) continue;
      if (!(value >= 0 && value < static_cast<double>(mesh.vertices.size())))
        fail("has a triangle whose vertex is not there");
      triangle[k] = static_cast<std::size_t>(value);
    }
    if (is_face) mesh.triangles.push_back(triangle);
  }

  std::string path_;
  std::ifstream file_;
  std::uintmax_t size_bytes_ = 0;
  bool is_ascii_ = false;
  std::vector<Element> elements_;
  Eigen::Matrix3d R1_ = Eigen::Matrix3d::Identity();
};

/// Draws one triangle: 1/z is linear over the image.
void draw(const std::array<Eigen::Vector3d, 3>& corners, cv::Mat& depth_mm) {
  const Eigen::Vector2d a = corners[0].head<2>(), b = corners[1].head<2>(),
                        c = corners[2].head<2>();
  const double area = (b - a).x() * (c - a).y() - (b - a).y() * (c - a).x();
  if (!(std::abs(area) > 1e-12)) return;
  const auto low = [](double v, int n) {
    return static_cast<int>(std::clamp(std::ceil(v), 0.0, static_cast<double>(n)));
  };
  const int x0 = low(std::min({a.x(), b.x(), c.x()}), depth_mm.cols);
  const int y0 = low(std::min({a.y(), b.y(), c.y()}), depth_mm.rows);
  const int x1 = low(std::max({a.x(), b.x(), c.x()}) + 1e-9, depth_mm.cols);
  const int y1 = low(std::max({a.y(), b.y(), c.y()}) + 1e-9, depth_mm.rows);
  for (int y = y0; y <= std::min(y1, depth_mm.rows - 1); ++y)
    for (int x = x0; x <= std::min(x1, depth_mm.cols - 1); ++x) {
      const Eigen::Vector2d p(x, y);
      const double wb = ((p - a).x() * (c - a).y() - (p - a).y() * (c - a).x()) / area;
      const double wc = ((b - a).x() * (p - a).y() - (b - a).y() * (p - a).x()) / area;
      const double wa = 1 - wb - wc;
      constexpr double kEdge = -1e-9;  // a pixel on a shared edge belongs to both triangles
      if (wa < kEdge || wb < kEdge || wc < kEdge) continue;
      const double z = 1 / (wa / corners[0].z() + wb / corners[1].z() + wc / corners[2].z());
      auto& pixel = depth_mm.at<float>(y, x);
      if (std::isnan(pixel) || z < static_cast<double>(pixel)) pixel = static_cast<float>(z);
    }
}

}  // namespace

cv::Mat depth_from_surface_file(const std::string& path, const perception::CameraModel& camera) {
  const Mesh mesh = PlyReader(path).read();
  cv::Mat depth_mm(camera.height_px, camera.width_px, CV_32FC1,
                   cv::Scalar::all(std::numeric_limits<double>::quiet_NaN()));
  for (const auto& triangle : mesh.triangles) {
    std::array<Eigen::Vector3d, 3> corners;
    bool is_in_front = true;
    for (std::size_t k = 0; k < 3; ++k) {
      const Eigen::Vector3d p = mesh.R_rectified_camera.transpose() * mesh.vertices[triangle[k]];
      is_in_front = is_in_front && p.z() > 1e-3;
      corners[k] = {camera.fx_px * p.x() / p.z() + camera.cx_px,
                    camera.fy_px * p.y() / p.z() + camera.cy_px, p.z()};
    }
    if (is_in_front) draw(corners, depth_mm);
  }
  return depth_mm;
}

}  // namespace holdfast::bridge
