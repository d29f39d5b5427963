// SPDX-License-Identifier: Apache-2.0
#include "rt/study/fiducial_region.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

#include "rt/core/error.hpp"

namespace holdfast::rt {

FiducialRegion::FiducialRegion(const registration::Markups& beads, double clearance_mm)
    : centre_(Eigen::Vector3d::Zero()), clearance_mm_(clearance_mm) {
  const auto& points = beads.points;
  if (points.size() < 3) throw InputError("a region needs three fiducials or more");
  for (const auto& p : points) centre_ += p.position_mm / static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const auto& p : points)
    scatter += (p.position_mm - centre_) * (p.position_mm - centre_).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  if (!(eigen.eigenvalues()(1) > 1)) throw InputError("the fiducials lie in a line");
  for (int i = 0; i < 3; ++i) axes_[i] = eigen.eigenvectors().col(2 - i);
  for (const auto& p : points) corners_.push_back(in_plane(p.position_mm));
  std::sort(corners_.begin(), corners_.end(),
            [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
              return std::atan2(a.y(), a.x()) < std::atan2(b.y(), b.x());
            });
}

Eigen::Vector2d FiducialRegion::in_plane(const Eigen::Vector3d& p_ct_mm) const {
  const Eigen::Vector3d d = p_ct_mm - centre_;
  return {axes_[0].dot(d), axes_[1].dot(d)};
}

bool FiducialRegion::contains(const Eigen::Vector3d& p_ct_mm) const {
  const Eigen::Vector2d p = in_plane(p_ct_mm);
  for (std::size_t i = 0; i < corners_.size(); ++i) {
    const Eigen::Vector2d& a = corners_[i];
    const Eigen::Vector2d edge = corners_[(i + 1) % corners_.size()] - a;
    if (edge.x() * (p - a).y() - edge.y() * (p - a).x() < 0) return false;
    if ((p - a).norm() < clearance_mm_) return false;
  }
  return true;
}

}  // namespace holdfast::rt
