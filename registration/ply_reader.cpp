// SPDX-License-Identifier: Apache-2.0
#include "registration/ply_reader.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr std::size_t kElementsMax = 100'000'000;
constexpr std::size_t kHeaderMaxBytes = 1U << 20U, kListMax = 1'000'000;
constexpr double kRotationTolerance = 1e-3;  // comments are often written with few digits
constexpr std::string_view kWhite = " \t\r\n\f\v";

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

const Scalar* scalar_of(std::string_view type) {
  struct Named {
    std::string_view name, alias;
    Scalar scalar;
  };
  static constexpr std::array<Named, 8> kTypes = {{{"char", "int8", {1, load<std::int8_t>}},
                                                   {"uchar", "uint8", {1, load<std::uint8_t>}},
                                                   {"short", "int16", {2, load<std::int16_t>}},
                                                   {"ushort", "uint16", {2, load<std::uint16_t>}},
                                                   {"int", "int32", {4, load<std::int32_t>}},
                                                   {"uint", "uint32", {4, load<std::uint32_t>}},
                                                   {"float", "float32", {4, load<float>}},
                                                   {"double", "float64", {8, load<double>}}}};
  for (const Named& type_known : kTypes)
    if (type == type_known.name || type == type_known.alias) return &type_known.scalar;
  return nullptr;
}

enum class Meaning { other, x, y, z, corners };

struct Property {
  const Scalar* type = nullptr;
  const Scalar* count_type = nullptr;  // of a list's length; null for a scalar
  Meaning meaning = Meaning::other;
};

struct Element {
  std::string name;
  std::size_t count = 0;
  std::vector<Property> properties;
};

Meaning meaning_of(const std::string& element, std::string_view property, bool is_list) {
  if (element == "vertex" && !is_list && property.size() == 1 && property >= "x" && property <= "z")
    return property == "x" ? Meaning::x : property == "y" ? Meaning::y : Meaning::z;
  if (element == "face" && is_list && (property == "vertex_indices" || property == "vertex_index"))
    return Meaning::corners;
  return Meaning::other;
}

class PlyReader {
 public:
  PlyReader(const std::string& path, std::string_view bytes)
      : path_(path), bytes_(bytes), words_(bytes) {}

  TriangleMesh read() {
    read_header();
    for (const Element& element : elements_) read_element(element);
    if (mesh_.vertices_mm.empty()) fail("holds no vertex");
    for (const auto& triangle : mesh_.triangles)
      for (const std::uint32_t corner : triangle)
        if (corner >= mesh_.vertices_mm.size()) fail("has a triangle whose vertex is not there");
    return std::move(mesh_);
  }

 private:
  [[noreturn]] void fail(std::string_view what) const {
    throw InputError(path_ + ": " + std::string(what));
  }

  void read_header() {
    std::size_t at = 0;
    bool has_format = false;
    while (at < std::min(bytes_.size(), kHeaderMaxBytes)) {
      const std::size_t end = bytes_.find('\n', at);
      if (end == std::string_view::npos) break;
      std::string_view line = bytes_.substr(at, end - at);
      if (line.ends_with('\r')) line.remove_suffix(1);
      at = end + 1;
      if (line == "end_header") {
        if (!has_format) fail("has no format line");
        at_ = at;
        words_ = TextScanner(bytes_.substr(at));
        return check_header();
      }
      has_format = line.starts_with("format ") || has_format;
      read_header_line(line);
    }
    fail("has a PLY header without an end");
  }

  void read_header_line(std::string_view line) {
    TextScanner words(line);
    const std::string_view first = words.word();
    if (first == "format") return read_format(words.word());
    if (first == "comment") return read_comment(line, words);
    if (first == "element") {
      const std::string_view name = words.word();
      const auto count = words.number();
      if (name.empty() || !count || !(*count >= 0) || *count != std::floor(*count))
        fail("has a broken header line: " + std::string(line));
      if (*count > static_cast<double>(std::min(kElementsMax, bytes_.size())))
        fail("declares more of '" + std::string(name) + "' than the file can hold");
      elements_.push_back({std::string(name), static_cast<std::size_t>(*count), {}});
    }
    if (first == "property") read_property(line, words);
  }

  void read_format(std::string_view format) {
    is_ascii_ = format == "ascii";
    if (!is_ascii_ && format != "binary_little_endian")
      fail("format is '" + std::string(format) + "', must be ascii or binary_little_endian");
  }

  void read_comment(std::string_view line, TextScanner words) {
    if (words.word() != "R1") {
      line.remove_prefix(std::min(line.size(), std::string_view("comment ").size()));
      mesh_.comments.emplace_back(line);
      return;
    }
    Eigen::Matrix3d R;
    for (int k = 0; k < 9; ++k) {
      const auto number = words.number();
      if (!number || mesh_.R_rectified_camera) fail("has a broken R1 comment, or two");
      R(k / 3, k % 3) = *number;
    }
    if (!((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < kRotationTolerance &&
          R.determinant() > 0))
      fail("has an R1 comment that is no rotation");
    mesh_.R_rectified_camera = Eigen::Quaterniond{R}.normalized().toRotationMatrix();
  }

  void read_property(std::string_view line, TextScanner& words) {
    if (elements_.empty()) fail("has a property outside an element");
    std::string_view type = words.word();
    Property property;
    const bool is_list = type == "list";
    if (is_list) {
      property.count_type = scalar_of(words.word());
      type = words.word();
    }
    property.type = scalar_of(type);
    const std::string_view name = words.word();
    if (name.empty() || property.type == nullptr || (is_list && property.count_type == nullptr))
      fail("has a broken header line: " + std::string(line));
    property.meaning = meaning_of(elements_.back().name, name, is_list);
    elements_.back().properties.push_back(property);
  }

  void check_header() const {
    int vertices = 0, faces = 0;
    for (const Element& element : elements_) {
      if (element.properties.empty()) fail("has an element without properties");
      const auto has = [&](Meaning meaning) {
        return std::count_if(element.properties.begin(), element.properties.end(),
                             [&](const Property& p) { return p.meaning == meaning; }) == 1;
      };
      if (element.name == "vertex") {
        ++vertices;
        if (!has(Meaning::x) || !has(Meaning::y) || !has(Meaning::z))
          fail("has vertices without exactly one x, y and z");
      }
      if (element.name == "face") {
        ++faces;
        if (!has(Meaning::corners)) fail("has faces without one list vertex_indices");
      }
    }
    if (vertices != 1 || faces > 1) fail("must have one element vertex and at most one face");
  }

  void read_element(const Element& element) {
    if (element.count > bytes_.size() - std::min(at_, bytes_.size())) fail("is truncated");
    const bool is_vertex = element.name == "vertex", is_face = element.name == "face";
    if (is_vertex) mesh_.vertices_mm.reserve(element.count);
    if (is_face) mesh_.triangles.reserve(element.count);
    Eigen::Vector3d vertex = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < element.count; ++i) {
      for (const Property& property : element.properties) {
        if (property.count_type != nullptr) {
          read_list(property);
          continue;
        }
        const double value = number(*property.type);
        if (property.meaning == Meaning::x) vertex.x() = value;
        if (property.meaning == Meaning::y) vertex.y() = value;
        if (property.meaning == Meaning::z) vertex.z() = value;
      }
      if (!is_vertex) continue;
      mesh_.vertices_mm.push_back(vertex.cast<float>());
      if (!mesh_.vertices_mm.back().allFinite()) fail("has a vertex that is not a point");
    }
  }

  void read_list(const Property& property) {
    const double count = number(*property.count_type);
    const bool is_face = property.meaning == Meaning::corners;
    if (is_face && count != 3) fail("must hold triangles only");
    if (!(count >= 0 && count <= static_cast<double>(kListMax)))
      fail("has a list of impossible length");
    std::array<std::uint32_t, 3> triangle{};
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
      const double value = number(*property.type);
      if (!is_face) continue;
      if (!(value >= 0 && value <= static_cast<double>(kElementsMax)) || value != std::floor(value))
        fail("has a triangle whose vertex is not there");
      triangle[k] = static_cast<std::uint32_t>(value);
    }
    if (is_face) mesh_.triangles.push_back(triangle);
  }

  double number(const Scalar& type) {
    if (is_ascii_) {
      const auto value = words_.number();
      if (!value) fail("is truncated or broken");
      return *value;
    }
    if (bytes_.size() - at_ < type.size) fail("is truncated");
    const char* from = bytes_.data() + at_;
    at_ += type.size;
    return type.read(from);
  }

  const std::string& path_;
  std::string_view bytes_;
  TextScanner words_;   // of an ascii body
  std::size_t at_ = 0;  // in a binary body
  bool is_ascii_ = false;
  std::vector<Element> elements_;
  TriangleMesh mesh_;
};

}  // namespace

std::string_view TextScanner::word() {
  const std::size_t begin = rest_.find_first_not_of(kWhite);
  rest_.remove_prefix(std::min(begin, rest_.size()));
  const std::string_view found = rest_.substr(0, rest_.find_first_of(kWhite));
  rest_.remove_prefix(found.size());
  return found;
}

std::optional<double> TextScanner::number() {
  std::string_view text = word();
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || end != text.data() + text.size()) return std::nullopt;
  if (error == std::errc::result_out_of_range && std::abs(value) < 1) return 0;
  if (error != std::errc{}) return std::nullopt;
  return value;
}

TriangleMesh read_ply(const std::string& path, std::string_view bytes) {
  return PlyReader(path, bytes).read();
}

}  // namespace holdfast::registration
