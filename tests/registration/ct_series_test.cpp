// SPDX-License-Identifier: Apache-2.0
// Real files, broken bytes, and the handedness of the isosurface. What hospitals mix up:
// ct_faults_test.py.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <numeric>
#include <random>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "registration/ct/dicom_header.hpp"
#include "registration/ct/dicom_pixels.hpp"
#include "registration/ct/dicom_series.hpp"
#include "registration/ct/hu_conversion.hpp"
#include "registration/ct/isosurface.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

namespace fs = std::filesystem;

const fs::path samples = "/usr/lib/python3/dist-packages/pydicom/data/test_files";

std::string bytes_of(const fs::path& path) {
  std::string bytes(fs::file_size(path), '\0');
  std::ifstream(path, std::ios::binary)
      .read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return bytes;
}

TEST(DicomHeader, ReadsRealFilesWithAndWithoutMeta) {
  for (const char* name :
       {"CT_small.dcm", "ExplVR_BigEnd.dcm", "ExplVR_BigEndNoMeta.dcm", "ExplVR_LitEndNoMeta.dcm",
        "UN_sequence.dcm", "nested_priv_SQ.dcm", "MR_small_implicit.dcm", "693_J2KI.dcm"}) {
    const auto header = read_dicom_header((samples / name).string());
    EXPECT_TRUE(header) << name;
  }
  EXPECT_FALSE(read_dicom_header((samples / "README.txt").string()));
  const auto ct = read_dicom_header((samples / "CT_small.dcm").string());
  ASSERT_TRUE(ct);
  std::vector<std::int16_t> hu(std::size_t{128} * 128);
  EXPECT_FALSE(decode_hu(*ct, pixel_layout(*ct), hu));
  EXPECT_EQ(hu[0], 175 - 1024);  // pydicom's pixel_array[0, 0], rescaled
}

constexpr int kMutants = 60;  // of each file

TEST(DicomHeader, ChangedBytesAreReadOrRefusedNeverWorse) {
  const std::string path = ::testing::TempDir() + "mutated.dcm";
  std::mt19937 random(5);
  int read = 0;
  for (const char* name :
       {"CT_small.dcm", "MR_small_implicit.dcm", "MR_small_bigendian.dcm", "MR_small_RLE.dcm",
        "MR_small_jpeg_ls_lossless.dcm", "MR_small_jp2klossless.dcm"}) {
    const std::string good = bytes_of(samples / name);
    ASSERT_GT(good.size(), 1000U) << name;
    for (int i = 0; i < kMutants; ++i) {
      std::string bytes = good;
      const std::size_t reach = random() % 2 == 0 ? 2000 : bytes.size();
      for (unsigned k = 0; k <= random() % 4; ++k)
        bytes[random() % reach] = static_cast<char>(random() % 3 == 0 ? 255 : random());
      if (random() % 5 == 0) bytes.resize(random() % bytes.size());
      std::ofstream(path, std::ios::binary) << bytes;
      try {
        auto header = read_dicom_header(path);
        if (!header) continue;
        header->text[tag::kSlope] = "1";  // MR has none
        header->text[tag::kIntercept] = "0";
        const PixelLayout layout = pixel_layout(*header);
        std::vector<std::int16_t> hu(static_cast<std::size_t>(layout.rows) *
                                     static_cast<std::size_t>(layout.columns));
        (void)decode_hu(*header, layout, hu);
        ++read;
      } catch (const Error&) {
        continue;  // refused
      }
    }
  }
  fs::remove(path);
  EXPECT_GT(read, kMutants / 2);
}

CtVolume ball(const Eigen::Vector3d& column, const Eigen::Vector3d& row,
              const Eigen::Vector3d& slice) {
  CtVolume volume;
  volume.size = {30, 32, 34};
  volume.column_step_mm = column;
  volume.row_step_mm = row;
  const Eigen::Vector3d origin = -14.3 * column - 15.6 * row - 16.2 * slice;
  for (int k = 0; k < 34; ++k) {
    volume.slice_origin_mm.push_back(origin + k * slice);
    for (int j = 0; j < 32; ++j)
      for (int i = 0; i < 30; ++i) {
        const double r = (origin + k * slice + j * row + i * column).norm();
        volume.hu.push_back(
            static_cast<std::int16_t>(std::lround(1000 * std::clamp(6 - r, -1., 1.))));
      }
  }
  return volume;
}

double signed_volume(const TriangleMesh& mesh) {
  double sum = 0;
  for (const auto& [a, b, c] : mesh.triangles)
    sum += static_cast<double>(
               mesh.vertices_mm[a].dot(mesh.vertices_mm[b].cross(mesh.vertices_mm[c]))) /
           6;
  return sum;
}

TEST(Isosurface, LiesInPatientCoordinatesAndPointsOutwardsForEveryHandedness) {
  const Eigen::Vector3d x(0.5, 0, 0), y(0, 0.6, 0), z(0, 0, 0.6), tilted(0, 0.12, 0.6);
  for (const CtVolume& volume : {ball(x, y, z), ball(-x, y, z), ball(x, y, -z), ball(x, y, tilted),
                                 ball(y, x, z), ball(y, z, x)}) {
    const TriangleMesh mesh = isosurface(volume, {});
    for (const Eigen::Vector3f& p : mesh.vertices_mm) ASSERT_NEAR(p.norm(), 6, 0.06);
    EXPECT_NEAR(signed_volume(mesh), 4.0 / 3 * M_PI * 216, 15);
  }
}

TEST(Isosurface, StaysClosedWhereVoxelsAreExactlyIso) {
  CtVolume volume = ball({0.5, 0, 0}, {0, 0.6, 0}, {0, 0, 0.6});
  for (std::int16_t& hu : volume.hu) hu = static_cast<std::int16_t>(hu / 250 * 250);
  ASSERT_GT(std::count(volume.hu.begin(), volume.hu.end(), 0), 500);
  const TriangleMesh mesh = isosurface(volume, {});
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> uses;
  for (const auto& t : mesh.triangles)
    for (const auto& [a, b] : {std::pair{t[0], t[1]}, {t[1], t[2]}, {t[2], t[0]}}) {
      ASSERT_NE(mesh.vertices_mm[a], mesh.vertices_mm[b]);
      ++uses[std::minmax(a, b)];
    }
  EXPECT_GT(uses.size(), 1000U);
  for (const auto& [edge, count] : uses) ASSERT_EQ(count % 2, 0);
}

TEST(HuConversion, AgreesWithTheDefinitionForEveryStoredValueAndLayout) {
  struct Case {
    int bits_stored, high_bit;
    bool is_signed;
    double slope, intercept;
  };
  for (const Case& c :
       {Case{16, 15, false, 1, -1024}, Case{16, 15, true, 1, 0}, Case{12, 11, false, 1, -1024},
        Case{12, 11, true, 1, 24}, Case{12, 15, true, 2, -1000}, Case{12, 13, false, 0.5, -1024.5},
        Case{16, 15, true, 1.37, 3}, Case{16, 15, false, 9000, 1e12}}) {
    const PixelLayout layout{1,          65536,       16,      c.bits_stored,
                             c.high_bit, c.is_signed, c.slope, c.intercept};
    std::vector<std::int16_t> values(65536);
    std::iota(values.begin(), values.end(), std::int16_t{-32768});
    const std::vector<std::int16_t> raw = values;
    const bool has_clipped = convert_to_hu(layout, values);
    bool must_clip = false;
    for (std::size_t k = 0; k < raw.size(); ++k) {
      const int span = 1 << c.bits_stored;
      int stored =
          static_cast<std::uint16_t>(raw[k]) >> (c.high_bit + 1 - c.bits_stored) & (span - 1);
      if (c.is_signed && stored >= span / 2) stored -= span;
      const double hu = std::round(c.slope * stored + c.intercept);
      const double expected = std::clamp(hu, -32768.0, 32767.0);
      must_clip = must_clip || hu != expected;
      ASSERT_EQ(values[k], expected) << stored << " x " << c.slope << " + " << c.intercept;
    }
    EXPECT_EQ(has_clipped, must_clip) << c.slope << " " << c.intercept;
  }
}

TEST(Isosurface, KeepsTheLargestPieceAndTheRegionAsked) {
  CtVolume volume = ball({0.5, 0, 0}, {0, 0.6, 0}, {0, 0, 0.6});
  volume.hu[0] = 1000;  // a speck in the corner
  const std::size_t whole = isosurface(volume, {}).triangles.size();
  IsosurfaceOptions options;
  options.is_largest_only = true;
  EXPECT_EQ(isosurface(volume, options).triangles.size(), whole - 1);
  options.roi_mm = Eigen::AlignedBox3d(Eigen::Vector3d(0, -3, -3), Eigen::Vector3d(9, 3, 3));
  const TriangleMesh part = isosurface(volume, options);
  EXPECT_GT(part.triangles.size(), 20U);
  for (const Eigen::Vector3f& p : part.vertices_mm)
    EXPECT_TRUE(options.roi_mm->cast<float>().contains(p));
  options.roi_mm =
      Eigen::AlignedBox3d(Eigen::Vector3d::Constant(99), Eigen::Vector3d::Constant(100));
  EXPECT_THROW((void)isosurface(volume, options), RefusedError);
  EXPECT_THROW((void)isosurface(volume, {5000, {}, false, 2}), RefusedError);
}

}  // namespace
}  // namespace holdfast::registration
