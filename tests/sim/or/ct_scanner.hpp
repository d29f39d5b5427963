// SPDX-License-Identifier: Apache-2.0
// A virtual CT scanner. It samples a phantom's attenuation on a grid of its own, with the blur of
// the detector and of the slice, partial volume, correlated quantum noise and a 12-bit range in
// which metal saturates (and so blooms). It knows nothing of the phantom's surfaces.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

/// CT numbers on a lattice in frame ct. The centre of pixel (row, column) of slice k is at
/// origin_mm + column * column_step_mm + row * row_step_mm + k * slice_step_mm.
struct CtVolume {
  std::vector<cv::Mat_<std::int16_t>> slices;  ///< HU, -1024..3071; all of one size
  Eigen::Vector3d origin_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d column_step_mm = Eigen::Vector3d::UnitX();  ///< DICOM: along a row
  Eigen::Vector3d row_step_mm = Eigen::Vector3d::UnitY();     ///< DICOM: down a column
  Eigen::Vector3d slice_step_mm = Eigen::Vector3d::UnitZ();   ///< not normal to a slice if tilted
  double slice_thickness_mm = 0.6;

  [[nodiscard]] Eigen::Vector3d position(double column, double row, double slice) const {
    return origin_mm + column * column_step_mm + row * row_step_mm + slice * slice_step_mm;
  }
};

struct CtScannerParameters {
  double pixel_mm = 0.4;
  double slice_mm = 0.6;        ///< thickness and distance
  double blur_mm = 0.6;         ///< in-plane point spread, full width at half maximum
  double slice_blur_mm = 0.65;  ///< slice profile, full width at half maximum
  double noise_hu = 12;         ///< standard deviation in plastic, after its correlation
  double oblique_deg = 0;       ///< turns the whole grid about an axis drawn by the seed
  double gantry_tilt_deg = 0;   ///< tilts the slices, not the table's axis
  std::uint32_t seed = 1;       ///< of the grid's place and of the noise
  /// Called with the fraction done, from the calling thread; may be empty. May throw: ends the
  /// scan.
  std::function<void(double)> progress;
};

/// Scans the phantom's scan_box_mm. Runs on all cores; the same parameters give the same values,
/// whatever their number. Throws InputError for parameters out of range (message has the limit).
[[nodiscard]] CtVolume scan(const Phantom& phantom, const CtScannerParameters& parameters);

/// The phantom with a dental filling in it: an irregular lump of metal, bead-sized but no ball,
/// `p_ct_mm` its centre. For tests of what mistakes one for a bead.
[[nodiscard]] Phantom with_filling(Phantom phantom, const Eigen::Vector3d& p_ct_mm);

}  // namespace holdfast::sim
