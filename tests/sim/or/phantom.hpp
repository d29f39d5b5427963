// SPDX-License-Identifier: Apache-2.0
// What lies under the virtual microscope, seen twice and independently: as surfaces with their
// looks (what light meets) and as a field of attenuation (what the CT scanner meets). Both come
// from one shape that neither contains exactly; neither is made from the other.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

namespace holdfast::sim {

/// How a surface answers light. Albedos are diffuse reflectances, 0..1.
struct Look {
  float albedo_visible = 0.6F;
  float albedo_nir = 0.6F;       ///< at the pattern's 740 nm
  float specular = 0.04F;        ///< reflectance of the glossy coat at normal incidence
  float roughness = 0.4F;        ///< 0 mirror .. 1 matt
  float texture_contrast = 0.F;  ///< standard deviation of the albedo over its mean
  float texture_mm = 0.5F;       ///< correlation length of that variation
  float scatter_mm = 0.F;        ///< 1/e radius of subsurface scatter of the pattern
  cv::Mat_<float> print;  ///< albedo factor over uv (0,0 = first pixel's corner); may be empty
};

struct LitSurface {
  std::vector<Eigen::Vector3f> vertices_mm;  ///< frame ct
  std::vector<Eigen::Vector3f> normals;      ///< per vertex, unit, outwards
  std::vector<Eigen::Vector2f> uv;           ///< per vertex; may be empty where `print` is
  std::vector<std::array<std::uint32_t, 3>> triangles;
  Look look;
};

/// A holder's marker and its bead, as they truly are.
struct TrueMarker {
  int aruco_id = 0;
  double side_mm = 0;  ///< of the black square
  /// Frame marker: origin at the square's centre, x along its upper edge, z out of the holder.
  Eigen::Isometry3d T_ct_marker = Eigen::Isometry3d::Identity();
  Eigen::Vector3d p_bead_ct_mm = Eigen::Vector3d::Zero();
};

struct Phantom {
  std::string name;
  std::vector<LitSurface> surfaces;  ///< empty where only the scan was asked for
  std::vector<TrueMarker> markers;   ///< empty: the phantom carries none
  /// The region the figures are taken in (paper A, Fig. 3), frame ct.
  Eigen::AlignedBox3d region_of_interest_mm;
  Eigen::AlignedBox3d scan_box_mm;  ///< what a CT scan of it covers, frame ct
  /// CT number (HU) at a point of frame ct; pure, callable from many threads at once.
  std::function<float(const Eigen::Vector3f& p_ct_mm)> hounsfield;
  /// Radius of a ball about the point in which `hounsfield` is constant (0 or less: none known);
  /// lets a scanner skip. May be empty. Pure, as above.
  std::function<float(const Eigen::Vector3f& p_ct_mm)> clearance_mm;
  /// The point the microscope is focused on, and the direction towards the microscope (unit).
  Eigen::Vector3d p_focus_ct_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d n_view_ct = Eigen::Vector3d::UnitZ();
  /// What lies along this (unit, normal to n_view_ct) is to appear along the image's x: the ear's
  /// long axis, for it fits the image only lengthways.
  Eigen::Vector3d x_view_ct = Eigen::Vector3d::UnitX();
};

/// Meshing takes seconds and the CT scanner needs no mesh: `scan_only` leaves the surfaces empty
/// and everything else as it is.
enum class PhantomParts { all, scan_only };

/// Paper A's phantom: an external ear, about 90 x 40 mm, with undercuts, and four holders with an
/// ArUco marker (DICT_4X4_50, ids 0..3) and a bead each. The seed shapes the ear, its looks and the
/// holders' places; seeds from 1000 on are for evaluation only.
[[nodiscard]] Phantom make_ear_phantom(std::uint32_t seed, PhantomParts parts = PhantomParts::all);

/// Paper B's scene: a mastoidectomy cavity with posterior tympanotomy in the temporal bone of the
/// real head CT of Debian's invesalius-examples. Throws UnavailableError when it is not installed.
enum class CavityRealism { bone, covered, bloody };
[[nodiscard]] Phantom make_cavity_phantom(std::uint32_t seed, CavityRealism realism,
                                          PhantomParts parts = PhantomParts::all);

}  // namespace holdfast::sim
