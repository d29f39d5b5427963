// SPDX-License-Identifier: Apache-2.0
#include "rt/study/trajectory_file.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>

namespace holdfast::rt {

using perception::MotionEstimate;
using perception::TrackingStatus;

namespace {

constexpr const char* kHeader =
    "frame,t_ns,status,dx_um,dy_um,rotation_rad,scale,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw,sigma_t_mm,"
    "sigma_r_rad,inliers,drift_um,latency_us\n";
constexpr const char* kLostRow = ",,,,,,,,,,,,,,,,";

double largest_sigma(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(solver.eigenvalues().maxCoeff(), 0.0));
}

}  // namespace

std::string trajectory_header() {
  return kHeader;
}

std::string trajectory_row(int frame, std::chrono::nanoseconds t_frame, const MotionEstimate& e) {
  std::string row = fmt::format("{},{},{}", frame, t_frame.count(), name(e.status));
  if (e.status == TrackingStatus::lost) return row + kLostRow + "\n";
  const Eigen::Quaterniond q(e.T_camera_site.linear());
  const Eigen::Vector3d t = e.T_camera_site.translation();
  row += fmt::format(",{:.4f},{:.4f},{:.9f},{:.9f}", e.dx_um, e.dy_um, e.rotation_rad, e.scale);
  row += fmt::format(",{:.7f},{:.7f},{:.7f},{:.10f},{:.10f},{:.10f},{:.10f}", t.x(), t.y(), t.z(),
                     q.x(), q.y(), q.z(), q.w());
  if (e.covariance.allFinite())
    row += fmt::format(",{:.7f},{:.9f}", largest_sigma(e.covariance.topLeftCorner<3, 3>()),
                       largest_sigma(e.covariance.bottomRightCorner<3, 3>()));
  else
    row += ",,";  // a method that knows no uncertainty
  row += fmt::format(",{}", e.inliers);
  row += e.has_drift ? fmt::format(",{:.3f}", e.drift_um) : std::string(",");
  const double latency_us = static_cast<double>(e.times.total.count()) / 1000;
  return row + fmt::format(",{:.1f}\n", latency_us);
}

std::string tum_row(std::chrono::nanoseconds t_frame, const MotionEstimate& e) {
  if (e.status == TrackingStatus::lost) return {};
  const Eigen::Quaterniond q(e.T_camera_site.linear());
  const Eigen::Vector3d t_m = e.T_camera_site.translation() / 1000;
  return fmt::format("{}.{:09d} {:.10f} {:.10f} {:.10f} {:.10f} {:.10f} {:.10f} {:.10f}\n",
                     t_frame.count() / 1'000'000'000, std::abs(t_frame.count() % 1'000'000'000),
                     t_m.x(), t_m.y(), t_m.z(), q.x(), q.y(), q.z(), q.w());
}

}  // namespace holdfast::rt
