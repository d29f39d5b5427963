// SPDX-License-Identifier: Apache-2.0
#include "registration/mesh_file.hpp"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <random>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

class MeshFile : public ::testing::Test {
 protected:
  void SetUp() override {
    path_ =
        (std::filesystem::path{::testing::TempDir()} /
         (std::string{"mesh_"} + ::testing::UnitTest::GetInstance()->current_test_info()->name()))
            .string();
  }
  void TearDown() override { std::filesystem::remove(path_); }

  TriangleMesh read(const std::string& bytes) const {
    std::ofstream(path_, std::ios::binary) << bytes;
    return read_mesh(path_);
  }
  std::string refusal(const std::string& bytes) const {
    try {
      (void)read(bytes);
    } catch (const InputError& e) {
      return e.what();
    }
    return "";
  }
  static TriangleMesh tetrahedron() {
    TriangleMesh mesh;
    mesh.vertices_mm = {{0.1F, 0, 0}, {10, 0, -3.3333333F}, {0, 10, 0}, {0, 0, 1e-7F}};
    mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
    return mesh;
  }

  std::string path_;
};

TEST_F(MeshFile, PlyComesBackBitForBit) {
  TriangleMesh mesh = tetrahedron();
  mesh.R_rectified_camera =
      Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  mesh.comments = {"ct_series 1.2.840.1", "SPACE=LPS"};
  const TriangleMesh back = read(ply_bytes(mesh));
  EXPECT_TRUE(back.vertices_mm == mesh.vertices_mm);
  EXPECT_TRUE(back.triangles == mesh.triangles);
  EXPECT_EQ(back.comments, mesh.comments);
  ASSERT_TRUE(back.R_rectified_camera);
  EXPECT_TRUE(back.R_rectified_camera->isApprox(*mesh.R_rectified_camera, 1e-14));
}

TEST_F(MeshFile, PointCloudHasNoTriangles) {
  TriangleMesh mesh = tetrahedron();
  mesh.triangles.clear();
  const TriangleMesh back = read(ply_bytes(mesh));
  EXPECT_EQ(back.vertices_mm.size(), 4U);
  EXPECT_TRUE(back.triangles.empty());
  EXPECT_FALSE(back.R_rectified_camera);
}

TEST_F(MeshFile, StlComesBackWithSharedVerticesAndOutwardNormals) {
  const TriangleMesh mesh = tetrahedron();
  const std::string bytes = stl_bytes(mesh);
  Eigen::Vector3f normal;
  std::memcpy(normal.data(), bytes.data() + 84, 12);  // of triangle 0: below the tetrahedron
  EXPECT_LT(normal.z(), -0.9F);
  const TriangleMesh back = read(bytes);
  ASSERT_EQ(back.vertices_mm.size(), 4U);
  for (std::size_t t = 0; t < 4; ++t)
    for (std::size_t k = 0; k < 3; ++k)
      EXPECT_EQ(back.vertices_mm[back.triangles[t][k]], mesh.vertices_mm[mesh.triangles[t][k]]);
}

TEST_F(MeshFile, ReadsWhatOtherToolsWrite) {
  const TriangleMesh ascii = read(
      "ply\r\nformat ascii 1.0\r\nobj_info x\r\nelement vertex 3\r\nproperty double x\r\n"
      "property double y\r\nproperty double z\r\nproperty uchar red\r\nelement face 1\r\n"
      "property uchar flags\r\nproperty list uchar uint vertex_index\r\nend_header\r\n"
      "+1.5 0 -2e1 7\r\n1 0 0 7\r\n0 1 0 255\r\n9 3 2 1 0\r\n");
  EXPECT_EQ(ascii.vertices_mm[0], Eigen::Vector3f(1.5F, 0, -20));
  EXPECT_EQ(ascii.triangles[0], (std::array<std::uint32_t, 3>{2, 1, 0}));
  const TriangleMesh stl = read(
      "solid a\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n"
      "   vertex 0 1 0\n  endloop\n endfacet\nendsolid a\n");
  EXPECT_EQ(stl.vertices_mm.size(), 3U);
  EXPECT_EQ(stl.triangles.size(), 1U);
}

TEST_F(MeshFile, RefusesBadInputByName) {
  const std::string head = "ply\nformat ascii 1.0\n";
  const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
  const std::string face = "property list uchar int vertex_indices\nend_header\n";
  const std::string three = "0 0 0\n1 0 0\n0 1 0\n";
  const std::string ply = ply_bytes(tetrahedron()), stl = stl_bytes(tetrahedron());
  std::string infinite = stl;
  const float inf = std::numeric_limits<float>::infinity();
  std::memcpy(infinite.data() + 96, &inf, 4);
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "neither a PLY nor"},
      {"hello", "neither a PLY nor"},
      {stl.substr(0, stl.size() - 1), "neither a PLY nor"},
      {infinite, "not a point"},
      {"solid a\nfacet\nvertex 0 0 0\nvertex 0 0 1\nvertex", "broken vertex"},
      {"solid a\nfacet\nvertex 0 0 0\nvertex 0 0 1\nendfacet\nendsolid", "no STL of triangles"},
      {"solid a\nendsolid a\n", "holds no triangle"},
      {ply.substr(0, ply.size() - 1), "is truncated"},
      {"ply\nformat binary_big_endian 1.0\n", "binary_big_endian"},
      {"ply\nformat ascii 1.0\nelement vertex 3\n", "without an end"},
      {head + "element vertex 3\nend_header\n" + three, "element without properties"},
      {head + "element vertex 3\nproperty float x\nproperty float y\nend_header\n" + three,
       "exactly one x, y and z"},
      {head + "element vertex 0\n" + xyz + "end_header\n", "holds no vertex"},
      {head + "element vertex 99999999999\n" + xyz + "end_header\n", "than the file can hold"},
      {head + "element vertex -1\n" + xyz + "end_header\n", "broken header line"},
      {head + "property float x\n", "outside an element"},
      {head + "element vertex 3\nproperty int128 x\n", "broken header line"},
      {head + "element vertex 3\n" + xyz + "end_header\n0 0 0\n1 nan 0\n0 1 0\n", "not a point"},
      {head + "element vertex 3\n" + xyz + "end_header\n0 0 0\n1 1e300 0\n0 1 0\n", "not a point"},
      {head + "element vertex 3\n" + xyz + "end_header\n0 0 0\n1 x 0\n0 1 0\n", "broken"},
      {head + "element vertex 3\n" + xyz + "element face 1\n" + face + three + "4 0 1 2 0\n",
       "triangles only"},
      {head + "element vertex 3\n" + xyz + "element face 1\n" + face + three + "3 0 1 3\n",
       "vertex is not there"},
      {head + "element vertex 3\n" + xyz + "element face 1\n" + face + three + "3 0 1 -1\n",
       "vertex is not there"},
      {head + "comment R1 2 0 0 0 1 0 0 0 1\n", "no rotation"},
      {head + "comment R1 1 0 0 0 1 0 0 0 -1\n", "no rotation"},
      {head + "comment R1 1 0 0\n", "broken R1"},
  };
  for (const auto& [bytes, expected] : cases) {
    const std::string said = refusal(bytes);
    EXPECT_NE(said.find(expected), std::string::npos) << expected << " / " << said;
    EXPECT_NE(said.find(path_), std::string::npos) << said;
  }
  EXPECT_THROW((void)read_mesh(path_ + ".none"), InputError);
  EXPECT_THROW((void)read_mesh(::testing::TempDir()), InputError);
}

TEST_F(MeshFile, ChangedBytesAreReadOrRefusedNeverWorse) {
  std::mt19937 random(1);
  std::string ascii =
      "ply\nformat ascii 1.0\ncomment R1 1 0 0 0 1 0 0 0 1\nelement vertex 3\nproperty float x\n"
      "property float y\nproperty float z\nelement face 1\nproperty list uchar int "
      "vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
  for (const std::string& good : {ply_bytes(tetrahedron()), stl_bytes(tetrahedron()), ascii})
    for (int i = 0; i < 300; ++i) {
      std::string bytes = good;
      for (unsigned k = 0; k <= random() % 3; ++k)
        bytes[random() % bytes.size()] = static_cast<char>(random());
      if (random() % 4 == 0) bytes.resize(random() % bytes.size());
      try {
        const TriangleMesh mesh = read(bytes);
        for (const auto& triangle : mesh.triangles)
          for (const auto corner : triangle) ASSERT_LT(corner, mesh.vertices_mm.size());
      } catch (const InputError&) {
        continue;  // refused
      }
    }
}

}  // namespace
}  // namespace holdfast::registration
