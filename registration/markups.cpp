// SPDX-License-Identifier: Apache-2.0
#include "registration/markups.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "registration/sealed_json.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

constexpr std::uintmax_t kSizeMaxBytes = 64U << 20U;
constexpr std::size_t kPointsMax = 10'000, kJointPointsMax = 300;
constexpr const char* kSchema =
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/"
    "Schema/markups-schema-v1.0.3.json#";

class Reader {
 public:
  explicit Reader(const std::string& path) : path_(path) {}

  Markups read() {
    const json content = parsed();
    if (!content.is_object() || !content.contains("markups") || !content["markups"].is_array())
      fail("is not a 3D Slicer markups file: it has no list 'markups'");
    for (const json& list : content["markups"]) read_list(list);
    if (read_.points.empty()) fail("holds no control point");
    if (content.contains("holdfast")) read_own(content["holdfast"]);
    return std::move(read_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const { throw InputError(path_ + ": " + what); }

  json parsed() const {
    std::error_code error;
    const std::uintmax_t size = std::filesystem::file_size(path_, error);
    if (error) fail("cannot be read: " + error.message());
    if (size > kSizeMaxBytes) fail(fmt::format("is {} bytes, at most {}", size, kSizeMaxBytes));
    std::string text(size, '\0');
    std::ifstream file(path_, std::ios::binary);
    if (!file.read(text.data(), static_cast<std::streamsize>(size))) fail("cannot be read");
    json content = parse_json(text);
    if (content.is_discarded()) fail("is not JSON, or nested too deep");
    return content;
  }

  std::string text_of(const json& object, const char* key, const char* otherwise) const {
    if (!object.contains(key)) return otherwise;
    if (!object[key].is_string()) fail(fmt::format("{} is not a text", key));
    return object[key].get<std::string>();
  }

  void read_list(const json& list) {
    if (!list.is_object()) fail("a member of 'markups' is not an object");
    if (const auto type = text_of(list, "type", "Fiducial"); type != "Fiducial")
      fail(fmt::format("is a markup of type '{}', must be 'Fiducial'", type));
    const auto system = text_of(list, "coordinateSystem", "LPS");
    if (system != "LPS" && system != "RAS")
      fail(fmt::format("coordinateSystem is '{}', must be 'LPS' or 'RAS'", system));
    const auto unit = text_of(list, "coordinateUnits", "mm");
    if (unit != "mm") fail(fmt::format("coordinateUnits is '{}', must be 'mm'", unit));
    if (!list.contains("controlPoints") || !list["controlPoints"].is_array())
      fail("has no list 'controlPoints'");
    for (const json& item : list["controlPoints"]) read_point(item, system == "RAS");
  }

  void read_point(const json& item, bool is_ras) {
    if (read_.points.size() == kPointsMax)
      fail(fmt::format("holds more than {} points", kPointsMax));
    if (!item.is_object()) fail("a control point is not an object");
    if (text_of(item, "positionStatus", "defined") != "defined") return;  // not placed
    MarkupPoint point;
    point.label = text_of(item, "label", "");
    point.description = text_of(item, "description", "");
    const auto position = numbers<3>(item, "position", point.label);
    point.position_mm = Eigen::Vector3d(position.data());
    const Eigen::DiagonalMatrix<double, 3> lps_from_ras(-1, -1, 1);
    if (is_ras) point.position_mm = lps_from_ras * point.position_mm;
    if (item.contains("covariance_mm2")) {
      const auto flat = numbers<9>(item, "covariance_mm2", point.label);
      Eigen::Matrix3d covariance = Eigen::Map<const Eigen::Matrix3d>(flat.data());
      check_covariance(covariance, fmt::format("covariance_mm2 of point '{}'", point.label));
      if (is_ras) covariance = lps_from_ras * covariance * lps_from_ras;
      point.covariance_mm2 = covariance;
    }
    const double sign = is_ras ? -1 : 1;
    signs_.insert(signs_.end(), {sign, sign, 1});
    read_.points.push_back(std::move(point));
  }

  void read_own(const json& own) {
    if (!own.is_object()) fail("member 'holdfast' is not an object");
    if (own.contains("properties")) {
      if (!own["properties"].is_object()) fail("holdfast.properties is not an object");
      for (const auto& [name, value] : own["properties"].items()) {
        if (!value.is_string()) fail(fmt::format("property '{}' is not a text", name));
        read_.properties[name] = value.get<std::string>();
      }
    }
    if (own.contains("joint_covariance_mm2")) read_joint(own["joint_covariance_mm2"]);
  }

  void read_joint(const json& flat) {
    const std::size_t count = read_.points.size(), size = 3 * count;
    if (count > kJointPointsMax)
      fail(fmt::format("has a joint_covariance_mm2 of {} points, at most {}", count,
                       kJointPointsMax));
    if (!flat.is_array() || flat.size() != size * size)
      fail(fmt::format("joint_covariance_mm2 is not a list of {} numbers, as {} points need",
                       size * size, count));
    Eigen::MatrixXd joint(size, size);
    for (std::size_t k = 0; k < flat.size(); ++k) {
      const std::size_t row = k / size, column = k % size;
      joint(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column)) =
          signs_[row] * signs_[column] * finite(flat[k], "joint_covariance_mm2");
    }
    check_covariance(joint, "joint_covariance_mm2");
    check_agreement(joint);
    read_.joint_covariance_mm2 = std::move(joint);
  }

  /// An edited file, or points in another order, would weigh a point with another's uncertainty.
  void check_agreement(const Eigen::MatrixXd& joint) const {
    Eigen::Index at = 0;
    for (const MarkupPoint& point : read_.points) {
      const Eigen::Matrix3d block = joint.block<3, 3>(at, at);
      at += 3;
      if (point.covariance_mm2 && !block.isApprox(*point.covariance_mm2, 1e-6))
        fail(fmt::format("joint_covariance_mm2 differs from covariance_mm2 of point '{}'",
                         point.label));
    }
  }

  double finite(const json& value, const std::string& of) const {
    if (!value.is_number() || !std::isfinite(value.get<double>()))
      fail(fmt::format("{} has a value that is not a finite number", of));
    return value.get<double>();
  }

  template <std::size_t kCount>
  std::array<double, kCount> numbers(const json& item, const char* key,
                                     const std::string& label) const {
    if (!item.contains(key) || !item[key].is_array() || item[key].size() != kCount)
      fail(fmt::format("{} of point '{}' is not a list of {} numbers", key, label, kCount));
    std::array<double, kCount> values{};
    for (std::size_t k = 0; k < kCount; ++k)
      values[k] = finite(item[key][k], fmt::format("{} of point '{}'", key, label));
    return values;
  }

  void check_covariance(const Eigen::MatrixXd& covariance, const std::string& name) const {
    const double scale = covariance.cwiseAbs().maxCoeff();
    if ((covariance - covariance.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale)
      fail(name + " is not symmetric");
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(covariance, Eigen::EigenvaluesOnly);
    const double smallest = solver.eigenvalues().minCoeff();
    if (!(smallest >= -1e-9 * scale))
      fail(fmt::format("{} is not positive semi-definite: eigenvalue {} mm²", name, smallest));
  }

  const std::string& path_;
  Markups read_;
  std::vector<double> signs_;  // lps_from_ras of each point's axes where its list is RAS, else 1
};

json control_point(const MarkupPoint& point, std::size_t number) {
  json item;
  item["id"] = fmt::format("{}", number);
  item["label"] = point.label;
  item["description"] = point.description;
  item["associatedNodeID"] = "";
  item["position"] = {point.position_mm.x(), point.position_mm.y(), point.position_mm.z()};
  item["orientation"] = {-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0};  // Slicer's own axes, RAS
  item["selected"] = item["visibility"] = true;
  item["locked"] = false;
  item["positionStatus"] = "defined";
  if (point.covariance_mm2)
    for (int k = 0; k < 9; ++k)
      item["covariance_mm2"].push_back((*point.covariance_mm2)(k / 3, k % 3));
  return item;
}

}  // namespace

Markups read_markups_file(const std::string& path) {
  return Reader(path).read();
}

std::vector<MarkupPoint> read_markups(const std::string& path) {
  return read_markups_file(path).points;
}

std::string markups_text(const std::vector<MarkupPoint>& points) {
  return markups_text(Markups{points, {}, {}});
}

std::string markups_text(const Markups& markups) {
  const Eigen::MatrixXd& joint = markups.joint_covariance_mm2;
  const auto size = static_cast<Eigen::Index>(3 * markups.points.size());
  if (joint.size() != 0 && (joint.rows() != size || joint.cols() != size))
    throw std::invalid_argument(fmt::format("joint covariance {}x{} of {} points", joint.rows(),
                                            joint.cols(), markups.points.size()));
  json list;
  list["type"] = "Fiducial";
  list["coordinateSystem"] = "LPS";
  list["coordinateUnits"] = "mm";
  list["locked"] = false;
  list["labelFormat"] = "%N-%d";
  list["controlPoints"] = json::array();
  for (const MarkupPoint& point : markups.points)
    list["controlPoints"].push_back(control_point(point, list["controlPoints"].size() + 1));
  json content = {{"@schema", kSchema}, {"markups", json::array({list})}};
  if (!markups.properties.empty()) content["holdfast"]["properties"] = markups.properties;
  for (Eigen::Index k = 0; k < joint.size(); ++k)
    content["holdfast"]["joint_covariance_mm2"].push_back(joint(k / size, k % size));
  return content.dump(1, ' ', false, json::error_handler_t::replace) + "\n";
}

}  // namespace holdfast::registration
