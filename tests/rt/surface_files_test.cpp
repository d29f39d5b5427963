// SPDX-License-Identifier: Apache-2.0
#include "rt/dashboard/surface_files.hpp"

#include <cmath>
#include <cstring>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "registration/mesh_file.hpp"
#include "registration/registration_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::dashboard {
namespace {

namespace fs = std::filesystem;
using registration::TriangleMesh;

class SurfaceFilesTest : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path write(const char* name, const std::string& bytes) const {
    std::ofstream(folder_ / name, std::ios::binary) << bytes;
    return folder_ / name;
  }
  /// A 100 mm square in the plane z = 0, in two triangles.
  static TriangleMesh square() {
    TriangleMesh mesh;
    mesh.vertices_mm = {{-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
  }
  /// The CT lies 200 mm before the camera.
  fs::path registration_file() const {
    registration::Registration r;
    r.T_camera_ct.translation().z() = 200;
    r.covariance = Eigen::Matrix<double, 6, 6>::Identity() * 1e-4;
    r.zoom = 1.3;
    r.focus_mm = 200;
    r.ct_identity = "ct";
    return write("registration.json", registration::sealed_registration(r, folder_));
  }
  template <class T>
  static T at(const std::string& bytes, std::size_t offset) {
    T value{};
    std::memcpy(&value, bytes.data() + offset, sizeof value);
    return value;
  }

  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-surfaces-" + std::to_string(::getpid()));
};

TEST_F(SurfaceFilesTest, PutsBothIntoTheCameraAndMeasuresTheirDistance) {
  TriangleMesh mire;
  mire.vertices_mm = {{0, 0, 200.5F}, {1, 0, 201}, {0, 1, 300}};
  mire.triangles = {{0, 1, 2}};
  const auto surfaces =
      read_surfaces({write("ct.ply", registration::ply_bytes(square())),
                     write("mire.ply", registration::ply_bytes(mire)), registration_file()});
  ASSERT_EQ(surfaces.size(), 2U);
  const std::string &ct = surfaces[0].bytes, &reconstruction = surfaces[1].bytes;
  EXPECT_EQ(surfaces[0].name, "ct");
  EXPECT_EQ(ct.substr(0, 4), "HFM1");
  EXPECT_EQ(ct.size(), 16U + 4 * 12 + 2 * 12);
  EXPECT_EQ(at<std::uint32_t>(ct, 4), 4U);
  EXPECT_EQ(at<std::uint32_t>(ct, 8), 2U);
  EXPECT_EQ(at<std::uint32_t>(ct, 12), 0U);
  EXPECT_FLOAT_EQ(at<float>(ct, 16), -50);
  EXPECT_FLOAT_EQ(at<float>(ct, 24), 200) << "by the registration";

  EXPECT_EQ(at<std::uint32_t>(reconstruction, 12), 1U);
  EXPECT_EQ(reconstruction.size(), 16U + 3 * 16 + 12);
  EXPECT_FLOAT_EQ(at<float>(reconstruction, 16 + 36), 0.5F);
  EXPECT_FLOAT_EQ(at<float>(reconstruction, 16 + 40), 1);
  EXPECT_TRUE(std::isnan(at<float>(reconstruction, 16 + 44))) << "100 mm away: unknown";
  EXPECT_EQ(at<std::uint32_t>(reconstruction, 16 + 48 + 8), 2U);
}

TEST_F(SurfaceFilesTest, TurnsARectifiedReconstructionBack) {
  TriangleMesh mire;
  mire.vertices_mm = {{1, 0, 200}};
  mire.R_rectified_camera = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()).matrix();
  const auto surfaces = read_surfaces({{}, write("mire.ply", registration::ply_bytes(mire)), {}});
  ASSERT_EQ(surfaces.size(), 1U);
  EXPECT_EQ(at<std::uint32_t>(surfaces[0].bytes, 12), 0U) << "no CT, no distances";
  EXPECT_NEAR(at<float>(surfaces[0].bytes, 16), 0, 1e-6);
  EXPECT_NEAR(at<float>(surfaces[0].bytes, 20), -1, 1e-6);
}

TEST_F(SurfaceFilesTest, RefusesWhatCannotBePlacedOrRead) {
  const fs::path ct = write("ct.ply", registration::ply_bytes(square()));
  EXPECT_THROW((void)read_surfaces({ct, {}, {}}), InputError);
  EXPECT_THROW((void)read_surfaces({ct, {}, folder_ / "none.json"}), InputError);
  EXPECT_THROW((void)read_surfaces({{}, write("bad.ply", "ply\nnonsense"), {}}), InputError);
  EXPECT_TRUE(read_surfaces({}).empty());
}

}  // namespace
}  // namespace holdfast::dashboard
