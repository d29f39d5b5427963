// SPDX-License-Identifier: Apache-2.0
#include "registration/transform_file.hpp"

#include <cmath>
#include <fstream>
#include <sstream>
#include <vector>

#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr double kRotationTolerance = 1e-6;
constexpr std::streamoff kSizeMaxBytes = 1 << 16;

[[noreturn]] void fail(const std::string& path, const std::string& what) {
  throw InputError(fmt::format("{}: {}", path, what));
}

std::vector<double> numbers(const std::string& text, std::size_t count, const std::string& path,
                            const char* what) {
  std::istringstream stream{text};
  std::vector<double> values;
  for (double value; stream >> value;) values.push_back(value);
  if (!stream.eof() || values.size() != count)
    fail(path, fmt::format("{} has {} numbers, not {}", what, values.size(), count));
  for (const double value : values)
    if (!std::isfinite(value)) fail(path, fmt::format("{} has a number that is not finite", what));
  return values;
}

}  // namespace

std::string transform_text(const Eigen::Isometry3d& T_moving_fixed) {
  std::string text =
      "#Insight Transform File V1.0\n#Transform 0\nTransform: "
      "AffineTransform_double_3_3\nParameters:";
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) text += fmt::format(" {}", T_moving_fixed.linear()(r, c));
  for (int r = 0; r < 3; ++r) text += fmt::format(" {}", T_moving_fixed.translation()(r));
  return text + "\nFixedParameters: 0 0 0\n";
}

Eigen::Isometry3d read_transform(const std::string& path) {
  std::ifstream stream{path, std::ios::binary | std::ios::ate};
  if (!stream) fail(path, "cannot be read");
  if (stream.tellg() > kSizeMaxBytes) fail(path, "is too large for a transform");
  stream.seekg(0);
  std::string line, type, parameters, fixed;
  int transforms = 0;
  while (std::getline(stream, line)) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    const auto value_of = [&line](const char* key) -> std::string {
      const std::string prefix = std::string{key} + ":";
      return line.rfind(prefix, 0) == 0 ? line.substr(prefix.size()) : std::string{};
    };
    if (const std::string value = value_of("Transform"); !value.empty()) {
      type = value;
      ++transforms;
    }
    if (const std::string value = value_of("Parameters"); !value.empty()) parameters = value;
    if (const std::string value = value_of("FixedParameters"); !value.empty()) fixed = value;
  }
  if (transforms != 1) fail(path, fmt::format("holds {} transforms, not 1", transforms));
  if (type.find("AffineTransform_double_3_3") == std::string::npos &&
      type.find("MatrixOffsetTransformBase_double_3_3") == std::string::npos)
    fail(path, fmt::format("is a{}, only AffineTransform_double_3_3 is read", type));
  const std::vector<double> p = numbers(parameters, 12, path, "Parameters");
  const std::vector<double> c =
      fixed.empty() ? std::vector<double>(3, 0.0) : numbers(fixed, 3, path, "FixedParameters");
  Eigen::Matrix3d R;
  R << p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8];
  const double error = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (error > kRotationTolerance || R.determinant() < 0)
    fail(path, fmt::format("is not rigid: its rotation is off by {:.3g}, at most {}",
                           R.determinant() < 0 ? 2.0 : error, kRotationTolerance));
  const Eigen::Vector3d centre{c[0], c[1], c[2]};
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = R;
  T.translation() = Eigen::Vector3d{p[9], p[10], p[11]} + centre - R * centre;
  return T;
}

}  // namespace holdfast::registration
