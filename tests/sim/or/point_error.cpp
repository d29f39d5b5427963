// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/point_error.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"
#include "tests/sim/or/calibration_error.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;
using nlohmann::json;

std::string number_of(const std::string& label) {
  const std::size_t last = label.find_last_not_of("0123456789");
  std::string digits = last == std::string::npos ? label : label.substr(last + 1);
  digits.erase(0,
               std::min(digits.find_first_not_of('0'), digits.size() - (digits.empty() ? 0 : 1)));
  return digits;
}

// found[i]: index of the measured point of truth[i].
PointError summary(const std::vector<registration::MarkupPoint>& measured,
                   const std::vector<TruePoint>& truth,
                   const std::vector<std::optional<std::size_t>>& found) {
  PointError result;
  std::vector<Vector3d> from, to;
  double sum = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    if (!found[i]) {
      ++result.missing;
      continue;
    }
    const Vector3d& p = measured[*found[i]].position_mm;
    from.push_back(p);
    to.push_back(truth[i].p_mm);
    result.points.push_back({truth[i].label, p - truth[i].p_mm, std::nan("")});
    sum += (p - truth[i].p_mm).squaredNorm();
    result.max_mm = std::max(result.max_mm, (p - truth[i].p_mm).norm());
  }
  const auto n = static_cast<double>(from.size());
  result.surplus = static_cast<int>(measured.size() - from.size());
  result.rms_mm = from.empty() ? std::nan("") : std::sqrt(sum / n);
  result.rms_after_rigid_mm = std::nan("");
  if (from.size() < 3) return result;
  const Eigen::Isometry3d T_to_from = fit_rigid(from, to);
  double rest = 0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    const double e = (T_to_from * from[i] - to[i]).norm();
    result.points[i].after_rigid_mm = e;
    rest += e * e;
  }
  result.rms_after_rigid_mm = std::sqrt(rest / n);
  return result;
}

// A room's markers carry a label, a CT's the number that it is made from.
std::vector<TruePoint> points_of(const json& markers, const std::string& key) {
  std::vector<TruePoint> points;
  for (const json& marker : markers) {
    const json& p = marker.at(key);
    points.push_back({marker.contains("label") ? marker.at("label").get<std::string>()
                                               : std::to_string(marker.at("id").get<int>()),
                      {p.at(0).get<double>(), p.at(1).get<double>(), p.at(2).get<double>()}});
  }
  return points;
}

template <typename Pick>
std::vector<TruePoint> read_points(const std::string& truth_file, const std::string& refusal,
                                   const Pick& pick) {
  std::ifstream stream(truth_file);
  if (!stream) throw InputError(fmt::format("{}: cannot be read", truth_file));
  std::vector<TruePoint> points;
  try {
    points = pick(json::parse(stream));
  } catch (const json::exception&) {
    throw InputError(fmt::format("{}: {}", truth_file, refusal));
  }
  if (points.empty()) throw InputError(fmt::format("{}: the phantom has no markers", truth_file));
  return points;
}

}  // namespace

PointError error_by_label(const std::vector<registration::MarkupPoint>& measured,
                          const std::vector<TruePoint>& truth) {
  std::vector<std::optional<std::size_t>> found(truth.size());
  for (std::size_t i = 0; i < truth.size(); ++i)
    for (std::size_t k = 0; k < measured.size(); ++k)
      if (number_of(measured[k].label) == number_of(truth[i].label)) found[i] = k;
  return summary(measured, truth, found);
}

PointError error_by_place(const std::vector<registration::MarkupPoint>& measured,
                          const std::vector<TruePoint>& truth, double reach_mm) {
  std::vector<std::optional<std::size_t>> found(truth.size());
  for (std::size_t i = 0; i < truth.size(); ++i) {
    double nearest = reach_mm;
    for (std::size_t k = 0; k < measured.size(); ++k) {
      const double distance = (measured[k].position_mm - truth[i].p_mm).norm();
      if (distance <= nearest) {
        nearest = distance;
        found[i] = k;
      }
    }
  }
  return summary(measured, truth, found);
}

std::vector<TruePoint> true_points(const std::string& truth_file, const std::string& key,
                                   int pose) {
  return read_points(
      truth_file,
      fmt::format("not a truth file of `holdfast-sim or` with '{}' of pose {}", key, pose),
      [&](const json& truth) {
        return points_of(truth.at("poses").at(static_cast<std::size_t>(pose)).at("markers"), key);
      });
}

std::vector<TruePoint> true_beads(const std::string& truth_file) {
  return read_points(truth_file, "not a truth file of `holdfast-sim ct` or `or` with beads",
                     [](const json& truth) {
                       return truth.contains("poses")
                                  ? points_of(truth.at("poses").at(0).at("markers"), "bead_ct")
                                  : points_of(truth.at("markers"), "bead_ct_mm");
                     });
}

}  // namespace holdfast::sim
