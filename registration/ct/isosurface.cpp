// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/isosurface.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <mutex>
#include <stdexcept>

#include <fmt/format.h>
#include <vtkCellArray.h>
#include <vtkFloatArray.h>
#include <vtkFlyingEdges3D.h>
#include <vtkImageData.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkSMPTools.h>
#include <vtkShortArray.h>

#include "registration/ct/mesh_cleaning.hpp"
#include "registration/worker_pool.hpp"
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

constexpr std::size_t kChunk = 1U << 15U;

/// Calls work(first, end) for pieces of 0 … count - 1, on the pool's threads.
template <class Work>
void in_chunks(WorkerPool& pool, std::size_t count, const Work& work) {
  pool.run(static_cast<int>((count + kChunk - 1) / kChunk), [&](int chunk) {
    const std::size_t first = static_cast<std::size_t>(chunk) * kChunk;
    work(first, std::min(first + kChunk, count));
  });
}

void place_vertices(const vtkPolyData& surface, const CtVolume& volume, WorkerPool& pool,
                    TriangleMesh& mesh) {
  vtkPoints* points = const_cast<vtkPolyData&>(surface).GetPoints();  // VTK knows no const
  const auto* indices = vtkFloatArray::SafeDownCast(points->GetData());
  if (indices == nullptr) throw std::logic_error("VTK's points are not of type float");
  const float* index = const_cast<vtkFloatArray*>(indices)->GetPointer(0);
  mesh.vertices_mm.resize(static_cast<std::size_t>(points->GetNumberOfPoints()));
  in_chunks(pool, mesh.vertices_mm.size(), [&](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i)
      mesh.vertices_mm[i] =
          volume.point_at(Eigen::Map<const Eigen::Vector3f>(index + 3 * i).cast<double>())
              .cast<float>();
  });
}

/// Returns the edges of no length: a voxel of exactly iso makes triangles that have such.
MeshEdges place_triangles(vtkPolyData& surface, bool is_turned, WorkerPool& pool,
                          TriangleMesh& mesh) {
  vtkCellArray* cells = surface.GetPolys();
  const auto count = static_cast<std::size_t>(cells->GetNumberOfCells());
  cells->ConvertTo64BitStorage();  // does nothing where it is already
  if (static_cast<std::size_t>(cells->GetNumberOfConnectivityIds()) != 3 * count)
    throw std::logic_error("VTK's cells are not triangles");
  const auto* corners = cells->GetConnectivityArray64()->GetPointer(0);
  mesh.triangles.resize(count);
  MeshEdges edges;
  std::mutex mutex;  // of edges
  in_chunks(pool, count, [&](std::size_t first, std::size_t end) {
    MeshEdges found;
    for (std::size_t i = first; i < end; ++i) {
      const auto at = [&](std::size_t k) { return static_cast<std::uint32_t>(corners[3 * i + k]); };
      auto& t = mesh.triangles[i];
      t = is_turned ? std::array{at(0), at(2), at(1)} : std::array{at(0), at(1), at(2)};
      for (const auto& [a, b] : {std::pair{t[0], t[1]}, {t[1], t[2]}, {t[2], t[0]}})
        if (mesh.vertices_mm[a] == mesh.vertices_mm[b]) found.push_back({a, b});
    }
    const std::lock_guard lock(mutex);
    edges.insert(edges.end(), found.begin(), found.end());
  });
  // Whatever order the threads came in, the mesh is the same.
  std::sort(edges.begin(), edges.end());
  return edges;
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
  const int threads = std::max(options.threads, 1);
  vtkSMPTools::SetBackend("STDThread");
  vtkSMPTools::LocalScope(vtkSMPTools::Config{threads}, [&] { filter->Update(); });
  WorkerPool pool(threads);
  TriangleMesh mesh;
  place_vertices(*filter->GetOutput(), volume, pool, mesh);
  const bool is_left_handed = volume.ct_from_index().linear().determinant() < 0;
  const MeshEdges edges = place_triangles(*filter->GetOutput(), is_left_handed, pool, mesh);
  // Dropping such triangles alone would tear the surface open.
  collapse_edges(edges, mesh);
  if (options.roi_mm) keep_inside(options.roi_mm->cast<float>(), mesh);
  if (options.is_largest_only) keep_largest_piece(mesh);
  if (mesh.triangles.empty())
    throw RefusedError(fmt::format("there is no surface at {} HU in the volume{}", options.iso_hu,
                                   options.roi_mm ? "'s ROI" : ""));
  return mesh;
}

}  // namespace holdfast::registration
