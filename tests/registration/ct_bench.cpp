// SPDX-License-Identifier: Apache-2.0
// The CT side on 300 slices of 512x512, a real head resampled with a scanner's noise, two threads:
// the isosurface, in turn with VTK's vtkMarchingCubes and with its vtkFlyingEdges3D alone (which
// ours calls: the rest is patient coordinates and a mesh without cracks), and DICOM files to a
// surface file, all that `holdfast surface` does once it runs.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <vtkFlyingEdges3D.h>
#include <vtkImageData.h>
#include <vtkMarchingCubes.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkPolyData.h>
#include <vtkShortArray.h>

#include "bridge/atomic_file.hpp"
#include "registration/ct/dicom_series.hpp"
#include "registration/ct/isosurface.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/cavity_phantom_head.hpp"
#include "tests/sim/or/dicom_series.hpp"

namespace {

using namespace holdfast;
using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

constexpr int kColumns = 512, kRows = 512, kSlices = 300;
constexpr double kPixelMm = 0.4776, kSliceMm = 0.535, kNoiseHu = 8;

/// Figures of one thing measured, ours and the other's; `theirs` may be empty.
struct Row {
  std::string name;
  std::vector<double> ours_ms, theirs_ms;
};

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(
      std::lround(share * static_cast<double>(values.size() - 1)))];
}

template <class Work>
void add_time(std::vector<double>& times_ms, const Work& work) {
  const auto start = Clock::now();
  work();
  times_ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - start).count());
}

sim::CtVolume scanned_head() {
  const sim::HeadCt head(sim::HeadCt::kDebianPath);
  sim::CtVolume scan;
  scan.column_step_mm *= kPixelMm;
  scan.row_step_mm *= kPixelMm;
  scan.slice_step_mm *= kSliceMm;
  scan.slice_thickness_mm = kSliceMm;
  cv::RNG random(1);
  for (int k = 0; k < kSlices; ++k) {
    cv::Mat_<float> slice(kRows, kColumns);
    random.fill(slice, cv::RNG::NORMAL, 0, kNoiseHu);
    for (int j = 0; j < kRows; ++j)
      for (int i = 0; i < kColumns; ++i)
        slice(j, i) += head.hounsfield(
            Eigen::Vector3d(i * kPixelMm, -j * kPixelMm, k * kSliceMm).cast<float>());
    cv::Mat_<std::int16_t> hu;
    cv::Mat(cv::min(cv::max(slice, -1024), 3071)).convertTo(hu, CV_16S);
    scan.slices.push_back(hu);
  }
  return scan;
}

registration::TriangleMesh surface_at(const registration::CtVolume& volume, double iso_hu) {
  registration::IsosurfaceOptions options;
  options.iso_hu = iso_hu;
  return registration::isosurface(volume, options);
}

/// A sphere of 120 voxels, smooth: as few triangles as a volume of this size may have.
registration::CtVolume plain_sphere(registration::CtVolume like) {
  auto value = like.hu.begin();
  for (int k = 0; k < like.size[2]; ++k)
    for (int j = 0; j < like.size[1]; ++j)
      for (int i = 0; i < like.size[0]; ++i, ++value) {
        const Eigen::Vector3d p(i - 0.5 * kColumns, j - 0.5 * kRows, k - 0.5 * kSlices);
        *value = static_cast<std::int16_t>(1000 * std::tanh((120 - p.norm()) / 3));
      }
  return like;
}

/// The same voxels as VTK wants them; no copy.
void show_to_vtk(const registration::CtVolume& volume, vtkImageData* image) {
  vtkNew<vtkShortArray> values;
  values->SetArray(const_cast<std::int16_t*>(volume.hu.data()),
                   static_cast<vtkIdType>(volume.hu.size()), 1);
  image->SetDimensions(volume.size[0], volume.size[1], volume.size[2]);
  image->GetPointData()->SetScalars(values);
}

template <class Filter>
void run_filter(vtkImageData* image, double iso_hu) {
  vtkNew<Filter> filter;
  filter->SetInputData(image);
  filter->ComputeNormalsOff();
  filter->ComputeGradientsOff();
  filter->ComputeScalarsOff();
  filter->SetValue(0, iso_hu);
  filter->Update();
}

struct Level {
  const char* name;
  double iso_hu;
};

void bench_isosurface(const registration::CtVolume& volume, const std::vector<Level>& levels,
                      int repeats, std::vector<Row>& rows) {
  vtkNew<vtkImageData> image;
  show_to_vtk(volume, image);
  for (const auto& [name, iso_hu] : levels) {
    Row cubes{fmt::format("ct_isosurface_{}", name), {}, {}}, edges = cubes;
    edges.name += "_over_flying_edges";
    for (int i = 0; i < repeats; ++i) {
      add_time(cubes.ours_ms, [&] { (void)surface_at(volume, iso_hu); });
      // The number of VTK's threads stays what ours has set.
      add_time(edges.theirs_ms, [&] { run_filter<vtkFlyingEdges3D>(image, iso_hu); });
      add_time(cubes.theirs_ms, [&] { run_filter<vtkMarchingCubes>(image, iso_hu); });
    }
    edges.ours_ms = cubes.ours_ms;
    rows.insert(rows.end(), {cubes, edges});
  }
}

void bench_command(const fs::path& folder, int repeats, std::vector<Row>& rows) {
  Row read{"ct_read_300_slices", {}, {}}, whole{"ct_files_to_surface_file", {}, {}};
  for (int i = 0; i < repeats; ++i)
    add_time(whole.ours_ms, [&] {
      registration::CtVolume volume;
      add_time(read.ours_ms,
               [&] { volume = registration::read_ct_series((folder / "ct").string()); });
      bridge::write_file_atomically((folder / "ct.ply").string(),
                                    registration::ply_bytes(surface_at(volume, 226)));
    });
  rows.insert(rows.end(), {read, whole});
}

nlohmann::ordered_json json_of(const std::vector<Row>& rows) {
  auto json = nlohmann::ordered_json::array();
  for (const Row& row : rows) {
    const double ours = quantile(row.ours_ms, 0.5);
    json.push_back({{"name", row.name},
                    {"median", ours},
                    {"p99", quantile(row.ours_ms, 0.99)},
                    {"unit", "ms"}});
    if (row.theirs_ms.empty()) continue;
    json.back()["baseline"] = quantile(row.theirs_ms, 0.5);
    json.back()["ratio"] = quantile(row.theirs_ms, 0.5) / ours;
  }
  return json;
}

struct TemporaryFolder {
  fs::path path;
  TemporaryFolder() {
    std::string name = (fs::temp_directory_path() / "holdfast-bench-ct.XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw UnavailableError(name + ": cannot be made");
    path = name;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
};

void run(int repeats, const char* out) {
  std::vector<Row> rows;
  const TemporaryFolder folder;
  {
    const sim::CtVolume scan = scanned_head();
    (void)write_dicom_series(scan, {}, folder.path / "ct");
  }
  const registration::CtVolume head = registration::read_ct_series((folder.path / "ct").string());
  bench_isosurface(head, {{"bone", 226}, {"skin", -142}}, repeats, rows);
  bench_isosurface(plain_sphere(head), {{"sphere", 0}}, repeats, rows);
  bench_command(folder.path, repeats, rows);
  for (const Row& row : rows) {
    fmt::print("{:<40} ours {:8.1f} ms", row.name, quantile(row.ours_ms, 0.5));
    if (!row.theirs_ms.empty()) fmt::print("  VTK {:8.1f} ms", quantile(row.theirs_ms, 0.5));
    fmt::print("\n");
  }
  if (out != nullptr) bridge::write_file_atomically(out, json_of(rows).dump(1) + "\n");
}

}  // namespace

int main(int argc, char** argv) {
  bool is_quick = false;
  const char* out = nullptr;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--quick") == 0) {
      is_quick = true;
    } else if (std::strcmp(argv[i], "--json") == 0 && i + 1 < argc) {
      out = argv[++i];
    } else {
      std::fputs("usage: holdfast-bench-ct [--quick] [--json FILE]\n", stderr);
      return 2;
    }
  }
  try {
    run(is_quick ? 3 : 15, out);
  } catch (const Error& error) {
    fmt::print(stderr, "holdfast-bench-ct: {}\n", error.what());
    return 1;
  }
  return 0;
}
