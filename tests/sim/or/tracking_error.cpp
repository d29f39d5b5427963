// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/tracking_error.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <vector>

#include <fmt/format.h>

#include "rt/core/error.hpp"
#include "tests/sim/csv_table.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr double kSilentlyWrongUm = 200;

double mean(const std::vector<double>& values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double rms(const std::vector<double>& values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const double squares = std::inner_product(values.begin(), values.end(), values.begin(), 0.0);
  return std::sqrt(squares / static_cast<double>(values.size()));
}

double deviation(const std::vector<double>& values) {
  std::vector<double> around = values;
  for (double& value : around) value -= mean(values);
  return rms(around);
}

class Rows {
 public:
  explicit Rows(const std::filesystem::path& file) : table_(file), file_(file) {
    for (const char* name : {"tx_mm", "ty_mm", "tz_mm", "qw", "qx", "qy", "qz"})
      pose_.push_back(table_.column(name));
    status_ = table_.column("status");
    t_ns_ = table_.column("t_ns");
  }
  [[nodiscard]] std::size_t size() const { return table_.rows(); }
  [[nodiscard]] const std::string& status(std::size_t row) const {
    return table_.text(row, status_);
  }
  [[nodiscard]] std::chrono::nanoseconds t(std::size_t row) const {
    return std::chrono::nanoseconds(table_.integer(row, t_ns_));
  }
  [[nodiscard]] std::optional<Isometry3d> T_camera_site(std::size_t row) const {
    if (status(row) == "lost") return std::nullopt;
    std::vector<double> v;
    for (const std::size_t column : pose_) v.push_back(table_.number(row, column));
    const Eigen::Quaterniond q(v[3], v[4], v[5], v[6]);
    if (!(std::abs(q.norm() - 1) < 1e-3 && std::isfinite(v[0] + v[1] + v[2])))
      throw InputError(fmt::format("{}: row {}: is no pose", file_.string(), row + 1));
    return Eigen::Translation3d(v[0], v[1], v[2]) * q.normalized();
  }

 private:
  CsvTable table_;
  std::filesystem::path file_;
  std::vector<std::size_t> pose_;
  std::size_t status_ = 0, t_ns_ = 0;
};

}  // namespace

TrackingError tracking_error(const std::filesystem::path& poses, const Trajectory& truth,
                             const Isometry3d& T_camera_ideal, double depth_mm,
                             const std::optional<Vector3d>& p_site_mm) {
  const Rows rows(poses);
  if (rows.size() < 2) throw InputError(poses.string() + ": has no frame after the keyframe");
  const Vector3d p_site = p_site_mm.value_or(T_camera_ideal * Vector3d(0, 0, depth_mm));
  TrackingError result;
  result.rows =
      "frame,t_ns,status,x_um,y_um,error_x_um,error_y_um,step_error_x_um,step_error_y_um,"
      "depth_error_um,rotation_error_mrad,rotation_x_mrad,rotation_y_mrad,rotation_z_mrad\n";
  std::vector<double> steps, absolutes, depths, rotations;
  std::optional<Vector3d> before_um = Vector3d::Zero();
  for (std::size_t i = 1; i < rows.size(); ++i) {
    ++result.frames;
    const auto T = rows.T_camera_site(i);
    if (!T) {
      ++result.lost;
      before_um.reset();
      continue;
    }
    const SitePose pose = truth.at(rows.t(i) - rows.t(0));
    const Isometry3d T_true = T_camera_ideal *
                              Isometry3d(Eigen::Translation3d(pose.t_mm) * pose.q) *
                              T_camera_ideal.inverse(Eigen::Isometry);
    const Vector3d moved_um = 1000 * (T_true * p_site - p_site);
    const Vector3d error_um = 1000 * (*T * p_site - T_true * p_site);
    const double absolute_um = error_um.head<2>().norm();
    const Eigen::AngleAxisd turn(T->linear() * T_true.linear().transpose());
    const double rotation_mrad = 1000 * turn.angle();
    const Vector3d turn_mrad = rotation_mrad * turn.axis();
    absolutes.push_back(absolute_um);
    depths.push_back(error_um.z());
    rotations.push_back(rotation_mrad);
    std::string step = ",";
    if (before_um) {
      const Vector3d step_um = error_um - *before_um;
      steps.push_back(step_um.head<2>().norm());
      step = fmt::format("{:.3f},{:.3f}", step_um.x(), step_um.y());
    }
    before_um = error_um;
    const bool is_trusted = rows.status(i) != "degraded";
    if (is_trusted && absolute_um > kSilentlyWrongUm) ++result.silently_wrong;
    result.rows += fmt::format(
        "{},{},{},{:.3f},{:.3f},{:.3f},{:.3f},{},{:.3f},{:.5f},{:.5f},{:.5f},{:.5f}\n", i,
        rows.t(i).count(), rows.status(i), moved_um.x(), moved_um.y(), error_um.x(), error_um.y(),
        step, error_um.z(), rotation_mrad, turn_mrad.x(), turn_mrad.y(), turn_mrad.z());
  }
  result.step_mean_um = mean(steps);
  result.step_sd_um = deviation(steps);
  result.absolute_rms_um = rms(absolutes);
  result.absolute_max_um = absolutes.empty()
                               ? std::numeric_limits<double>::quiet_NaN()
                               : *std::max_element(absolutes.begin(), absolutes.end());
  result.depth_rms_um = rms(depths);
  result.rotation_rms_mrad = rms(rotations);
  return result;
}

}  // namespace holdfast::sim
