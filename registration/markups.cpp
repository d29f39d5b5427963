// SPDX-License-Identifier: Apache-2.0
#include "registration/markups.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

constexpr std::uintmax_t kSizeMaxBytes = 64U << 20U;
constexpr std::size_t kPointsMax = 10'000;
constexpr const char* kSchema =
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/"
    "Schema/markups-schema-v1.0.3.json#";

class Reader {
 public:
  explicit Reader(const std::string& path) : path_(path) {}

  std::vector<MarkupPoint> read() {
    const json content = parsed();
    if (!content.is_object() || !content.contains("markups") || !content["markups"].is_array())
      fail("is not a 3D Slicer markups file: it has no list 'markups'");
    for (const json& list : content["markups"]) read_list(list);
    if (points_.empty()) fail("holds no control point");
    return std::move(points_);
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
    json content = json::parse(text, nullptr, false);
    if (content.is_discarded()) fail("is not JSON");
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
    if (points_.size() == kPointsMax) fail(fmt::format("holds more than {} points", kPointsMax));
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
      check_covariance(covariance, point.label);
      if (is_ras) covariance = lps_from_ras * covariance * lps_from_ras;
      point.covariance_mm2 = covariance;
    }
    points_.push_back(std::move(point));
  }

  template <std::size_t kCount>
  std::array<double, kCount> numbers(const json& item, const char* key,
                                     const std::string& label) const {
    if (!item.contains(key) || !item[key].is_array() || item[key].size() != kCount)
      fail(fmt::format("{} of point '{}' is not a list of {} numbers", key, label, kCount));
    std::array<double, kCount> values{};
    for (std::size_t k = 0; k < kCount; ++k) {
      const json& value = item[key][k];
      if (!value.is_number() || !std::isfinite(value.get<double>()))
        fail(fmt::format("{} of point '{}' has a value that is not a finite number", key, label));
      values[k] = value.get<double>();
    }
    return values;
  }

  void check_covariance(const Eigen::Matrix3d& covariance, const std::string& label) const {
    const double scale = covariance.cwiseAbs().maxCoeff();
    if ((covariance - covariance.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale)
      fail(fmt::format("covariance_mm2 of point '{}' is not symmetric", label));
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance, Eigen::EigenvaluesOnly);
    const double smallest = solver.eigenvalues().minCoeff();
    if (!(smallest >= -1e-9 * scale))
      fail(fmt::format(
          "covariance_mm2 of point '{}' is not positive semi-definite: eigenvalue {} mm²", label,
          smallest));
  }

  const std::string& path_;
  std::vector<MarkupPoint> points_;
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

std::vector<MarkupPoint> read_markups(const std::string& path) {
  return Reader(path).read();
}

std::string markups_text(const std::vector<MarkupPoint>& points) {
  json list;
  list["type"] = "Fiducial";
  list["coordinateSystem"] = "LPS";
  list["coordinateUnits"] = "mm";
  list["locked"] = false;
  list["labelFormat"] = "%N-%d";
  list["controlPoints"] = json::array();
  for (const MarkupPoint& point : points)
    list["controlPoints"].push_back(control_point(point, list["controlPoints"].size() + 1));
  const json content = {{"@schema", kSchema}, {"markups", json::array({list})}};
  return content.dump(1, ' ', false, json::error_handler_t::replace) + "\n";
}

}  // namespace holdfast::registration
