// SPDX-License-Identifier: Apache-2.0
// A drawn site of known shape, a reconstruction of parts of it, and each reason in its place.
#include "registration/coverage_map.hpp"

#include <cmath>
#include <limits>
#include <sstream>

#include <gtest/gtest.h>

#include "registration/depth_raster.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

const Eigen::Isometry3d kCameraCt = Eigen::Translation3d{3, -4, 180} *
                                    Eigen::AngleAxisd{0.4, Eigen::Vector3d{1, 2, 3}.normalized()};
const Eigen::Matrix3d kR1 = Eigen::AngleAxisd{0.06, Eigen::Vector3d::UnitY()}.toRotationMatrix();

/// 20 px/mm at 200 mm: 800 x 600 px show 40 x 30 mm; the cameras are 24 mm apart.
ReconstructedView view() {
  ReconstructedView v;
  v.size_px = {800, 600};
  v.region_px = {0, 0, 800, 600};
  v.focal_px = 4000;
  v.cx_px = 400;
  v.cy_px = 300;
  v.cx_right_px = 400 + 480;  // toed in: what lies at 200 mm has no disparity
  v.baseline_mm = 24;
  v.nearest_mm = 150;
  v.farthest_mm = 250;
  return v;
}

/// A sheet in the rectified frame, triangles towards the camera: columns from x0 to x1, rows from
/// y0 to y1, `depth_mm` of both; what has no finite depth is left out.
template <typename Depth>
TriangleMesh sheet(double x0, double x1, double y0, double y1, double step, const Depth& depth_mm) {
  TriangleMesh mesh;
  const auto nx = static_cast<std::uint32_t>(std::lround((x1 - x0) / step)) + 1,
             ny = static_cast<std::uint32_t>(std::lround((y1 - y0) / step)) + 1;
  for (std::uint32_t j = 0; j < ny; ++j)
    for (std::uint32_t i = 0; i < nx; ++i) {
      const double x = x0 + step * i, y = y0 + step * j;
      mesh.vertices_mm.emplace_back(static_cast<float>(x), static_cast<float>(y),
                                    static_cast<float>(depth_mm(x, y)));
    }
  const auto is_known = [&](std::uint32_t k) { return std::isfinite(mesh.vertices_mm[k].z()); };
  for (std::uint32_t j = 0; j + 1 < ny; ++j)
    for (std::uint32_t i = 0; i + 1 < nx; ++i) {
      const std::uint32_t a = j * nx + i, b = a + nx;
      if (!is_known(a) || !is_known(a + 1) || !is_known(b) || !is_known(b + 1)) continue;
      mesh.triangles.push_back({a, b, a + 1});
      mesh.triangles.push_back({a + 1, b, b + 1});
    }
  for (Eigen::Vector3f& v : mesh.vertices_mm)
    if (!v.allFinite()) v = Eigen::Vector3f::Zero();
  return mesh;
}

void append(TriangleMesh& to, const TriangleMesh& more) {
  const auto base = static_cast<std::uint32_t>(to.vertices_mm.size());
  to.vertices_mm.insert(to.vertices_mm.end(), more.vertices_mm.begin(), more.vertices_mm.end());
  for (const auto& [a, b, c] : more.triangles)
    to.triangles.push_back({a + base, b + base, c + base});
}

TriangleMesh in_ct(TriangleMesh mesh) {
  Eigen::Isometry3d T_rectified_camera = Eigen::Isometry3d::Identity();
  T_rectified_camera.linear() = kR1;
  const Eigen::Isometry3d T_ct_rectified = (T_rectified_camera * kCameraCt).inverse();
  for (Eigen::Vector3f& v : mesh.vertices_mm) v = (T_ct_rectified * v.cast<double>()).cast<float>();
  return mesh;
}

/// The site: a plain at 200 mm; a slope too steep to be matched at x = 10 … 11; a plate 8 mm above
/// the plain at x = -14 … -8; and the underside of the plain, 5 mm below it.
TriangleMesh site() {
  TriangleMesh mesh = sheet(-24, 24, -17, 17, 0.5, [](double x, double) {
    return x > 11 ? 196 : x > 10 ? 200 - 4 * (x - 10) : 200.0;
  });
  append(mesh, sheet(-14, -8, -17, 17, 0.5, [](double, double) { return 192.0; }));
  TriangleMesh below = sheet(-24, 24, -17, 17, 0.5, [](double, double) { return 205.0; });
  for (auto& triangle : below.triangles) std::swap(triangle[1], triangle[2]);
  append(mesh, below);
  return mesh;
}

/// What was reconstructed of it: nothing in the square x, y = 0 … 4 (unmatched), nothing for
/// x = 4 … 8, y = 0 … 4 (uncertain) and for x = 0 … 4, y = 4 … 8 (repeating), 3 mm too near for
/// x = 0 … 4, y = -8 … -4; 0.1 mm too far everywhere else; the slope is missing.
double found_mm(double x, double y) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  if (x >= 0 && x <= 8 && y >= 0 && y <= 4) return kNone;
  if (x >= 0 && x <= 4 && y >= 4 && y <= 8) return kNone;
  if (x > 9.6 && x < 11.4) return kNone;
  if (x > -13.9 && x < -8.1) return 192.1;
  if (x > -15.8 && x < -7.7) return kNone;  // hidden from one camera, or a depth edge
  if (x >= 0 && x <= 4 && y >= -8 && y <= -4) return 197;
  return x > 11 ? 196.1 : 200.1;
}

TriangleMesh found() {
  TriangleMesh mesh = sheet(-22, 22, -16, 16, 0.2, found_mm);
  mesh.R_rectified_camera = kR1;
  return mesh;
}

cv::Mat1b reasons() {
  cv::Mat1b image(view().size_px, static_cast<uchar>(PixelReason::unmatched));
  const auto set = [&image](double x, double y, PixelReason reason) {
    image(cv::Rect(static_cast<int>(400 + 20 * x), static_cast<int>(300 + 20 * y), 80, 80)) =
        static_cast<uchar>(reason);
  };
  set(4, 0, PixelReason::uncertain);
  set(0, 4, PixelReason::repeating);
  return image;
}

class CoverageMapTest : public testing::Test {
 protected:
  /// Of the triangle that is nearest to this point of the rectified frame.
  [[nodiscard]] Coverage at(double x, double y, double z) const {
    std::size_t nearest = 0;
    double least = 1e9;
    for (std::size_t i = 0; i < site_.triangles.size(); ++i) {
      const auto& [a, b, c] = site_.triangles[i];
      const Eigen::Vector3f middle =
          (site_.vertices_mm[a] + site_.vertices_mm[b] + site_.vertices_mm[c]) / 3;
      const double d = (middle.cast<double>() - Eigen::Vector3d(x, y, z)).norm();
      if (d >= least) continue;
      least = d;
      nearest = i;
    }
    return map_.triangles[nearest];
  }

  const TriangleMesh site_ = site();
  const CoverageMap map_ =
      coverage_map(in_ct(site_), kCameraCt, found(), view(), reasons(), CoverageOptions{});
};

TEST_F(CoverageMapTest, NamesEachReasonWhereItIs) {
  EXPECT_EQ(name(at(-2, -10, 200)), "covered");
  EXPECT_EQ(name(at(15, 3, 196)), "covered");
  EXPECT_EQ(name(at(-11, 3, 192)), "covered") << "the plate";
  EXPECT_EQ(name(at(-11, 3, 200)), "occluded") << "below the plate";
  EXPECT_EQ(name(at(-2, -10, 205)), "facing_away");
  EXPECT_EQ(name(at(10.5, 2, 198)), "steep");
  EXPECT_EQ(name(at(2, 2, 200)), "unmatched");
  EXPECT_EQ(name(at(6, 2, 200)), "uncertain");
  EXPECT_EQ(name(at(2, 6, 200)), "repeating");
  EXPECT_EQ(name(at(2, -6, 200)), "disagrees");
  EXPECT_EQ(name(at(22, 0, 196)), "outside_view");
  EXPECT_EQ(name(at(0, 16.5, 200)), "outside_view");
}

/// The right camera sees past the plate's other side.
TEST_F(CoverageMapTest, HiddenFromOneCameraIsOccluded) {
  EXPECT_EQ(name(at(-7.4, 0, 200)), "covered") << "seen by both";
  EXPECT_EQ(name(at(-14.6, 0, 200)), "occluded") << "hidden from the right camera";
}

TEST_F(CoverageMapTest, SumsAreAreas) {
  const auto area = [this](Coverage c) { return map_.area_mm2.at(static_cast<std::size_t>(c)); };
  EXPECT_NEAR(area(Coverage::uncertain), 16, 5);
  EXPECT_NEAR(area(Coverage::repeating), 16, 5);
  EXPECT_GT(area(Coverage::unmatched), 14) << "a square like these, and the ragged ends elsewhere";
  EXPECT_NEAR(area(Coverage::disagrees), 10, 6) << "of 16 mm2, less what is near its ragged ends";
  double all = 0, visible = 0;
  for (std::size_t k = 0; k < kCoverages; ++k) {
    all += map_.area_mm2.at(k);
    if (k > static_cast<std::size_t>(Coverage::occluded)) visible += map_.area_mm2.at(k);
  }
  EXPECT_NEAR(all, 2 * 48 * 34 + 6 * 34 + (std::sqrt(17.0) - 1) * 34, 1);
  EXPECT_DOUBLE_EQ(map_.visible_mm2, visible);
  EXPECT_DOUBLE_EQ(map_.covered_share, area(Coverage::covered) / visible);
  EXPECT_NEAR(map_.agreement_mean_mm, 0.1, 0.01);
  EXPECT_NEAR(map_.agreement_rms_mm, 0.1, 0.03);
}

TEST_F(CoverageMapTest, WithoutAnAccountWhatIsNotKnownIsUnmatched) {
  const CoverageMap plain =
      coverage_map(in_ct(site_), kCameraCt, found(), view(), {}, CoverageOptions{});
  const auto uncertain = static_cast<std::size_t>(Coverage::uncertain);
  EXPECT_GT(map_.area_mm2.at(uncertain), 0);
  EXPECT_EQ(plain.area_mm2.at(uncertain), 0);
  EXPECT_DOUBLE_EQ(plain.covered_share, map_.covered_share);
}

TEST_F(CoverageMapTest, FileShowsTheFacesInView) {
  const std::string bytes = coverage_ply(site_, map_);
  std::istringstream lines(bytes.substr(0, 1000));
  std::size_t faces = 0;
  for (std::string line; std::getline(lines, line) && line != "end_header";)
    if (line.rfind("element face ", 0) == 0) faces = std::stoul(line.substr(13));
  const auto header = bytes.find("end_header\n") + 11;
  EXPECT_EQ(bytes.size(), header + 12 * site_.vertices_mm.size() + 17 * faces);
  EXPECT_LT(faces, site_.triangles.size());
  EXPECT_GT(faces, site_.triangles.size() / 2);
}

TEST(ReconstructedView, IsReadBackAsWrittenAndRefusedWhenBroken) {
  TriangleMesh mesh;
  EXPECT_FALSE(view_of(mesh));
  mesh.comments = {"image_repetition 0.1", view().comment()};
  const auto read = view_of(mesh);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->comment(), view().comment());
  EXPECT_EQ(read->farthest_mm, 250);
  mesh.comments[1].resize(mesh.comments[1].size() - 4);  // the last number is gone
  EXPECT_THROW((void)view_of(mesh), InputError);
  ReconstructedView elsewhere = view();
  elsewhere.region_px.x = 700;
  mesh.comments[1] = elsewhere.comment();
  EXPECT_THROW((void)view_of(mesh), InputError);
}

TEST(RasterDepth, ShowsTheNearestSurface) {
  RasterCamera camera{100, 50, 40, 0, {100, 80}, 2};
  TriangleMesh near = sheet(-10, 0, -50, 50, 5, [](double x, double) { return 60 + x; });
  const TriangleMesh far = sheet(-50, 50, -50, 50, 10, [](double, double) { return 80.0; });
  append(near, far);
  std::vector<Eigen::Vector3d> points;
  for (const Eigen::Vector3f& v : near.vertices_mm) points.push_back(v.cast<double>());
  const cv::Mat1f depth = raster_depth(points, near.triangles, camera);
  ASSERT_EQ(depth.size(), cv::Size(50, 40));
  const Eigen::Vector2d cell = camera.cell_of({-5, 10, 55});
  const auto here =
      depth(static_cast<int>(std::lround(cell.y())), static_cast<int>(std::lround(cell.x())));
  EXPECT_NEAR(here, 55, 0.7);
  EXPECT_NEAR(depth(20, 40), 80, 1e-3);
  camera.centre_x_mm = 1000;
  const cv::Mat1f nothing = raster_depth(points, near.triangles, camera);
  EXPECT_TRUE(std::isnan(nothing(20, 20)));
}

}  // namespace
}  // namespace holdfast::registration
