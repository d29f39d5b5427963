// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: what reaches a point from a lamp and from the pattern projector.
#pragma once

#include <cmath>
#include <cstdint>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"
#include "tests/sim/or/kernel/texel.hpp"

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

// The pattern's value where the projector sees the point.
float pattern_at(const Projector& projector, Vec3 p) {
  const Vec3 d = minus(p, projector.source.position);
  const float z = dot(d, projector.axis_z);
  if (!(z > 1)) return 0;
  const float mx = dot(d, projector.axis_x) / z, my = dot(d, projector.axis_y) / z;
  const float radial = 1 + projector.k1 * (mx * mx + my * my);
  const float x = projector.focal * mx * radial + projector.cx;
  const float y = projector.focal * my * radial + projector.cy;
  const Image& image = projector.levels[0];
  if (!(x >= -0.5F && y >= -0.5F && x <= static_cast<float>(image.width) - 0.5F &&
        y <= static_cast<float>(image.height) - 0.5F))
    return 0;
  const float defocus = projector.defocus * (1.F / z - projector.inverse_focus);
  const float variance = projector.base_variance + defocus * defocus;
  const int level = variance < projector.level_variance[1] ? 0 : 1;
  const float from = projector.level_variance[level], to = projector.level_variance[level + 1];
  const float t = clamp((variance - from) / (to - from), 0, 1);
  const float sharp = texel(projector.levels[level], x + 0.5F, y + 0.5F);
  const float blurred = texel(projector.levels[level + 1], x + 0.5F, y + 0.5F);
  return sharp + t * (blurred - sharp);
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
