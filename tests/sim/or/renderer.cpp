// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgproc.hpp>
#include <tbb/parallel_for.h>

#include "tests/sim/or/frame_setup.hpp"
#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/lit_scene.hpp"
#include "tests/sim/or/point_spread.hpp"
#include "tests/sim/or/region_tracer.hpp"
#include "tests/sim/or/scatter.hpp"
#include "tests/sim/or/sensor_noise.hpp"

namespace holdfast::sim {
namespace {

using kernel::kLanes;
using kernel::Samples;

constexpr int kBlock = 4;  // a packet is 4x4 pixels
constexpr float kDepthJumpMm = 0.2F;

// Light, a value a pixel, in arrays that are kept from frame to frame.
struct Buffers : Seen {
  cv::Mat_<float> light, nir, variance;

  void resize(cv::Size size) {
    for (cv::Mat_<float>* m : {&light, &nir, &variance}) m->create(size);
  }
};

// Each 4x4 pixels have cast their shadow rays to the sixteen points of a source: any 5x5 of them,
// weighted so that every point counts the same, see the source as a whole.
void combine(Buffers& b) {
  const kernel::Kernel& k = kernel::best_kernel();
  tbb::parallel_for(0, b.base.rows, [&](int y) {
    const std::uint8_t *light_rows[5], *projector_rows[5];
    for (int i = 0; i < 5; ++i) {
      const int row = std::clamp(y + i - 2, 0, b.base.rows - 1);
      light_rows[i] = b.sees_light[row] + Seen::kMargin;
      projector_rows[i] = b.sees_projector[row] + Seen::kMargin;
    }
    k.combine(b.base[y], b.microscope[y], b.irradiance[y], light_rows, projector_rows, b.base.cols,
              b.light[y], b.nir[y]);
  });
}

// A surface ends between two pixels where another begins, or where the depth jumps by more than
// its slope on either side explains: steep is not torn.
bool is_torn(float before, float here, float next, float beyond) {
  const float step = next - here;
  return std::abs(step) > kDepthJumpMm && std::abs(step - (here - before)) > kDepthJumpMm &&
         std::abs(step - (beyond - next)) > kDepthJumpMm;
}

// Marks both pixels of every such pair; `is_edge` is all zeros and one row.
void find_edges(const Buffers& b, int y, std::uint8_t* is_edge) {
  const int last = b.base.cols - 1, bottom = b.base.rows - 1;
  const std::int16_t* surface = b.surface[y];
  const float* depth = b.depth[y];
  for (int x = 0; x < last; ++x) {
    const bool ends =
        surface[x] != surface[x + 1] ||
        is_torn(depth[std::max(x - 1, 0)], depth[x], depth[x + 1], depth[std::min(x + 2, last)]);
    is_edge[x] = static_cast<std::uint8_t>(is_edge[x] | static_cast<std::uint8_t>(ends));
    is_edge[x + 1] = static_cast<std::uint8_t>(ends);
  }
  for (const int way : {-1, 1}) {
    const auto row = [&](int i) { return std::clamp(y + way * i, 0, bottom); };
    if (row(1) == y) continue;
    const std::int16_t* next_surface = b.surface[row(1)];
    const float *before = b.depth[row(-1)], *next = b.depth[row(1)], *beyond = b.depth[row(2)];
    for (int x = 0; x <= last; ++x) {
      const bool ends =
          surface[x] != next_surface[x] || is_torn(before[x], depth[x], next[x], beyond[x]);
      is_edge[x] = static_cast<std::uint8_t>(is_edge[x] | static_cast<std::uint8_t>(ends));
    }
  }
}

// Where surfaces end inside a pixel: sixteen samples of it.
void refine_edges(const kernel::Frame& frame, const cv::Rect& region, Buffers& b) {
  const kernel::Kernel& k = kernel::best_kernel();
  tbb::parallel_for(0, region.height, [&](int py) {
    alignas(64) float x[kLanes], y[kLanes];
    alignas(64) int source[kLanes];
    Samples s;
    thread_local std::vector<std::uint8_t> is_edge;
    is_edge.assign(static_cast<std::size_t>(region.width), 0);
    find_edges(b, py, is_edge.data());
    for (int px = 0; px < region.width; ++px) {
      if (is_edge[static_cast<std::size_t>(px)] == 0) continue;
      for (int i = 0; i < kLanes; ++i) {
        x[i] = static_cast<float>(region.x + px) + (static_cast<float>(i % kBlock) - 1.5F) / kBlock;
        y[i] = static_cast<float>(region.y + py) + (static_cast<float>(i / kBlock) - 1.5F) / kBlock;
        source[i] = (5 * i + 3 * px + 7 * py) % kLanes;
      }
      k.trace(frame, x, y, source, 1.F / kBlock, {}, s);
      float light = 0, nir = 0, albedo = 0;
      for (int i = 0; i < kLanes; ++i) {
        light += s.base[i] + (s.sees_microscope_light[i] != 0 ? s.microscope[i] : 0);
        nir += s.sees_projector[i] != 0 ? s.nir_albedo[i] * s.nir_irradiance[i] : 0;
        albedo += s.nir_albedo[i];
      }
      b.light(py, px) = light / kLanes;
      b.nir(py, px) = albedo > 0 ? nir / albedo : 0;
      b.albedo(py, px) = albedo / kLanes;
    }
  });
}

}  // namespace

struct Renderer::Impl {
  Impl(std::vector<LitSurface> surfaces, const Eigen::Vector3d& n_up_ct)
      : scene(std::move(surfaces), n_up_ct) {}

  void trace(const RoomShot& shot, Side side, Rays rays) {
    if (shot.lights.or_light > 0) scene.light_up();
    setup.prepare(shot, side, scene, pattern);
    buffers.resize(shot.region.size());
    tracer.trace(setup.frame(), shot.region, rays, buffers);
  }

  void render(const RoomShot& shot, Side side) {
    trace(shot, side, shot.rays);
    combine(buffers);
    refine_edges(setup.frame(), shot.region, buffers);
    if (setup.frame().projector.source.is_on) {
      scatter_light(scene.surfaces(), shot, setup.channel().focal_px() / shot.optics.focus_mm,
                    buffers.surface, buffers.nir);
      if (shot.lights.speckle > 0)
        speckle.apply(buffers.nir, shot.lights.speckle, shot.region.tl(), side == Side::right);
    }
    collect(shot);
    spread(buffers.light, buffers.variance, shot.optics.blur_px * shot.optics.blur_px, variance_max,
           point_spread);
  }

  // Light of both kinds at the sensor in DN, and how far it will be spread.
  void collect(const RoomShot& shot) {
    const OpticalChannel& channel = setup.channel();
    const auto scale = static_cast<float>(255 * shot.sensor.exposure * channel.gain());
    const double spread_px = 0.25 * shot.optics.aperture_mm * channel.focal_px();
    const Eigen::Vector3d& inverse_focus = setup.inverse_focus();
    const auto own = static_cast<float>(shot.optics.blur_px * shot.optics.blur_px);
    std::vector<float> largest(static_cast<std::size_t>(buffers.light.rows), own);
    tbb::parallel_for(0, buffers.light.rows, [&](int y) {
      const double sensor_y = shot.region.y + y;
      const Eigen::Vector2d from = setup.slopes_at(shot.region.x, sensor_y);
      const Eigen::Vector2d to = setup.slopes_at(shot.region.x + shot.region.width - 1, sensor_y);
      const Eigen::Vector2d step = (to - from) / std::max(1, shot.region.width - 1);
      const auto focus_from = static_cast<float>(inverse_focus.dot(from.homogeneous()));
      const auto focus_step = static_cast<float>(inverse_focus.head<2>().dot(step));
      const auto mx0 = static_cast<float>(from.x()), dmx = static_cast<float>(step.x());
      const auto my0 = static_cast<float>(from.y()), dmy = static_cast<float>(step.y());
      const auto per_defocus = static_cast<float>(spread_px);
      const float* nir = buffers.nir[y];
      const float* albedo = buffers.albedo[y];
      const float* depth = buffers.depth[y];
      float* light = buffers.light[y];
      float* variance = buffers.variance[y];
      float most = own;
      for (int x = 0; x < buffers.light.cols; ++x) {
        const auto fx = static_cast<float>(x);
        const float mx = mx0 + dmx * fx, my = my0 + dmy * fx;
        const float vignette = 1 / (1 + mx * mx + my * my);
        light[x] = scale * vignette * (light[x] + albedo[x] * nir[x]);
        const float defocus =
            per_defocus * (1 / std::max(depth[x], 50.F) - focus_from - focus_step * fx);
        variance[x] = depth[x] > 0 ? own + defocus * defocus : own;
        most = std::max(most, variance[x]);
      }
      largest[static_cast<std::size_t>(y)] = most;
    });
    variance_max = static_cast<double>(*std::max_element(largest.begin(), largest.end()));
  }

  LitScene scene;
  ProjectedPattern pattern;
  FrameSetup setup;
  RegionTracer tracer;
  Buffers buffers;
  PointSpreadScratch point_spread;
  Speckle speckle;
  double variance_max = 0;
};

Renderer::Renderer(std::vector<LitSurface> surfaces, const Eigen::Vector3d& n_up_ct)
    : impl_(std::make_unique<Impl>(std::move(surfaces), n_up_ct)) {}
Renderer::~Renderer() = default;

cv::Mat Renderer::light(const RoomShot& shot, Side side) {
  impl_->render(shot, side);
  return impl_->buffers.light.clone();
}

cv::Mat Renderer::image(const RoomShot& shot, Side side) {
  impl_->render(shot, side);
  return exposed(impl_->buffers.light, shot.sensor,
                 (std::uint64_t{shot.seed} << 1U) | (side == Side::right ? 1U : 0U));
}

const cv::Mat_<float>& Renderer::depth_mm() const {
  return impl_->buffers.depth;
}

Geometry Renderer::geometry(const RoomShot& shot, Side side) {
  impl_->trace(shot, side, Rays::all);
  Geometry geometry;
  geometry.depth_mm = impl_->buffers.depth.clone();
  impl_->buffers.surface.convertTo(geometry.surface, CV_32S);
  return geometry;
}

std::optional<Eigen::Vector3d> Renderer::first_hit(const SightLine& line,
                                                   const Eigen::Isometry3d& T_ct_camera) const {
  const Eigen::Vector3d o = T_ct_camera * line.origin_mm, d = T_ct_camera.linear() * line.direction;
  RTCRayHit ray{};
  ray.ray.org_x = static_cast<float>(o.x());
  ray.ray.org_y = static_cast<float>(o.y());
  ray.ray.org_z = static_cast<float>(o.z());
  ray.ray.dir_x = static_cast<float>(d.x());
  ray.ray.dir_y = static_cast<float>(d.y());
  ray.ray.dir_z = static_cast<float>(d.z());
  ray.ray.tnear = 1;
  ray.ray.tfar = 2000;
  ray.ray.mask = ~0U;
  ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(impl_->scene.scene(), &context, &ray);
  if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  return o + static_cast<double>(ray.ray.tfar) * d;
}

}  // namespace holdfast::sim
