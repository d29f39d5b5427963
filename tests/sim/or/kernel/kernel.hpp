// SPDX-License-Identifier: Apache-2.0
// The inner loops of the renderer, over sixteen samples at a time. Compiled three times, for
// machines with AVX-512, with AVX2 and with neither, and chosen at run time: plain data only,
// nothing of the standard library or Eigen, whose layout or inline code would depend on the
// instruction set.
#pragma once

#include <cstdint>

#include <embree3/rtcore.h>

namespace holdfast::sim::kernel {

constexpr int kLanes = 16;
constexpr int kTableSize = 32;  ///< of the noise that albedo varies by; periodic, a power of two

struct Vec3 {
  float x, y, z;
};

struct Image {
  const float* data = nullptr;
  int width = 0, height = 0;
};

struct Surface {
  const Vec3* vertices;
  const Vec3* normals;
  const float* uv;                 ///< pairs; null: no print
  const std::uint32_t* triangles;  ///< triples
  const float* or_irradiance;      ///< per vertex
  float albedo_visible, albedo_nir, specular, roughness;
  float texture_contrast, texture_per_mm;
  Image print;
};

/// Directions of a camera's pixels: slopes and pupil shift on a grid, bilinear in between.
struct SightGrid {
  const float* slopes;  ///< (mx, my, shift) a node
  int columns, rows, step_px, x0_px, y0_px;
};

/// A small round source with its own axes; `disc` are 16 points of it.
struct Source {
  Vec3 position;
  Vec3 disc[kLanes];
  float power;  ///< irradiance at `reference_mm`
  float reference_mm;
  bool is_on;
};

struct Projector {
  Source source;
  Vec3 axis_x, axis_y, axis_z;
  float focal, cx, cy, k1;  ///< in pixels of the pattern images
  Image levels[3];          ///< ever more blurred
  float level_variance[3];
  float base_variance, defocus;  ///< variance there = base + (defocus * |1/z - 1/focus|)^2
  float inverse_focus;
};

/// Everything a sample depends on.
struct Frame {
  RTCScene scene;
  const Surface* surfaces;
  const float* table;  ///< kTableSize^3 deviates of variance 1 after interpolation
  SightGrid sight;
  Vec3 pupil, axis_x, axis_y, axis_z;  ///< the camera in ct
  float or_light;
  Source microscope_light;
  Projector projector;
};

/// What sixteen samples saw. `microscope` and `nir_irradiance` count where their light is not
/// occluded.
struct alignas(64) Samples {
  float base[kLanes], microscope[kLanes], nir_irradiance[kLanes], nir_albedo[kLanes];
  float depth[kLanes];  ///< along the camera's axis; 0: nothing hit
  int surface[kLanes];  ///< -1: nothing hit
  std::uint8_t sees_microscope_light[kLanes], sees_projector[kLanes];
};

/// Which shadow rays a packet casts; light without them is taken to arrive.
struct ShadowRays {
  bool microscope = true, projector = true;
  bool is_dark_too = false;  ///< the projector's also where its pattern is dark
};

/// What sixteen lines of sight meet, before any light falls on it.
struct alignas(64) Looks {
  /// `t`: along the line, in its direction of z = 1; n: the shading normal, not of unit length.
  enum Value { t, n_x, n_y, n_z, ambient, kValues };
  float value[kValues][kLanes];
  static constexpr int kNothing = -1, kPrint = -2;
  int surface[kLanes];  ///< or kNothing, or kPrint: one with a print, whatever it is
};

/// Looks at 3x3 pixels, two apart, at one even piece of a surface without a print.
struct Nodes {
  float value[Looks::kValues][9];
  int surface;
};

struct Kernel {
  /// Samples at pixels (x, y), not further apart than 4 px; `source_sample` is the point of each
  /// light's disc, `footprint` the side in px over which prints are averaged. Light that is known
  /// to arrive needs no shadow rays.
  void (*trace)(const Frame&, const float* x, const float* y, const int* source_sample,
                float footprint, ShadowRays, Samples&);
  /// Looks at pixels (x, y), not further apart than 8 px.
  void (*look)(const Frame&, const float* x, const float* y, Looks&);
  /// As trace() of 4x4 pixels (rows of x) whose first, third and fifth rows and columns are the
  /// nodes': what lies in between is interpolated.
  void (*trace_between)(const Frame&, const float* x, const float* y, const int* source_sample,
                        const Nodes&, ShadowRays, Samples&);
  /// out[i] = sum_k weights[k + radius] * rows[k + radius][i]
  void (*filter_rows)(const float* const* rows, const float* weights, int radius, int n,
                      float* out);
  /// out[i] = sum_k weights[k + radius] * in[i + k]; `in` is readable radius beyond both ends.
  void (*filter_row)(const float* in, const float* weights, int radius, int n, float* out);
  /// light = base + microscope * m / 64 and nir = irradiance * p / 64, with m, p the 5x5 tent sums
  /// of the rows around (five each, readable two beyond both ends).
  void (*combine)(const float* base, const float* microscope, const float* irradiance,
                  const std::uint8_t* const* sees_light, const std::uint8_t* const* sees_projector,
                  int n, float* light, float* nir);
  /// DN with shot and read noise, rounded and clipped; `deviates` holds 65536 normal deviates.
  void (*expose)(const float* light, const float* deviates, std::uint64_t seed, float read,
                 float shot, float full_scale, int n, std::uint16_t* out);
};

/// The best kernel for this machine. Any thread.
[[nodiscard]] const Kernel& best_kernel() noexcept;

}  // namespace holdfast::sim::kernel
