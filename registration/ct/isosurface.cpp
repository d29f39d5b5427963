// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/isosurface.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "registration/ct/bit_cubes.hpp"
#include "registration/ct/mesh_cleaning.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using IndexBox = Eigen::AlignedBox<int, 3>;

/// The voxels that a surface inside the ROI can depend on.
IndexBox index_box(const CtVolume& volume, const std::optional<Eigen::AlignedBox3d>& roi_mm) {
  const Eigen::Vector3i last =
      Eigen::Vector3i(volume.size[0], volume.size[1], volume.size[2]) - Eigen::Vector3i::Ones();
  const IndexBox whole(Eigen::Vector3i::Zero(), last);
  if (!roi_mm) return whole;
  if (roi_mm->isEmpty()) throw RefusedError("the ROI is empty: its lower corner must come first");
  const Eigen::Affine3d index_from_ct = volume.ct_from_index().inverse();
  Eigen::AlignedBox3d box;
  for (int corner = 0; corner < 8; ++corner)
    box.extend(index_from_ct *
               roi_mm->corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner)));
  // One voxel for the cell, one for slices off the mean line.
  const Eigen::Array3d low = box.min().array().floor() - 2, high = box.max().array().ceil() + 2;
  const Eigen::Array3d end = last.cast<double>().array();
  IndexBox cut;
  cut.min() = low.max(0).min(end).matrix().cast<int>();
  cut.max() = high.max(0).min(end).matrix().cast<int>();
  if ((high < 0).any() || (low > end).any() || (cut.sizes().array() < 1).any())
    throw RefusedError("the ROI lies outside the CT volume");
  return cut;
}

}  // namespace

TriangleMesh isosurface(const CtVolume& volume, const IsosurfaceOptions& options) {
  const IndexBox box = index_box(volume, options.roi_mm);
  const bool is_left_handed = volume.ct_from_index().linear().determinant() < 0;
  TriangleMesh mesh =
      bit_cubes(volume, box, options.iso_hu, is_left_handed, std::max(options.threads, 1));
  if (options.roi_mm) keep_inside(options.roi_mm->cast<float>(), mesh);
  if (options.is_largest_only) keep_largest_piece(mesh);
  if (mesh.triangles.empty())
    throw RefusedError(fmt::format("there is no surface at {} HU in the volume{}", options.iso_hu,
                                   options.roi_mm ? "'s ROI" : ""));
  return mesh;
}

}  // namespace holdfast::registration
