// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: what reaches a point from a lamp and from the pattern projector.
#pragma once

#include <cmath>
#include <cstdint>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

constexpr float kLift = 0.02F;  // mm: where a shadow ray starts above the surface

// GGX lobe times what makes a white matt surface's radiance its irradiance.
inline float glossy(float n_h, float l_h, float specular, float roughness) {
  const float alpha = roughness * roughness + 0.002F, a2 = alpha * alpha;
  const float d = n_h * n_h * (a2 - 1) + 1;
  return specular * a2 / (4 * d * d * (l_h * l_h + 0.01F));
}

struct alignas(64) Lit {
  float cosine[kLanes], irradiance[kLanes], gloss[kLanes];
};

void light_from(const Source& source, const Lanes3& p, const Lanes3& n, const Lanes3& v,
                const float* specular, const float* roughness, Lit& out) {
  for (int i = 0; i < kLanes; ++i) {
    // Shading is by the source's centre: only the shadow knows that it has an extent.
    float x = source.position.x - p.x[i], y = source.position.y - p.y[i],
          z = source.position.z - p.z[i];
    const float d2 = x * x + y * y + z * z;
    const float inverse = 1.F / std::sqrt(d2);
    x *= inverse, y *= inverse, z *= inverse;
    const float cosine = n.x[i] * x + n.y[i] * y + n.z[i] * z;
    const float hx = x + v.x[i], hy = y + v.y[i], hz = z + v.z[i];
    const float h = 1.F / std::sqrt(hx * hx + hy * hy + hz * hz + 1e-12F);
    const float n_h = (n.x[i] * hx + n.y[i] * hy + n.z[i] * hz) * h;
    const float l_h = (x * hx + y * hy + z * hz) * h;
    out.cosine[i] = cosine > 0 ? cosine : 0;
    out.irradiance[i] = source.power * source.reference_mm * source.reference_mm / d2;
    out.gloss[i] = glossy(n_h, l_h, specular[i], roughness[i]);
  }
}

// Towards the source's sampled points.
void cast_shadows(RTCScene scene, const Source& source, const int* sample, const Lanes3& p,
                  const Lanes3& n, const Lit& lit, const int* is_wanted, std::uint8_t* sees) {
  alignas(64) int valid[kLanes];
  int any = 0;
  RTCRay16 ray;
  for (int i = 0; i < kLanes; ++i) {
    valid[i] = is_wanted[i] != 0 && lit.cosine[i] > 0 ? -1 : 0;
    any |= valid[i];
    ray.org_x[i] = p.x[i] + kLift * n.x[i];
    ray.org_y[i] = p.y[i] + kLift * n.y[i];
    ray.org_z[i] = p.z[i] + kLift * n.z[i];
    const Vec3 offset = source.disc[sample[i]];
    const float sx = source.position.x + offset.x - p.x[i],
                sy = source.position.y + offset.y - p.y[i],
                sz = source.position.z + offset.z - p.z[i];
    const float distance = std::sqrt(sx * sx + sy * sy + sz * sz), inverse = 1.F / distance;
    ray.dir_x[i] = sx * inverse;
    ray.dir_y[i] = sy * inverse;
    ray.dir_z[i] = sz * inverse;
    ray.tnear[i] = 0;
    ray.tfar[i] = distance;
    ray.time[i] = 0;
    ray.mask[i] = ~0U;
    ray.id[i] = 0;
    ray.flags[i] = 0;
  }
  if (any != 0) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcOccluded16(valid, scene, &context, &ray);
  }
  for (int i = 0; i < kLanes; ++i)
    sees[i] = static_cast<std::uint8_t>(valid[i] != 0 && ray.tfar[i] > 0 ? 1 : 0);
}

// The pattern's value at each point, 0 where the projector does not reach. One loop a step, so that
// each runs over all lanes at once.
void pattern_at(const Projector& projector, const Lanes3& p, float* dots) {
  alignas(64) float x[kLanes], y[kLanes], weight[3][kLanes];
  const Image& image = projector.levels[0];
  const float width = static_cast<float>(image.width), height = static_cast<float>(image.height);
  const float* variance = projector.level_variance;
  const float finer = 1 / (variance[1] - variance[0]), coarser = 1 / (variance[2] - variance[1]);
  for (int i = 0; i < kLanes; ++i) {
    const Vec3 d = minus({p.x[i], p.y[i], p.z[i]}, projector.source.position);
    const float z = dot(d, projector.axis_z), inverse = 1.F / (z > 1 ? z : 1);
    const float mx = dot(d, projector.axis_x) * inverse, my = dot(d, projector.axis_y) * inverse;
    const float radial = 1 + projector.k1 * (mx * mx + my * my);
    x[i] = projector.focal * mx * radial + projector.cx;
    y[i] = projector.focal * my * radial + projector.cy;
    const bool is_lit = static_cast<int>(z > 1) & static_cast<int>(x[i] >= -0.5F) &
                        static_cast<int>(y[i] >= -0.5F) & static_cast<int>(x[i] <= width - 0.5F) &
                        static_cast<int>(y[i] <= height - 0.5F);
    const float defocus = projector.defocus * (inverse - projector.inverse_focus);
    const float v = projector.base_variance + defocus * defocus;
    const float s = clamp((v - variance[0]) * finer, 0, 1);
    const float t = clamp((v - variance[1]) * coarser, 0, 1);
    const float on = is_lit ? 1.F : 0.F;
    weight[0][i] = on * (1 - s);
    weight[1][i] = on * (s - t);
    weight[2][i] = on * t;
  }
  for (int i = 0; i < kLanes; ++i) dots[i] = 0;
  for (int level = 0; level < 3; ++level) {
    float most = 0;
    for (int i = 0; i < kLanes; ++i) most = weight[level][i] > most ? weight[level][i] : most;
    if (!(most > 0)) continue;
    const float* data = projector.levels[level].data;
    for (int i = 0; i < kLanes; ++i) {
      const float u = clamp(x[i], 0, width - 1.001F), v = clamp(y[i], 0, height - 1.001F);
      const int ix = static_cast<int>(u), iy = static_cast<int>(v);
      const float fx = u - static_cast<float>(ix), fy = v - static_cast<float>(iy);
      const int at = iy * image.width + ix;
      const float a = data[at], b = data[at + image.width];
      const float top = a + fx * (data[at + 1] - a);
      const float bottom = b + fx * (data[at + image.width + 1] - b);
      dots[i] += weight[level][i] * (top + fy * (bottom - top));
    }
  }
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
