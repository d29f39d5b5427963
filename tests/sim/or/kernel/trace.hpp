// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: a packet of samples, from its pixels to what they saw.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "tests/sim/or/kernel/albedo.hpp"
#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"
#include "tests/sim/or/kernel/light.hpp"
#include "tests/sim/or/kernel/sight.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

struct alignas(64) Hits {
  Lanes3 p, n, v;  // point, shading normal, direction to the camera
  float visible[kLanes], nir[kLanes], ambient[kLanes], specular[kLanes], roughness[kLanes];
  float texture_per_mm[kLanes], texture_contrast[kLanes];
};

// What lane i's surface and triangle hold: the rest is worked out for all lanes at once.
void look_up(const Frame& frame, const RTCRayHit16& ray, const Slopes& slopes, int i,
             float footprint, Hits& hits) {
  const Surface& s = frame.surfaces[ray.hit.geomID[i]];
  const std::uint32_t* triangle = s.triangles + 3 * static_cast<std::size_t>(ray.hit.primID[i]);
  const float u = ray.hit.u[i], v = ray.hit.v[i], w = 1 - u - v;
  const Vec3 a = s.normals[triangle[0]], b = s.normals[triangle[1]], c = s.normals[triangle[2]];
  hits.n.x[i] = w * a.x + u * b.x + v * c.x;
  hits.n.y[i] = w * a.y + u * b.y + v * c.y;
  hits.n.z[i] = w * a.z + u * b.z + v * c.z;
  hits.ambient[i] = w * s.or_irradiance[triangle[0]] + u * s.or_irradiance[triangle[1]] +
                    v * s.or_irradiance[triangle[2]];
  hits.texture_per_mm[i] = s.texture_per_mm;
  hits.texture_contrast[i] = s.texture_contrast;
  float print = 1;
  if (s.uv != nullptr && s.print.data != nullptr) {
    const Vec3 d{ray.ray.dir_x[i], ray.ray.dir_y[i], ray.ray.dir_z[i]};
    const Vec3 flat{ray.hit.Ng_x[i], ray.hit.Ng_y[i], ray.hit.Ng_z[i]};
    const float t = ray.ray.tfar[i];
    print = printed(s, triangle, u, v, plane_step(frame, slopes.dx_mx, slopes.dx_my, t, d, flat),
                    plane_step(frame, slopes.dy_mx, slopes.dy_my, t, d, flat), footprint);
  }
  hits.visible[i] = s.albedo_visible * print;
  hits.nir[i] = s.albedo_nir * print;
  hits.specular[i] = s.specular;
  hits.roughness[i] = s.roughness;
}

// Unit normals on the camera's side; albedos with their texture.
void finish(const Frame& frame, Hits& hits) {
  for (int i = 0; i < kLanes; ++i) {
    const float x = hits.n.x[i], y = hits.n.y[i], z = hits.n.z[i];
    const float scale = 1.F / std::sqrt(x * x + y * y + z * z + 1e-20F);
    const float facing = x * hits.v.x[i] + y * hits.v.y[i] + z * hits.v.z[i];
    const float sign = facing < 0 ? -scale : scale;
    hits.n.x[i] = sign * x;
    hits.n.y[i] = sign * y;
    hits.n.z[i] = sign * z;
  }
  float most = 0;
  for (int i = 0; i < kLanes; ++i)
    most = hits.texture_contrast[i] > most ? hits.texture_contrast[i] : most;
  if (!(most > 0)) return;
  alignas(64) float factor[kLanes];
  texture(frame.table, hits.p, hits.texture_per_mm, hits.texture_contrast, factor);
  for (int i = 0; i < kLanes; ++i) {
    hits.visible[i] *= factor[i];
    hits.nir[i] *= factor[i];
  }
}

void clear_lane(Hits& hits, int i) {
  hits.n.x[i] = hits.n.y[i] = 0;
  hits.n.z[i] = 1;
  hits.visible[i] = hits.nir[i] = hits.ambient[i] = hits.specular[i] = 0;
  hits.texture_per_mm[i] = hits.texture_contrast[i] = 0;
  hits.roughness[i] = 1;
}

// Point and direction of view of each lane, `t` along its line of sight.
void place(const Frame& frame, const Slopes& slopes, const float* t, Hits& hits) {
  for (int i = 0; i < kLanes; ++i) {
    const float mx = slopes.mx[i], my = slopes.my[i], shift = slopes.shift[i];
    const float dx = mx * frame.axis_x.x + my * frame.axis_y.x + frame.axis_z.x;
    const float dy = mx * frame.axis_x.y + my * frame.axis_y.y + frame.axis_z.y;
    const float dz = mx * frame.axis_x.z + my * frame.axis_y.z + frame.axis_z.z;
    hits.p.x[i] = frame.pupil.x + shift * frame.axis_z.x + t[i] * dx;
    hits.p.y[i] = frame.pupil.y + shift * frame.axis_z.y + t[i] * dy;
    hits.p.z[i] = frame.pupil.z + shift * frame.axis_z.z + t[i] * dz;
    const float length = 1.F / std::sqrt(dx * dx + dy * dy + dz * dz);
    hits.v.x[i] = -dx * length;
    hits.v.y[i] = -dy * length;
    hits.v.z[i] = -dz * length;
  }
}

// Light on what was hit; `is_hit` of each lane.
void shade(const Frame& frame, const int* source_sample, ShadowRays rays, const int* is_hit,
           Hits& hits, Samples& out) {
  finish(frame, hits);
  for (int i = 0; i < kLanes; ++i) {
    out.base[i] = hits.visible[i] * hits.ambient[i] * frame.or_light;
    out.microscope[i] = out.nir_irradiance[i] = 0;
    out.nir_albedo[i] = hits.nir[i];
    out.sees_microscope_light[i] = out.sees_projector[i] = 1;
  }
  Lit lit;
  if (frame.microscope_light.is_on) {
    light_from(frame.microscope_light, hits.p, hits.n, hits.v, hits.specular, hits.roughness, lit);
    if (rays.microscope)
      cast_shadows(frame.scene, frame.microscope_light, source_sample, hits.p, hits.n, lit, is_hit,
                   out.sees_microscope_light);
    for (int i = 0; i < kLanes; ++i)
      out.microscope[i] = lit.irradiance[i] * lit.cosine[i] * (hits.visible[i] + lit.gloss[i]);
  }
  if (!frame.projector.source.is_on) return;
  light_from(frame.projector.source, hits.p, hits.n, hits.v, hits.specular, hits.roughness, lit);
  alignas(64) int is_patterned[kLanes];
  alignas(64) float pattern[kLanes];
  pattern_at(frame.projector, hits.p, pattern);
  for (int i = 0; i < kLanes; ++i) {
    const float dots = is_hit[i] != 0 ? pattern[i] : 0;
    is_patterned[i] = dots > 1e-4F ? 1 : 0;
    out.nir_irradiance[i] = lit.irradiance[i] * lit.cosine[i] * dots;
    out.nir_albedo[i] += lit.gloss[i];
  }
  if (rays.projector)
    cast_shadows(frame.scene, frame.projector.source, source_sample, hits.p, hits.n, lit,
                 rays.is_dark_too ? is_hit : is_patterned, out.sees_projector);
}

void trace(const Frame& frame, const float* x, const float* y, const int* source_sample,
           float footprint, ShadowRays rays, Samples& out) {
  Slopes slopes;
  slopes_at(frame.sight, x, y, slopes);
  RTCRayHit16 ray;
  primary(frame, slopes, ray);
  Hits hits;
  alignas(64) int is_hit[kLanes];
  alignas(64) float t[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    is_hit[i] = ray.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
    t[i] = is_hit[i] != 0 ? ray.ray.tfar[i] : 1;
    out.depth[i] = is_hit[i] != 0 ? t[i] + slopes.shift[i] : 0;
    out.surface[i] = is_hit[i] != 0 ? static_cast<int>(ray.hit.geomID[i]) : -1;
  }
  place(frame, slopes, t, hits);
  for (int i = 0; i < kLanes; ++i) {
    if (is_hit[i] != 0)
      look_up(frame, ray, slopes, i, footprint, hits);
    else
      clear_lane(hits, i);
  }
  shade(frame, source_sample, rays, is_hit, hits, out);
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
