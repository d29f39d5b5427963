// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: packets between pixels that have looked already, without rays of their own.
#pragma once

#include <cstddef>
#include <cstdint>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"
#include "tests/sim/or/kernel/sight.hpp"
#include "tests/sim/or/kernel/trace.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

void look(const Frame& frame, const float* x, const float* y, Looks& out) {
  Slopes slopes;
  slopes_at(frame.sight, x, y, slopes);
  RTCRayHit16 ray;
  primary(frame, slopes, ray);
  for (int i = 0; i < kLanes; ++i) {
    out.surface[i] = Looks::kNothing;
    out.value[Looks::t][i] = ray.ray.tfar[i];
    if (ray.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
    const Surface& s = frame.surfaces[ray.hit.geomID[i]];
    if (s.print.data != nullptr) {  // ends within a pixel: never in between
      out.surface[i] = Looks::kPrint;
      continue;
    }
    const std::uint32_t* triangle = s.triangles + 3 * static_cast<std::size_t>(ray.hit.primID[i]);
    const float u = ray.hit.u[i], v = ray.hit.v[i], w = 1 - u - v;
    const Vec3 a = s.normals[triangle[0]], b = s.normals[triangle[1]], c = s.normals[triangle[2]];
    out.value[Looks::n_x][i] = w * a.x + u * b.x + v * c.x;
    out.value[Looks::n_y][i] = w * a.y + u * b.y + v * c.y;
    out.value[Looks::n_z][i] = w * a.z + u * b.z + v * c.z;
    out.value[Looks::ambient][i] = w * s.or_irradiance[triangle[0]] +
                                   u * s.or_irradiance[triangle[1]] +
                                   v * s.or_irradiance[triangle[2]];
    out.surface[i] = static_cast<int>(ray.hit.geomID[i]);
  }
}

// 4x4 values between 3x3 that stand on every second of them.
void between(const float* in, float* out) {
  alignas(64) float rows[3][4];
  for (int j = 0; j < 3; ++j) {
    const float* n = in + 3 * j;
    rows[j][0] = n[0];
    rows[j][1] = 0.5F * (n[0] + n[1]);
    rows[j][2] = n[1];
    rows[j][3] = 0.5F * (n[1] + n[2]);
  }
  for (int i = 0; i < 4; ++i) {
    out[i] = rows[0][i];
    out[4 + i] = 0.5F * (rows[0][i] + rows[1][i]);
    out[8 + i] = rows[1][i];
    out[12 + i] = 0.5F * (rows[1][i] + rows[2][i]);
  }
}

void trace_between(const Frame& frame, const float* x, const float* y, const int* source_sample,
                   const Nodes& nodes, ShadowRays rays, Samples& out) {
  Slopes slopes;
  slopes_at(frame.sight, x, y, slopes);
  const Surface& s = frame.surfaces[nodes.surface];
  Hits hits;
  alignas(64) float t[kLanes];
  alignas(64) int is_hit[kLanes];
  between(nodes.value[Looks::t], t);
  between(nodes.value[Looks::n_x], hits.n.x);
  between(nodes.value[Looks::n_y], hits.n.y);
  between(nodes.value[Looks::n_z], hits.n.z);
  between(nodes.value[Looks::ambient], hits.ambient);
  place(frame, slopes, t, hits);
  for (int i = 0; i < kLanes; ++i) {
    is_hit[i] = 1;
    out.depth[i] = t[i] + slopes.shift[i];
    out.surface[i] = nodes.surface;
    hits.visible[i] = s.albedo_visible;
    hits.nir[i] = s.albedo_nir;
    hits.specular[i] = s.specular;
    hits.roughness[i] = s.roughness;
    hits.texture_per_mm[i] = s.texture_per_mm;
    hits.texture_contrast[i] = s.texture_contrast;
  }
  shade(frame, source_sample, rays, is_hit, hits, out);
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
