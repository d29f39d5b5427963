// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/lit_scene.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>
#include <tbb/parallel_for.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3f;

static_assert(sizeof(Vector3f) == sizeof(kernel::Vec3));
static_assert(sizeof(Eigen::Vector2f) == 2 * sizeof(float));

const kernel::Vec3* as_kernel(const std::vector<Vector3f>& v) {
  return reinterpret_cast<const kernel::Vec3*>(v.data());
}

void check(const LitSurface& s, std::size_t index) {
  const std::size_t n = s.vertices_mm.size();
  if (s.normals.size() != n || (!s.uv.empty() && s.uv.size() != n))
    throw InputError(fmt::format("surface {}: {} vertices, {} normals, {} uv", index, n,
                                 s.normals.size(), s.uv.size()));
  for (const auto& triangle : s.triangles)
    for (const std::uint32_t vertex : triangle)
      if (vertex >= n)
        throw InputError(
            fmt::format("surface {}: a triangle names vertex {} of {}", index, vertex, n));
}

// Millimetres a texel of the print, from the first triangle that has an extent.
double texel_mm(const LitSurface& s) {
  for (const auto& t : s.triangles) {
    const double length = static_cast<double>((s.vertices_mm[t[1]] - s.vertices_mm[t[0]]).norm());
    const Eigen::Vector2f uv = s.uv[t[1]] - s.uv[t[0]];
    const double texels = std::hypot(static_cast<double>(uv.x()) * s.look.print.cols,
                                     static_cast<double>(uv.y()) * s.look.print.rows);
    if (length > 0 && texels > 0) return length / texels;
  }
  return 0;
}

// Ink ends within a few hundredths of a millimetre, however coarse the print was given.
cv::Mat_<float> fine_print(const LitSurface& s) {
  constexpr double kFineMm = 0.02;
  cv::Mat_<float> print = s.look.print.clone();
  const int factor = std::clamp(static_cast<int>(std::lround(texel_mm(s) / kFineMm)), 1,
                                std::max(1, 8192 / std::max(print.cols, print.rows)));
  if (factor > 1) cv::resize(print, print, {}, factor, factor, cv::INTER_NEAREST);
  return print;
}

struct Direction {
  Vector3f n;
  float weight;
};

// The sky of the room: two lamps beside the microscope, walls all around, nothing where the
// microscope's head is. Scaled so that a plate facing up receives 1.
std::vector<Direction> room_light(const Vector3f& up) {
  const Vector3f side = up.unitOrthogonal(), other = up.cross(side);
  std::vector<Direction> sky;
  const auto add = [&](float polar, float azimuth, float weight) {
    const Vector3f n = std::cos(polar) * up +
                       std::sin(polar) * (std::cos(azimuth) * side + std::sin(azimuth) * other);
    sky.push_back({n, weight});
  };
  const auto golden = static_cast<float>(std::numbers::pi * (3 - std::sqrt(5.0)));
  constexpr int kWalls = 40, kLamp = 12;
  for (int i = 0; i < kWalls; ++i) {
    const float height = (static_cast<float>(i) + 0.5F) / kWalls;  // uniform in solid angle
    const float polar = std::acos(height);
    if (polar > 0.25F) add(polar, golden * static_cast<float>(i), 0.6F / kWalls);
  }
  for (const float azimuth : {0.6F, 3.4F})
    for (int i = 0; i < kLamp; ++i) {
      const float r = 0.22F * std::sqrt((static_cast<float>(i) + 0.5F) / kLamp);
      const float a = golden * static_cast<float>(i);
      add(0.65F + r * std::cos(a), azimuth + r * std::sin(a) / 0.6F, 0.35F / kLamp);
    }
  float total = 0;
  for (const Direction& d : sky) total += d.weight * std::max(0.F, d.n.dot(up));
  for (Direction& d : sky) d.weight /= total;
  return sky;
}

float received(RTCScene scene, const std::vector<Direction>& sky, const Vector3f& p,
               const Vector3f& n) {
  constexpr std::size_t kLanes = kernel::kLanes;
  const Vector3f from = p + 0.05F * n;
  float sum = 0;
  for (std::size_t start = 0; start < sky.size(); start += kLanes) {
    alignas(64) int valid[kLanes];
    RTCRay16 ray;
    for (std::size_t i = 0; i < kLanes; ++i) {
      const bool is_used = start + i < sky.size() && sky[start + i].n.dot(n) > 0;
      const Vector3f d = is_used ? sky[start + i].n : Vector3f(0, 0, 1);
      valid[i] = is_used ? -1 : 0;
      ray.org_x[i] = from.x(), ray.org_y[i] = from.y(), ray.org_z[i] = from.z();
      ray.dir_x[i] = d.x(), ray.dir_y[i] = d.y(), ray.dir_z[i] = d.z();
      ray.tnear[i] = 0, ray.tfar[i] = 500, ray.time[i] = 0;
      ray.mask[i] = ~0U, ray.id[i] = 0, ray.flags[i] = 0;
    }
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded16(valid, scene, &context, &ray);
    for (std::size_t i = 0; i < kLanes; ++i)
      if (valid[i] != 0 && ray.tfar[i] > 0) sum += sky[start + i].weight * sky[start + i].n.dot(n);
  }
  return sum;
}

}  // namespace

LitScene::LitScene(std::vector<LitSurface> surfaces, const Eigen::Vector3d& n_up_ct)
    : surfaces_(std::move(surfaces)),
      n_up_ct_(n_up_ct.normalized().cast<float>()),
      or_irradiance_(surfaces_.size()),
      prints_(surfaces_.size()) {
  for (std::size_t i = 0; i < surfaces_.size(); ++i) check(surfaces_[i], i);
  device_ = rtcNewDevice(nullptr);
  if (device_ == nullptr) throw UnavailableError("Embree cannot be started");
  scene_ = rtcNewScene(device_);
  rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_HIGH);
  rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
  for (std::size_t i = 0; i < surfaces_.size(); ++i) add(i);
  rtcCommitScene(scene_);
  make_table();
}

LitScene::~LitScene() {
  rtcReleaseScene(scene_);
  rtcReleaseDevice(device_);
}

void LitScene::add(std::size_t index) {
  LitSurface& s = surfaces_[index];
  // Embree reads 16 bytes at the last vertex.
  s.vertices_mm.reserve(s.vertices_mm.size() + 1);
  RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                             s.vertices_mm.data(), 0, sizeof(Vector3f), s.vertices_mm.size());
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                             s.triangles.data(), 0, 3 * sizeof(std::uint32_t), s.triangles.size());
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(scene_, geometry, static_cast<unsigned>(index));
  rtcReleaseGeometry(geometry);

  or_irradiance_[index].assign(s.vertices_mm.size(), 0);
  kernel::Surface k{};
  k.vertices = as_kernel(s.vertices_mm);
  k.normals = as_kernel(s.normals);
  k.triangles = s.triangles.empty() ? nullptr : s.triangles.front().data();
  k.or_irradiance = or_irradiance_[index].data();
  k.albedo_visible = s.look.albedo_visible;
  k.albedo_nir = s.look.albedo_nir;
  k.specular = s.look.specular;
  k.roughness = s.look.roughness;
  k.texture_contrast = s.look.texture_contrast;
  k.texture_per_mm = 1 / std::max(0.01F, s.look.texture_mm);
  if (!s.look.print.empty() && !s.uv.empty()) {
    prints_[index] = fine_print(s);
    k.uv = s.uv.front().data();
    k.print = {prints_[index].ptr<float>(), prints_[index].cols, prints_[index].rows};
  }
  kernel_surfaces_.push_back(k);
}

void LitScene::make_table() {
  constexpr std::size_t kSize = kernel::kTableSize;
  std::mt19937 random{20'231};
  table_.resize(kSize * kSize * kSize);
  // Interpolating uniform deviates leaves on average 181/231 of their variance along each axis.
  constexpr double kInterpolated = (181.0 / 231) * (181.0 / 231) * (181.0 / 231);
  const double half_width = std::sqrt(3.0 / kInterpolated);
  for (float& value : table_)
    value = static_cast<float>(half_width *
                               (2 * (static_cast<double>(random()) + 0.5) / 4294967296.0 - 1));
}

void LitScene::light_up() {
  if (is_lit_) return;
  const std::vector<Direction> sky = room_light(n_up_ct_);
  for (std::size_t i = 0; i < surfaces_.size(); ++i) {
    const LitSurface& s = surfaces_[i];
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, s.vertices_mm.size(), 256),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        for (std::size_t v = range.begin(); v < range.end(); ++v)
                          or_irradiance_[i][v] =
                              received(scene_, sky, s.vertices_mm[v], s.normals[v]);
                      });
  }
  is_lit_ = true;
}

}  // namespace holdfast::sim
