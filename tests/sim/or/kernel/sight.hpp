// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: lines of sight through the pixels, and the surfaces that they meet.
#pragma once

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

// Slopes of the samples, and what a pixel to the right and one down change about them.
struct alignas(64) Slopes {
  float mx[kLanes], my[kLanes], shift[kLanes];
  float dx_mx, dx_my, dy_mx, dy_my;
};

// A packet is small against the grid's step: the cell of its middle serves all of it.
inline void slopes_at(const SightGrid& grid, const float* x, const float* y, Slopes& out) {
  const float per_px = 1.F / static_cast<float>(grid.step_px);
  const float x0 = static_cast<float>(grid.x0_px), y0 = static_cast<float>(grid.y0_px);
  const float middle_x = (0.5F * (x[0] + x[kLanes - 1]) - x0) * per_px;
  const float middle_y = (0.5F * (y[0] + y[kLanes - 1]) - y0) * per_px;
  const int ix = static_cast<int>(clamp(middle_x, 0, static_cast<float>(grid.columns) - 1.001F));
  const int iy = static_cast<int>(clamp(middle_y, 0, static_cast<float>(grid.rows) - 1.001F));
  const float* a = grid.slopes + 3 * (iy * grid.columns + ix);
  const float* b = a + 3 * grid.columns;
  float* const rows[3] = {out.mx, out.my, out.shift};
  for (int k = 0; k < 3; ++k) {
    const float corner = a[k], along = a[k + 3] - a[k], down = b[k] - a[k];
    const float twist = b[k + 3] - b[k] - along;
    float* row = rows[k];
    for (int i = 0; i < kLanes; ++i) {
      const float fx = (x[i] - x0) * per_px - static_cast<float>(ix);
      const float fy = (y[i] - y0) * per_px - static_cast<float>(iy);
      row[i] = corner + fx * along + fy * (down + fx * twist);
    }
  }
  out.dx_mx = (a[3] - a[0]) * per_px;
  out.dx_my = (a[4] - a[1]) * per_px;
  out.dy_mx = (b[0] - a[0]) * per_px;
  out.dy_my = (b[1] - a[1]) * per_px;
}

void primary(const Frame& frame, const Slopes& slopes, RTCRayHit16& ray) {
  alignas(64) int valid[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    const float mx = slopes.mx[i], my = slopes.my[i], shift = slopes.shift[i];
    valid[i] = -1;
    ray.ray.org_x[i] = frame.pupil.x + shift * frame.axis_z.x;
    ray.ray.org_y[i] = frame.pupil.y + shift * frame.axis_z.y;
    ray.ray.org_z[i] = frame.pupil.z + shift * frame.axis_z.z;
    ray.ray.dir_x[i] = mx * frame.axis_x.x + my * frame.axis_y.x + frame.axis_z.x;
    ray.ray.dir_y[i] = mx * frame.axis_x.y + my * frame.axis_y.y + frame.axis_z.y;
    ray.ray.dir_z[i] = mx * frame.axis_x.z + my * frame.axis_y.z + frame.axis_z.z;
    ray.ray.tnear[i] = 1;
    ray.ray.tfar[i] = 2000;
    ray.ray.time[i] = 0;
    ray.ray.mask[i] = ~0U;
    ray.ray.id[i] = 0;
    ray.ray.flags[i] = 0;
    ray.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
    ray.hit.primID[i] = RTC_INVALID_GEOMETRY_ID;
    ray.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcIntersect16(valid, frame.scene, &context, &ray);
}

Vec3 plane_step(const Frame& frame, float dmx, float dmy, float t, Vec3 direction, Vec3 normal) {
  const Vec3 change{t * (dmx * frame.axis_x.x + dmy * frame.axis_y.x),
                    t * (dmx * frame.axis_x.y + dmy * frame.axis_y.y),
                    t * (dmx * frame.axis_x.z + dmy * frame.axis_y.z)};
  const float k = dot(change, normal) / dot(direction, normal);
  return {change.x - k * direction.x, change.y - k * direction.y, change.z - k * direction.z};
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
