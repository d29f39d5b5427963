// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/renderer.hpp"

#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/aruco.hpp>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"
#include "tests/sim/or/relief_phantom.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

Eigen::Isometry3d looking_down(double tilt_rad, double focus_mm) {
  Eigen::Isometry3d T_ct_head = Eigen::Isometry3d::Identity();
  T_ct_head.rotate(Eigen::AngleAxisd(M_PI, Vector3d::UnitX()));
  T_ct_head.rotate(Eigen::AngleAxisd(tilt_rad, Vector3d(0.8, 0.6, 0)));
  T_ct_head.translate(Vector3d(0, 0, -focus_mm));
  return T_ct_head;
}

RoomShot shot_of(double zoom, double tilt_rad, const cv::Rect& region) {
  RoomShot shot;
  const Microscope microscope;
  shot.optics = microscope.at(zoom);
  shot.T_ct_head = looking_down(tilt_rad, shot.optics.focus_mm);
  shot.projector = make_projector(1, shot.optics.focus_mm);
  shot.region = region;
  return shot;
}

Vector2d seen_at(const RoomShot& shot, Side side, const Vector3d& p_ct) {
  const Vector3d p_head = shot.T_ct_head.inverse() * p_ct;
  return side == Side::left
             ? shot.optics.left.project(shot.optics.T_head_left.inverse() * p_head)
             : shot.optics.right.project(shot.optics.T_head_right.inverse() * p_head);
}

// Centroid of what is darker than the plane through the window's border.
Vector2d dark_centroid(const cv::Mat_<float>& light, const Vector2d& about, int reach) {
  const int x0 = static_cast<int>(std::lround(about.x())),
            y0 = static_cast<int>(std::lround(about.y()));
  const auto at = [&](int x, int y) { return static_cast<double>(light(y0 + y, x0 + x)); };
  double left = 0, right = 0, top = 0, bottom = 0;
  const int side = 2 * reach + 1;
  for (int i = -reach; i <= reach; ++i) {
    left += at(-reach, i) / side, right += at(reach, i) / side;
    top += at(i, -reach) / side, bottom += at(i, reach) / side;
  }
  const double level = (left + right + top + bottom) / 4;
  const double slope_x = (right - left) / (2 * reach), slope_y = (bottom - top) / (2 * reach);
  Vector2d sum = Vector2d::Zero();
  double weight = 0;
  for (int y = -reach; y <= reach; ++y)
    for (int x = -reach; x <= reach; ++x) {
      const double dark = level + slope_x * x + slope_y * y - at(x, y);
      sum += dark * Vector2d(x0 + x, y0 + y);
      weight += dark;
    }
  return sum / weight;
}

// Wider than any of the regions below.
LitSurface blank_plate() {
  LitSurface plate = make_dot_plate({}, 0.1, 1);
  plate.look.print = cv::Mat_<float>();
  for (Eigen::Vector3f& p : plate.vertices_mm) p *= 60;
  return plate;
}

constexpr int kX0 = 800, kY0 = 700;
const cv::Rect middle(kX0, kY0, 720, 560);

TEST(Renderer, PutsPrintedDotsWhereTheOpticsSeeThem) {
  std::vector<Vector2d> centres;
  for (int j = -2; j <= 2; ++j)
    for (int i = -3; i <= 3; ++i) centres.emplace_back(4.03 * i + 0.013 * j, 4.03 * j);
  Renderer renderer({make_dot_plate(centres, 0.8, 20)}, Vector3d::UnitZ());
  for (const double tilt : {0.0, 0.35}) {
    RoomShot shot = shot_of(1.3, tilt, middle);
    shot.lights.microscope_light = 0;
    shot.lights.or_light = 1;
    for (const Side side : {Side::left, Side::right}) {
      const cv::Mat_<float> light = renderer.light(shot, side);
      double worst = 0;
      for (const Vector2d& centre : centres) {
        const Vector2d expected =
            seen_at(shot, side, {centre.x(), centre.y(), 0}) - Vector2d(kX0, kY0);
        if (expected.minCoeff() < 25 || expected.x() > 690 || expected.y() > 530) continue;
        worst = std::max(worst, (dark_centroid(light, expected, 18) - expected).norm());
      }
      EXPECT_GT(worst, 0);
      EXPECT_LT(worst, 0.02) << tilt;
    }
  }
}

TEST(Renderer, ThePostShadesThePatternOnItsFarSide) {
  Renderer renderer(make_relief_phantom(1).surfaces, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.1, 0, cv::Rect(1200, 900, 500, 350));
  shot.lights.or_light = shot.lights.microscope_light = 0;
  shot.lights.pattern = cv::Mat(600, 800, CV_8U, cv::Scalar(255));
  const cv::Mat_<float> light = renderer.light(shot, Side::left);
  // The projector is at the left of the head: the post, at (14, -4), darkens what is to its right.
  const auto brightness = [&](double x, double y) {
    const Vector2d pixel = seen_at(shot, Side::left, {x, y, 1.5}) - Vector2d(1200, 900);
    return light(static_cast<int>(pixel.y()), static_cast<int>(pixel.x()));
  };
  EXPECT_GT(brightness(7.5, -4), 20);
  EXPECT_LT(brightness(20.3, -4), 0.2F * brightness(7.5, -4));
}

TEST(Renderer, ThePostHidesFromOneCameraWhatTheOtherSees) {
  const Renderer renderer(make_relief_phantom(1).surfaces, Vector3d::UnitZ());
  const RoomShot shot = shot_of(1.1, 0, {});
  const Eigen::Isometry3d T_ct_left = shot.T_ct_head * shot.optics.T_head_left;
  const Eigen::Isometry3d T_ct_right = shot.T_ct_head * shot.optics.T_head_right;
  const auto p = renderer.first_hit(
      shot.optics.right.sight_line(seen_at(shot, Side::right, {20.2, -4, 0.5})), T_ct_right);
  ASSERT_TRUE(p.has_value());
  EXPECT_LT(p->z(), 3);
  const auto hidden_by =
      renderer.first_hit(shot.optics.left.sight_line(seen_at(shot, Side::left, *p)), T_ct_left);
  ASSERT_TRUE(hidden_by.has_value());
  EXPECT_GT(hidden_by->z(), p->z() + 1);
}

TEST(Renderer, DepthIsThatOfTheFirstSurfaceAlongTheLineOfSight) {
  Renderer renderer(make_relief_phantom(1).surfaces, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.1, 0.2, cv::Rect(1000, 900, 160, 120));
  shot.lights.or_light = 0;
  const Geometry geometry = renderer.geometry(shot, Side::right);
  const Eigen::Isometry3d T_ct_right = shot.T_ct_head * shot.optics.T_head_right;
  for (int y = 0; y < 120; y += 13)
    for (int x = 0; x < 160; x += 17) {
      const auto p =
          renderer.first_hit(shot.optics.right.sight_line({1000.0 + x, 900.0 + y}), T_ct_right);
      ASSERT_TRUE(p.has_value());
      EXPECT_NEAR(static_cast<double>(geometry.depth_mm(y, x)), (T_ct_right.inverse() * *p).z(),
                  5e-3);
    }
}

TEST(Renderer, MarkersReadAsWhatTheyAre) {
  const Phantom phantom = make_relief_phantom(1);
  Renderer renderer(phantom.surfaces, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.1, 0.05, {});
  shot.lights.or_light = 0;
  for (const TrueMarker& marker : phantom.markers) {
    const Vector2d centre = seen_at(shot, Side::left, marker.T_ct_marker.translation());
    const cv::Point corner(static_cast<int>(centre.x()) - 130, static_cast<int>(centre.y()) - 130);
    shot.region = cv::Rect(corner, cv::Size(260, 260));
    std::vector<int> ids;
    std::vector<std::vector<cv::Point2f>> corners;
    cv::aruco::detectMarkers(renderer.image(shot, Side::left),
                             cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50), corners,
                             ids);
    ASSERT_EQ(ids, std::vector<int>{marker.aruco_id});
    const double half = 0.5 * marker.side_mm;  // the first corner is the upper left one
    const Vector2d expected =
        seen_at(shot, Side::left, marker.T_ct_marker * Vector3d(-half, half, 0));
    const Vector2d found(corner.x + static_cast<double>(corners[0][0].x),
                         corner.y + static_cast<double>(corners[0][0].y));
    EXPECT_LT((expected - found).norm(), 2);
  }
}

TEST(Renderer, BothCamerasSeeTheSameTexture) {
  // Light of a surface point, found in both images where the optics say, agrees but for exposure.
  Renderer renderer({make_relief_phantom(2).surfaces.front()}, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.3, 0, middle);
  shot.lights.microscope_light = 0;
  shot.lights.or_light = 1;
  const cv::Mat_<float> left = renderer.light(shot, Side::left);
  const cv::Mat_<float> right = renderer.light(shot, Side::right);
  const Eigen::Isometry3d T_ct_left = shot.T_ct_head * shot.optics.T_head_left;
  std::vector<double> a, b;
  for (int y = 200; y < 450; y += 7)
    for (int x = 200; x < 500; x += 7) {
      const auto p = renderer.first_hit(shot.optics.left.sight_line({kX0 + x, kY0 + y}), T_ct_left);
      ASSERT_TRUE(p.has_value());
      const Vector2d q = seen_at(shot, Side::right, *p) - Vector2d(kX0, kY0);
      const int ix = static_cast<int>(q.x()), iy = static_cast<int>(q.y());
      const double fx = q.x() - ix, fy = q.y() - iy;
      const auto at = [&](int i, int j) { return static_cast<double>(right(iy + j, ix + i)); };
      a.push_back(static_cast<double>(left(y, x)));
      b.push_back((1 - fy) * ((1 - fx) * at(0, 0) + fx * at(1, 0)) +
                  fy * ((1 - fx) * at(0, 1) + fx * at(1, 1)));
    }
  double ma = 0, mb = 0, saa = 0, sbb = 0, sab = 0;
  for (std::size_t i = 0; i < a.size(); ++i) ma += a[i], mb += b[i];
  ma /= static_cast<double>(a.size()), mb /= static_cast<double>(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    saa += (a[i] - ma) * (a[i] - ma);
    sbb += (b[i] - mb) * (b[i] - mb);
    sab += (a[i] - ma) * (b[i] - mb);
  }
  EXPECT_GT(sab / std::sqrt(saa * sbb), 0.99);
  EXPECT_GT(std::abs(ma / mb - 1), 0.01);  // the exposures differ
}

TEST(Renderer, AlbedoVariesAsTheLookSays) {
  LitSurface plate = blank_plate();
  plate.look.texture_contrast = 0.1F;
  plate.look.texture_mm = 0.5F;
  Renderer renderer({plate}, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.3, 0, cv::Rect(kX0, kY0, 360, 240));
  shot.lights.microscope_light = 0;
  shot.lights.or_light = 1;
  cv::Scalar mean, deviation;
  cv::meanStdDev(renderer.light(shot, Side::left), mean, deviation);
  EXPECT_NEAR(deviation[0] / mean[0], 0.1, 0.02);
}

TEST(Renderer, NoiseIsThatOfTheSensor) {
  const LitSurface plate = blank_plate();
  Renderer renderer({plate}, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.3, 0, cv::Rect(kX0, kY0, 360, 240));
  shot.lights.microscope_light = 0;
  shot.lights.or_light = 1;
  shot.sensor.exposure = 0.7;
  shot.sensor.read_noise_dn = 2;
  shot.sensor.shot_noise_dn = 0.2;
  cv::Mat noisy;
  renderer.image(shot, Side::left).convertTo(noisy, CV_32F);
  const cv::Mat light = renderer.light(shot, Side::left);
  cv::Scalar mean, deviation;
  cv::meanStdDev(noisy - light, mean, deviation);
  const double level = cv::mean(light)[0];
  EXPECT_NEAR(mean[0], 0, 0.03);
  EXPECT_NEAR(deviation[0], std::sqrt(4 + 0.04 * level + 1.0 / 12), 0.05);
}

TEST(Renderer, SameShotSameBytesOtherSeedOtherNoise) {
  Renderer renderer(make_relief_phantom(1).surfaces, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.2, 0.1, cv::Rect(kX0, kY0, 240, 180));
  shot.lights.or_light = 0;
  const cv::Mat first = renderer.image(shot, Side::left);
  EXPECT_EQ(cv::norm(first, renderer.image(shot, Side::left), cv::NORM_INF), 0);
  shot.seed = 2;
  EXPECT_GT(cv::norm(first, renderer.image(shot, Side::left), cv::NORM_INF), 0);
}

TEST(Renderer, BlursWhatIsOutOfFocus) {
  Renderer renderer({make_dot_plate({{0, 0}}, 2, 26)}, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.3, 0, middle);
  shot.lights.microscope_light = 0;
  shot.lights.or_light = 1;
  const auto steepest = [&] {
    const cv::Mat_<float> light = renderer.light(shot, Side::left);
    const cv::Mat step = light.colRange(1, light.cols) - light.colRange(0, light.cols - 1);
    return cv::norm(step, cv::NORM_INF);
  };
  const double sharp = steepest();
  shot.T_ct_head.translate(Vector3d(0, 0, -15));
  EXPECT_LT(steepest(), 0.75 * sharp);
}

TEST(Renderer, ScatterSoftensThePattern) {
  LitSurface plate = blank_plate();
  Renderer renderer({plate}, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.3, 0, cv::Rect(kX0, kY0, 300, 240));
  shot.lights.or_light = shot.lights.microscope_light = 0;
  shot.lights.pattern = diffractive_dots(1, 6000, 0.5, shot.projector);
  const auto contrast = [&](double scatter_mm) {
    shot.lights.scatter_mm = scatter_mm;
    cv::Scalar mean, deviation;
    cv::meanStdDev(renderer.light(shot, Side::left), mean, deviation);
    return std::pair{deviation[0] / mean[0], mean[0]};
  };
  const auto [clear, clear_mean] = contrast(0);
  const auto [soft, soft_mean] = contrast(0.3);
  EXPECT_LT(soft, 0.7 * clear);
  EXPECT_NEAR(soft_mean / clear_mean, 1, 0.03);  // light is spread, not lost
}

TEST(Renderer, PatternFallsWhereTheProjectorSendsIt) {
  LitSurface plate = blank_plate();
  Renderer renderer({plate}, Vector3d::UnitZ());
  RoomShot shot = shot_of(1.3, 0, middle);
  shot.lights.or_light = shot.lights.microscope_light = 0;
  // One dark square around a projector pixel whose ray is known.
  const Vector3d p_ct(1.5, -1, 0);
  const Vector2d at = shot.projector.project(shot.T_ct_head.inverse() * p_ct);
  shot.lights.pattern = cv::Mat(600, 800, CV_8U, cv::Scalar(255));
  const Vector2d whole(std::round(at.x()), std::round(at.y()));
  cv::rectangle(shot.lights.pattern,
                cv::Rect(static_cast<int>(whole.x()) - 1, static_cast<int>(whole.y()) - 1, 3, 3),
                cv::Scalar(0), cv::FILLED);
  const Vector2d expected = seen_at(shot, Side::left, p_ct) - Vector2d(kX0, kY0);
  const Vector2d found = dark_centroid(renderer.light(shot, Side::left), expected, 24);
  const double px_per_projector_px = 0.16 * shot.optics.left.focal_px() / shot.optics.focus_mm;
  EXPECT_LT((found - expected).norm(), px_per_projector_px * ((at - whole).norm() + 0.05));
}

// Rays are saved only where they would change nothing: a post throws its shadow across the relief.
TEST(Renderer, SavedShadowRaysChangeLessThanTheNoise) {
  RoomShot shot = shot_of(1.3, 0.1, middle);
  Phantom relief = make_relief_phantom(2);
  Renderer renderer(relief.surfaces, relief.n_view_ct);
  shot.T_ct_head = Eigen::Isometry3d::Identity();
  const Vector3d z = -relief.n_view_ct.normalized(), x = relief.x_view_ct.normalized();
  shot.T_ct_head.translation() = relief.p_focus_ct_mm;
  shot.T_ct_head.linear() << x, z.cross(x), z;
  shot.T_ct_head.translate(Vector3d(0, 0, -shot.optics.focus_mm));
  for (const bool has_pattern : {false, true}) {
    shot.lights.or_light = 0;
    shot.lights.microscope_light = has_pattern ? 0 : 1;
    if (has_pattern) shot.lights.pattern = diffractive_dots(1, 6000, 0.5, shot.projector);
    shot.rays = Rays::all;
    const cv::Mat all = renderer.light(shot, Side::left);
    shot.rays = Rays::where_needed;
    const cv::Mat some = renderer.light(shot, Side::left);
    cv::Mat difference;
    cv::absdiff(all, some, difference);
    double worst = 0;
    cv::minMaxLoc(difference, nullptr, &worst);
    const double sigma_dn = 1.5;  // of the sensor at a quarter of its range
    EXPECT_LT(cv::mean(difference)[0], 0.02 * sigma_dn);
    EXPECT_LT(cv::countNonZero(difference > sigma_dn), 0.002 * static_cast<double>(all.total()))
        << "worst " << worst;
    EXPECT_GT(cv::mean(all)[0], 5);  // there is light
  }
}

TEST(Renderer, RefusesSurfacesThatDoNotFitTogether) {
  LitSurface plate = make_dot_plate({}, 0.1, 10);
  plate.triangles.push_back({0, 1, 99});
  EXPECT_THROW(Renderer({plate}, Vector3d::UnitZ()), InputError);
}

}  // namespace
}  // namespace holdfast::sim
