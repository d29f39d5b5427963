// SPDX-License-Identifier: Apache-2.0
// The kernel's code, included by one source file for each instruction set, each with its own
// HOLDFAST_KERNEL_NAMESPACE.
#pragma once

#include <cmath>
#include <cstring>

#include "tests/sim/or/kernel/kernel.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

constexpr float kPi = 3.14159265F;
constexpr float kLift = 0.02F;  // mm: where a shadow ray starts above the surface

struct alignas(64) Lanes3 {
  float x[kLanes], y[kLanes], z[kLanes];
};

inline float dot(Vec3 a, Vec3 b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
inline Vec3 minus(Vec3 a, Vec3 b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
inline Vec3 cross(Vec3 a, Vec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline float clamp(float v, float lo, float hi) {
  return v < lo ? lo : v > hi ? hi : v;
}

// ---- camera

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

// ---- albedo

inline float fade(float t) {
  return t * t * t * (t * (t * 6 - 15) + 10);
}

inline float lerp(float a, float b, float t) {
  return a + t * (b - a);
}

inline float lattice(const float* table, float x, float y, float z) {
  constexpr int kMask = kTableSize - 1;
  const float fx = std::floor(x), fy = std::floor(y), fz = std::floor(z);
  const int ix = static_cast<int>(fx) & kMask, iy = (static_cast<int>(fy) & kMask) * kTableSize,
            iz = (static_cast<int>(fz) & kMask) * kTableSize * kTableSize;
  const int jx = (ix + 1) & kMask, jy = (iy + kTableSize) & (kMask * kTableSize),
            jz = (iz + kTableSize * kTableSize) & (kMask * kTableSize * kTableSize);
  const float u = fade(x - fx), v = fade(y - fy), w = fade(z - fz);
  const float near = lerp(lerp(table[iz + iy + ix], table[iz + iy + jx], u),
                          lerp(table[iz + jy + ix], table[iz + jy + jx], u), v);
  const float far = lerp(lerp(table[jz + iy + ix], table[jz + iy + jx], u),
                         lerp(table[jz + jy + ix], table[jz + jy + jx], u), v);
  return lerp(near, far, w);
}

// Two octaves, the second turned so that their lattices do not coincide.
void texture(const float* table, const Lanes3& p, const float* per_mm, const float* contrast,
             float* factor) {
  for (int i = 0; i < kLanes; ++i) {
    const float x = per_mm[i] * p.x[i], y = per_mm[i] * p.y[i], z = per_mm[i] * p.z[i];
    const float u = 1.36F * x + 1.28F * y + 0.96F * z + 11.3F;
    const float v = -1.6F * x + 1.36F * y + 0.4F * z + 5.7F;
    const float w = -0.4F * x - 0.96F * y + 1.84F * z + 17.1F;
    const float f =
        1 + contrast[i] * (0.8F * lattice(table, x, y, z) + 0.6F * lattice(table, u, v, w));
    factor[i] = f < 0.05F ? 0.05F : f > 3 ? 3 : f;
  }
}

// Bilinear, with values at texel centres; the image goes on as its border does.
inline float texel(const Image& image, float x, float y) {
  x = clamp(x - 0.5F, 0, static_cast<float>(image.width) - 1.001F);
  y = clamp(y - 0.5F, 0, static_cast<float>(image.height) - 1.001F);
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float fx = x - static_cast<float>(ix), fy = y - static_cast<float>(iy);
  const float* a = image.data + iy * image.width + ix;
  const float* b = a + image.width;
  const float top = a[0] + fx * (a[1] - a[0]), bottom = b[0] + fx * (b[1] - b[0]);
  return top + fy * (bottom - top);
}

// The print's mean over a pixel: 4x4 taps over its parallelogram on the surface.
float printed(const Surface& s, const std::uint32_t* triangle, float bu, float bv, Vec3 along_x,
              Vec3 along_y, float footprint) {
  const Vec3 a = s.vertices[triangle[0]];
  const Vec3 e1 = minus(s.vertices[triangle[1]], a), e2 = minus(s.vertices[triangle[2]], a);
  const float* t0 = s.uv + 2 * triangle[0];
  const float* t1 = s.uv + 2 * triangle[1];
  const float* t2 = s.uv + 2 * triangle[2];
  const float width = static_cast<float>(s.print.width),
              height = static_cast<float>(s.print.height);
  const float u1 = (t1[0] - t0[0]) * width, v1 = (t1[1] - t0[1]) * height;
  const float u2 = (t2[0] - t0[0]) * width, v2 = (t2[1] - t0[1]) * height;
  const float u = t0[0] * width + bu * u1 + bv * u2, v = t0[1] * height + bu * v1 + bv * v2;
  // Barycentric rates of a step in the plane, by the Gram matrix of the edges.
  const float g11 = dot(e1, e1), g12 = dot(e1, e2), g22 = dot(e2, e2);
  const float inverse = 1.F / (g11 * g22 - g12 * g12);
  float rates[2][2];
  const Vec3 steps[2] = {along_x, along_y};
  for (int i = 0; i < 2; ++i) {
    const float p = dot(steps[i], e1), q = dot(steps[i], e2);
    const float b1 = (g22 * p - g12 * q) * inverse, b2 = (g11 * q - g12 * p) * inverse;
    rates[i][0] = footprint * (b1 * u1 + b2 * u2);
    rates[i][1] = footprint * (b1 * v1 + b2 * v2);
  }
  float sum = 0;
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 4; ++i) {
      const float cx = (static_cast<float>(i) - 1.5F) / 4, cy = (static_cast<float>(j) - 1.5F) / 4;
      sum += texel(s.print, u + cx * rates[0][0] + cy * rates[1][0],
                   v + cx * rates[0][1] + cy * rates[1][1]);
    }
  return sum / 16;
}

// ---- light

// GGX lobe times what makes a white matt surface's radiance its irradiance.
inline float glossy(float n_h, float l_h, float specular, float roughness) {
  const float alpha = roughness * roughness + 0.002F, a2 = alpha * alpha;
  const float d = n_h * n_h * (a2 - 1) + 1;
  return specular * a2 / (4 * d * d * (l_h * l_h + 0.01F));
}

struct alignas(64) Lit {
  float cosine[kLanes], irradiance[kLanes], gloss[kLanes];
  Lanes3 direction;  // towards the source's sampled point, unit
  float distance[kLanes];
};

void light_from(const Source& source, const int* sample, const Lanes3& p, const Lanes3& n,
                const Lanes3& v, const float* specular, const float* roughness, Lit& out) {
  for (int i = 0; i < kLanes; ++i) {
    const Vec3 offset = source.disc[sample[i]];
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
    const float sx = source.position.x + offset.x - p.x[i],
                sy = source.position.y + offset.y - p.y[i],
                sz = source.position.z + offset.z - p.z[i];
    const float s = std::sqrt(sx * sx + sy * sy + sz * sz), si = 1.F / s;
    out.direction.x[i] = sx * si;
    out.direction.y[i] = sy * si;
    out.direction.z[i] = sz * si;
    out.distance[i] = s;
  }
}

void cast_shadows(RTCScene scene, const Lanes3& p, const Lanes3& n, const Lit& lit,
                  const int* is_wanted, std::uint8_t* sees) {
  alignas(64) int valid[kLanes];
  int any = 0;
  RTCRay16 ray;
  for (int i = 0; i < kLanes; ++i) {
    valid[i] = is_wanted[i] != 0 && lit.cosine[i] > 0 ? -1 : 0;
    any |= valid[i];
    ray.org_x[i] = p.x[i] + kLift * n.x[i];
    ray.org_y[i] = p.y[i] + kLift * n.y[i];
    ray.org_z[i] = p.z[i] + kLift * n.z[i];
    ray.dir_x[i] = lit.direction.x[i];
    ray.dir_y[i] = lit.direction.y[i];
    ray.dir_z[i] = lit.direction.z[i];
    ray.tnear[i] = 0;
    ray.tfar[i] = lit.distance[i];
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

// ---- a packet

struct alignas(64) Hits {
  Lanes3 p, n, v;  // point, shading normal, direction to the camera
  float visible[kLanes], nir[kLanes], ambient[kLanes], specular[kLanes], roughness[kLanes];
  float texture_per_mm[kLanes], texture_contrast[kLanes];
};

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

}  // namespace

void trace(const Frame& frame, const float* x, const float* y, const int* source_sample,
           float footprint, Samples& out) {
  Slopes slopes;
  slopes_at(frame.sight, x, y, slopes);
  RTCRayHit16 ray;
  primary(frame, slopes, ray);
  Hits hits;
  alignas(64) int is_hit[kLanes], is_patterned[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    is_hit[i] = ray.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
    const float t = is_hit[i] != 0 ? ray.ray.tfar[i] : 1;
    hits.p.x[i] = ray.ray.org_x[i] + t * ray.ray.dir_x[i];
    hits.p.y[i] = ray.ray.org_y[i] + t * ray.ray.dir_y[i];
    hits.p.z[i] = ray.ray.org_z[i] + t * ray.ray.dir_z[i];
    const float length =
        1.F / std::sqrt(ray.ray.dir_x[i] * ray.ray.dir_x[i] + ray.ray.dir_y[i] * ray.ray.dir_y[i] +
                        ray.ray.dir_z[i] * ray.ray.dir_z[i]);
    hits.v.x[i] = -ray.ray.dir_x[i] * length;
    hits.v.y[i] = -ray.ray.dir_y[i] * length;
    hits.v.z[i] = -ray.ray.dir_z[i] * length;
    out.depth[i] = is_hit[i] != 0 ? t + slopes.shift[i] : 0;
    out.surface[i] = is_hit[i] != 0 ? static_cast<int>(ray.hit.geomID[i]) : -1;
  }
  for (int i = 0; i < kLanes; ++i) {
    if (is_hit[i] != 0)
      look_up(frame, ray, slopes, i, footprint, hits);
    else
      clear_lane(hits, i);
  }
  finish(frame, hits);
  for (int i = 0; i < kLanes; ++i) {
    out.base[i] = hits.visible[i] * hits.ambient[i] * frame.or_light;
    out.microscope[i] = out.nir_irradiance[i] = 0;
    out.nir_albedo[i] = hits.nir[i];
    out.sees_microscope_light[i] = out.sees_projector[i] = 1;
  }
  Lit lit;
  if (frame.microscope_light.is_on) {
    light_from(frame.microscope_light, source_sample, hits.p, hits.n, hits.v, hits.specular,
               hits.roughness, lit);
    cast_shadows(frame.scene, hits.p, hits.n, lit, is_hit, out.sees_microscope_light);
    for (int i = 0; i < kLanes; ++i)
      out.microscope[i] = lit.irradiance[i] * lit.cosine[i] * (hits.visible[i] + lit.gloss[i]);
  }
  if (frame.projector.source.is_on) {
    light_from(frame.projector.source, source_sample, hits.p, hits.n, hits.v, hits.specular,
               hits.roughness, lit);
    for (int i = 0; i < kLanes; ++i) {
      const float dots =
          is_hit[i] != 0 ? pattern_at(frame.projector, {hits.p.x[i], hits.p.y[i], hits.p.z[i]}) : 0;
      is_patterned[i] = dots > 1e-4F ? 1 : 0;
      out.nir_irradiance[i] = lit.irradiance[i] * lit.cosine[i] * dots;
      out.nir_albedo[i] += lit.gloss[i];
    }
    cast_shadows(frame.scene, hits.p, hits.n, lit, is_patterned, out.sees_projector);
  }
}

void filter_rows(const float* const* rows, const float* weights, int radius, int n, float* out) {
  const float* middle = rows[radius];
  const float w = weights[radius];
  for (int i = 0; i < n; ++i) out[i] = w * middle[i];
  for (int k = 1; k <= radius; ++k) {
    const float* a = rows[radius - k];
    const float* b = rows[radius + k];
    const float wk = weights[radius + k];
    for (int i = 0; i < n; ++i) out[i] += wk * (a[i] + b[i]);
  }
}

void filter_row(const float* in, const float* weights, int radius, int n, float* out) {
  const float w = weights[radius];
  for (int i = 0; i < n; ++i) out[i] = w * in[i];
  for (int k = 1; k <= radius; ++k) {
    const float* a = in - k;
    const float* b = in + k;
    const float wk = weights[radius + k];
    for (int i = 0; i < n; ++i) out[i] += wk * (a[i] + b[i]);
  }
}

void combine(const float* base, const float* microscope, const float* irradiance,
             const std::uint8_t* const* m, const std::uint8_t* const* p, int n, float* light,
             float* nir) {
  constexpr int kBlock = 256;
  std::uint8_t vertical_m[kBlock + 4], vertical_p[kBlock + 4];
  for (int start = 0; start < n; start += kBlock) {
    const int count = n - start < kBlock ? n - start : kBlock;
    for (int i = 0; i < count + 4; ++i) {
      const int j = start + i - 2;
      vertical_m[i] =
          static_cast<std::uint8_t>(m[0][j] + 2 * (m[1][j] + m[2][j] + m[3][j]) + m[4][j]);
      vertical_p[i] =
          static_cast<std::uint8_t>(p[0][j] + 2 * (p[1][j] + p[2][j] + p[3][j]) + p[4][j]);
    }
    for (int i = 0; i < count; ++i) {
      const int sum_m = vertical_m[i] +
                        2 * (vertical_m[i + 1] + vertical_m[i + 2] + vertical_m[i + 3]) +
                        vertical_m[i + 4];
      const int sum_p = vertical_p[i] +
                        2 * (vertical_p[i + 1] + vertical_p[i + 2] + vertical_p[i + 3]) +
                        vertical_p[i + 4];
      light[start + i] =
          base[start + i] + microscope[start + i] * static_cast<float>(sum_m) * 0.015625F;
      nir[start + i] = irradiance[start + i] * static_cast<float>(sum_p) * 0.015625F;
    }
  }
}

inline std::uint32_t scramble(std::uint32_t h) {
  h ^= h >> 16U;
  h *= 0x7feb352dU;
  h ^= h >> 15U;
  h *= 0x846ca68bU;
  return h ^ (h >> 16U);
}

void expose(const float* light, const float* deviates, std::uint64_t seed, float read, float shot,
            float full_scale, int n, std::uint16_t* out) {
  const auto low = static_cast<std::uint32_t>(seed), high = static_cast<std::uint32_t>(seed >> 32U);
  for (int i = 0; i < n; ++i) {
    const std::uint32_t h = scramble(scramble(static_cast<std::uint32_t>(i) ^ low) + high);
    const float value = light[i] > 0 ? light[i] : 0;
    const float noisy =
        value + std::sqrt(read * read + shot * shot * value) * deviates[h >> 16U] + 0.5F;
    const float clipped = noisy < 0 ? 0 : noisy > full_scale ? full_scale : noisy;
    out[i] = static_cast<std::uint16_t>(static_cast<int>(clipped));
  }
}

}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
