// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/isosurface.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include <fmt/format.h>
#include <vtkCellArray.h>
#include <vtkFlyingEdges3D.h>
#include <vtkImageData.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkPolyData.h>
#include <vtkSMPTools.h>
#include <vtkShortArray.h>

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

/// The box's voxels as a VTK image over the index grid; the whole volume is not copied.
void fill_image(const CtVolume& volume, const IndexBox& box, vtkImageData* image) {
  image->SetExtent(box.min().x(), box.max().x(), box.min().y(), box.max().y(), box.min().z(),
                   box.max().z());
  vtkNew<vtkShortArray> values;
  const Eigen::Vector3i n = box.sizes() + Eigen::Vector3i::Ones();
  const vtkIdType count = static_cast<vtkIdType>(n.x()) * n.y() * n.z();
  const vtkIdType row = volume.size[0], slice = row * volume.size[1];
  if (count == static_cast<vtkIdType>(volume.hu.size())) {
    // VTK wants a pointer to mutable; the filter only reads.
    values->SetArray(const_cast<std::int16_t*>(volume.hu.data()), count, 1);
  } else {
    short* to = values->WritePointer(0, count);
    for (int k = box.min().z(); k <= box.max().z(); ++k)
      for (int j = box.min().y(); j <= box.max().y(); ++j, to += n.x())
        std::memcpy(to, volume.hu.data() + k * slice + j * row + box.min().x(),
                    static_cast<std::size_t>(n.x()) * sizeof(short));
  }
  image->GetPointData()->SetScalars(values);
}

template <class Condition>
void drop_triangles(TriangleMesh& mesh, const Condition& is_dropped) {
  auto& t = mesh.triangles;
  t.erase(std::remove_if(t.begin(), t.end(), is_dropped), t.end());
}

/// Root of i in a union-find forest, halving the path.
std::uint32_t root_of(std::vector<std::uint32_t>& parent, std::uint32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

void keep_largest(TriangleMesh& mesh) {
  std::vector<std::uint32_t> parent(mesh.vertices_mm.size());
  std::iota(parent.begin(), parent.end(), 0U);
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t other : {t[1], t[2]})
      parent[root_of(parent, other)] = root_of(parent, t[0]);
  std::vector<std::size_t> count(parent.size());
  for (const auto& t : mesh.triangles) ++count[root_of(parent, t[0])];
  const auto largest =
      static_cast<std::uint32_t>(std::max_element(count.begin(), count.end()) - count.begin());
  drop_triangles(mesh, [&](const auto& t) { return root_of(parent, t[0]) != largest; });
}

void drop_unused_vertices(TriangleMesh& mesh) {
  std::vector<std::uint32_t> new_index(mesh.vertices_mm.size());
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t corner : t) new_index[corner] = 1;
  std::uint32_t kept = 0;
  for (std::size_t i = 0; i < new_index.size(); ++i) {
    if (new_index[i] == 0) continue;
    mesh.vertices_mm[kept] = mesh.vertices_mm[i];
    new_index[i] = kept++;
  }
  mesh.vertices_mm.resize(kept);
  for (auto& t : mesh.triangles)
    for (std::uint32_t& corner : t) corner = new_index[corner];
}

TriangleMesh to_mesh(vtkPolyData* surface, const CtVolume& volume) {
  TriangleMesh mesh;
  const vtkIdType points = surface->GetNumberOfPoints();
  mesh.vertices_mm.reserve(static_cast<std::size_t>(points));
  for (vtkIdType i = 0; i < points; ++i) {
    double index[3];
    surface->GetPoint(i, index);
    mesh.vertices_mm.push_back(volume.point_at({index[0], index[1], index[2]}).cast<float>());
  }
  const bool is_left_handed = volume.ct_from_index().linear().determinant() < 0;
  vtkCellArray* cells = surface->GetPolys();
  mesh.triangles.reserve(static_cast<std::size_t>(cells->GetNumberOfCells()));
  vtkIdType corners = 0;
  const vtkIdType* ids = nullptr;
  for (cells->InitTraversal(); cells->GetNextCell(corners, ids) != 0;) {
    const auto a = static_cast<std::uint32_t>(ids[0]), b = static_cast<std::uint32_t>(ids[1]),
               c = static_cast<std::uint32_t>(ids[2]);
    const auto &pa = mesh.vertices_mm[a], &pb = mesh.vertices_mm[b], &pc = mesh.vertices_mm[c];
    // A voxel of exactly iso makes edges of no length.
    if (pa == pb || pb == pc || pc == pa) continue;
    if (is_left_handed)
      mesh.triangles.push_back({a, c, b});
    else
      mesh.triangles.push_back({a, b, c});
  }
  return mesh;
}

}  // namespace

TriangleMesh isosurface(const CtVolume& volume, const IsosurfaceOptions& options) {
  const IndexBox box = index_box(volume, options.roi_mm);
  vtkNew<vtkImageData> image;
  fill_image(volume, box, image);
  vtkNew<vtkFlyingEdges3D> filter;
  filter->SetInputData(image);
  filter->ComputeNormalsOff();
  filter->ComputeGradientsOff();
  filter->ComputeScalarsOff();
  filter->SetValue(0, options.iso_hu);
  vtkSMPTools::SetBackend("STDThread");
  vtkSMPTools::LocalScope(vtkSMPTools::Config{std::max(options.threads, 1)},
                          [&] { filter->Update(); });
  TriangleMesh mesh = to_mesh(filter->GetOutput(), volume);
  if (options.roi_mm) {
    const Eigen::AlignedBox3f roi = options.roi_mm->cast<float>();
    drop_triangles(mesh, [&](const auto& t) {
      return !std::all_of(t.begin(), t.end(),
                          [&](auto corner) { return roi.contains(mesh.vertices_mm[corner]); });
    });
  }
  if (options.is_largest_only && !mesh.triangles.empty()) keep_largest(mesh);
  drop_unused_vertices(mesh);
  if (mesh.triangles.empty())
    throw RefusedError(fmt::format("there is no surface at {} HU in the volume{}", options.iso_hu,
                                   options.roi_mm ? "'s ROI" : ""));
  return mesh;
}

}  // namespace holdfast::registration
