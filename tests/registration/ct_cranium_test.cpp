// SPDX-License-Identifier: Apache-2.0
// A real head CT against surfaces of it that other people's software made: Debian's
// invesalius-examples holds the voxels and, independently, the surfaces that InVesalius drew.
#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <vtkNew.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkXMLPolyDataReader.h>
#include <zlib.h>

#include "registration/ct/isosurface.hpp"
#include "registration/triangle_tree.hpp"

namespace holdfast::registration {
namespace {

constexpr const char* kArchive = "/usr/share/doc/invesalius-examples/examples/Cranium.inv3";
constexpr std::size_t kTarBlock = 512;
constexpr double kPixelMm = 0.9570312, kSliceMm = 1.5;
constexpr int kSamples = 20'000;

/// The content of the archive's member whose name ends in `name`.
std::string member_of_archive(const std::string& name) {
  const std::unique_ptr<gzFile_s, int (*)(gzFile)> file(gzopen(kArchive, "rb"), gzclose);
  std::array<char, kTarBlock> header{};
  while (file && gzread(file.get(), header.data(), kTarBlock) == static_cast<int>(kTarBlock)) {
    const std::string member(header.data(), strnlen(header.data(), 100));
    const std::size_t size = std::strtoul(std::string(&header[124], 12).c_str(), nullptr, 8);
    if (member.ends_with(name)) {
      std::string content(size, '\0');
      const int got = gzread(file.get(), content.data(), static_cast<unsigned>(size));
      return got == static_cast<int>(size) ? content : "";
    }
    const std::size_t padded = (size + kTarBlock - 1) / kTarBlock * kTarBlock;
    if (gzseek(file.get(), static_cast<z_off_t>(padded), SEEK_CUR) < 0) break;
  }
  return "";
}

/// Frame ct as InVesalius has it: x = column, y = -row, z = slice. A left-handed index frame.
CtVolume head() {
  CtVolume volume;
  volume.size = {256, 256, 108};
  const std::string matrix = member_of_archive("/matrix.dat");
  volume.hu.resize(std::size_t{256} * 256 * 108);
  if (matrix.size() != 2 * volume.hu.size()) return {};
  std::memcpy(volume.hu.data(), matrix.data(), matrix.size());
  volume.column_step_mm = {kPixelMm, 0, 0};
  volume.row_step_mm = {0, -kPixelMm, 0};
  for (int k = 0; k < 108; ++k) volume.slice_origin_mm.emplace_back(0, 0, k * kSliceMm);
  return volume;
}

std::vector<Eigen::Vector3d> vertices_of(const std::string& name) {
  vtkNew<vtkXMLPolyDataReader> reader;
  reader->ReadFromInputStringOn();
  reader->SetInputString(member_of_archive(name));
  reader->Update();
  vtkPolyData* surface = reader->GetOutput();
  std::vector<Eigen::Vector3d> points(static_cast<std::size_t>(surface->GetNumberOfPoints()));
  for (std::size_t i = 0; i < points.size(); ++i)
    surface->GetPoint(static_cast<vtkIdType>(i), points[i].data());
  return points;
}

struct Distances {
  double median_mm, p95_mm;
};

template <class Points>
Distances distances(const Points& points, const TriangleTree& surface) {
  std::vector<double> all;
  const std::size_t step = std::max<std::size_t>(1, points.size() / kSamples);
  for (std::size_t i = 0; i < points.size(); i += step)
    all.push_back(surface.closest(points[i]).distance_mm);
  std::sort(all.begin(), all.end());
  return {all[all.size() / 2], all[all.size() * 95 / 100]};
}

struct Case {
  const char* name;
  double iso_hu;
};

class Cranium : public ::testing::TestWithParam<Case> {};

TEST_P(Cranium, AgreesWithTheSurfaceThatInvesaliusDrew) {
  const CtVolume volume = head();
  ASSERT_FALSE(volume.hu.empty()) << kArchive << ": install the package invesalius-examples";
  const std::vector<Eigen::Vector3d> theirs = vertices_of(GetParam().name);
  ASSERT_GT(theirs.size(), 100'000U);
  IsosurfaceOptions options;
  options.iso_hu = GetParam().iso_hu;
  const TriangleMesh ours = isosurface(volume, options);
  const TriangleTree tree(ours);
  const Distances at = distances(theirs, tree);
  std::printf("%s at %g HU: %zu points to %zu triangles: median %.3f mm, p95 %.3f mm\n",
              GetParam().name, GetParam().iso_hu, theirs.size(), ours.triangles.size(),
              at.median_mm, at.p95_mm);
  RecordProperty("median_um", static_cast<int>(1000 * at.median_mm));
  RecordProperty("p95_um", static_cast<int>(1000 * at.p95_mm));
  // Asked for: 0.5 and 1.5 mm. Half a voxel aside would pass that, and is a fault.
  EXPECT_LT(at.median_mm, 0.1);
  EXPECT_LT(at.p95_mm, 0.3);
  // The comparison can fail: the same surface half a voxel aside does.
  std::vector<Eigen::Vector3d> aside = theirs;
  for (Eigen::Vector3d& p : aside) p += 0.5 * Eigen::Vector3d(kPixelMm, kPixelMm, kSliceMm);
  const Distances off = distances(aside, tree);
  EXPECT_GT(off.median_mm, 0.1);
  EXPECT_GT(off.p95_mm, 0.3);
}

INSTANTIATE_TEST_SUITE_P(Surfaces, Cranium,
                         ::testing::Values(Case{"/surface_0.vtp", 226},
                                           Case{"/surface_1.vtp", -142}),
                         [](const auto& of) { return of.param.iso_hu > 0 ? "Bone" : "Skin"; });

}  // namespace
}  // namespace holdfast::registration
