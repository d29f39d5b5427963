// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/region_tracer.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include <tbb/parallel_for.h>

namespace holdfast::sim {
namespace {

using kernel::kLanes;
using kernel::Looks;
using kernel::Nodes;
using kernel::Samples;
using kernel::ShadowRays;

constexpr int kPacket = 4;            // a packet is 4x4 pixels
constexpr int kLookPackets = 2;       // and of looks, on every second pixel, 8x8
constexpr int kLampPackets = 4;       // from one packet of the shadows' grid to the next, 16 px
constexpr float kBendMm = 0.02F;      // of three depths; interpolating errs by an eighth of it
constexpr float kTurn = 0.3F;         // of the normal across a packet
constexpr float kLampDepthMm = 2.0F;  // between four packets of the shadows' grid
constexpr ShadowRays kLampRays{.microscope = true, .projector = true, .is_dark_too = true};

int in_steps(int length, int step) {
  return (length + step - 1) / step;
}

void store(const Samples& s, int x0, int y0, Seen& seen) {
  const int columns = std::min(kPacket, seen.base.cols - x0);
  const int rows = std::min(kPacket, seen.base.rows - y0);
  for (int j = 0; j < rows; ++j) {
    const int y = y0 + j, from = kPacket * j;
    const auto copy = [columns](const auto* lanes, auto* to) {
      if (columns == kPacket)
        std::copy_n(lanes, kPacket, to);  // of a size that the compiler knows
      else
        std::copy_n(lanes, columns, to);
    };
    copy(s.base + from, seen.base[y] + x0);
    copy(s.microscope + from, seen.microscope[y] + x0);
    copy(s.nir_irradiance + from, seen.irradiance[y] + x0);
    copy(s.nir_albedo + from, seen.albedo[y] + x0);
    copy(s.depth + from, seen.depth[y] + x0);
    copy(s.surface + from, seen.surface[y] + x0);
    copy(s.sees_microscope_light + from, seen.sees_light[y] + x0 + Seen::kMargin);
    copy(s.sees_projector + from, seen.sees_projector[y] + x0 + Seen::kMargin);
  }
}

// Of sixteen lines of sight that meet nothing.
const Samples& nothing() {
  static const Samples samples = [] {
    Samples s{};
    std::fill_n(s.surface, kLanes, -1);
    std::fill_n(s.sees_microscope_light, kLanes, std::uint8_t{0});
    std::fill_n(s.sees_projector, kLanes, std::uint8_t{0});
    return s;
  }();
  return samples;
}

void extend_shadows(int width, int y, Seen& seen) {
  for (cv::Mat_<std::uint8_t>* m : {&seen.sees_light, &seen.sees_projector}) {
    std::uint8_t* p = (*m)[y];
    std::fill_n(p, Seen::kMargin, p[Seen::kMargin]);
    std::fill_n(p + width + Seen::kMargin, Seen::kMargin, p[width + Seen::kMargin - 1]);
  }
}

bool is_bent(float a, float b, float c) {
  return !(std::abs(a - 2 * b + c) < kBendMm);
}

}  // namespace

void RegionTracer::resize(const cv::Rect& region, Seen& seen) {
  packets_x_ = in_steps(region.width, kPacket);
  packets_y_ = in_steps(region.height, kPacket);
  // The last packet's nodes lie one beyond it.
  look_columns_ = 4 * (in_steps(packets_x_, kLookPackets) + 1);
  look_rows_ = 4 * (in_steps(packets_y_, kLookPackets) + 1);
  looks_.resize(static_cast<std::size_t>(look_columns_) * static_cast<std::size_t>(look_rows_));
  lamp_columns_ = in_steps(packets_x_, kLampPackets);
  lamp_rows_ = in_steps(packets_y_, kLampPackets);
  lamps_.resize(static_cast<std::size_t>(lamp_columns_) * static_cast<std::size_t>(lamp_rows_));
  for (cv::Mat_<float>* m :
       {&seen.base, &seen.microscope, &seen.irradiance, &seen.albedo, &seen.depth})
    m->create(region.size());
  seen.surface.create(region.size());
  for (cv::Mat_<std::uint8_t>* m : {&seen.sees_light, &seen.sees_projector})
    m->create(region.height, region.width + 2 * Seen::kMargin);
}

void RegionTracer::look(const kernel::Frame& frame, const cv::Rect& region) {
  const kernel::Kernel& k = kernel::best_kernel();
  tbb::parallel_for(0, look_rows_ / 4, [&](int row) {
    alignas(64) float x[kLanes], y[kLanes];
    Looks found;
    for (int column = 0; column < look_columns_; column += 4) {
      for (int i = 0; i < kLanes; ++i) {
        x[i] = static_cast<float>(region.x + 2 * (column + i % 4));
        y[i] = static_cast<float>(region.y + 2 * (4 * row + i / 4));
      }
      k.look(frame, x, y, found);
      for (int i = 0; i < kLanes; ++i) {
        Look& look = looks_[static_cast<std::size_t>(4 * row + i / 4) *
                                static_cast<std::size_t>(look_columns_) +
                            static_cast<std::size_t>(column + i % 4)];
        for (int v = 0; v < Looks::kValues; ++v) look.value[v] = found.value[v][i];
        look.surface = found.surface[i];
      }
    }
  });
}

// One even piece of surface, or nothing at all, under the packet and a pixel beyond: its nodes.
bool RegionTracer::is_even_around(int bx, int by, Nodes& nodes) const {
  const Look* rows[3];
  for (int j = 0; j < 3; ++j)
    rows[j] = looks_.data() +
              static_cast<std::size_t>(2 * by + j) * static_cast<std::size_t>(look_columns_) +
              static_cast<std::size_t>(2 * bx);
  nodes.surface = rows[0][0].surface;
  if (nodes.surface == Looks::kPrint) return false;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      if (rows[j][i].surface != nodes.surface) return false;
  if (nodes.surface == Looks::kNothing) return true;
  const auto t = [&](int j, int i) { return rows[j][i].value[Looks::t]; };
  for (int i = 0; i < 3; ++i)
    if (is_bent(t(i, 0), t(i, 1), t(i, 2)) || is_bent(t(0, i), t(1, i), t(2, i))) return false;
  if (is_bent(t(0, 0), t(1, 1), t(2, 2)) || is_bent(t(0, 2), t(1, 1), t(2, 0))) return false;
  for (const int v : {Looks::n_x, Looks::n_y, Looks::n_z})
    if (std::abs(rows[0][0].value[v] - rows[2][2].value[v]) > kTurn ||
        std::abs(rows[0][2].value[v] - rows[2][0].value[v]) > kTurn)
      return false;
  for (int v = 0; v < Looks::kValues; ++v)
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i) nodes.value[v][3 * j + i] = rows[j][i].value[v];
  return true;
}

void RegionTracer::trace_packet(const kernel::Frame& frame, const cv::Rect& region, int bx, int by,
                                ShadowRays rays, Seen& seen, Samples& samples) const {
  Nodes nodes;
  const bool is_even = rays_ == Rays::where_needed && is_even_around(bx, by, nodes);
  alignas(64) float x[kLanes], y[kLanes];
  alignas(64) int source[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    x[i] = static_cast<float>(region.x + kPacket * bx + i % kPacket);
    y[i] = static_cast<float>(region.y + kPacket * by + i / kPacket);
    source[i] = i;
  }
  const kernel::Kernel& k = kernel::best_kernel();
  if (is_even && nodes.surface == Looks::kNothing)
    samples = nothing();
  else if (is_even)
    k.trace_between(frame, x, y, source, nodes, rays, samples);
  else
    k.trace(frame, x, y, source, 1.F, rays, samples);
  store(samples, kPacket * bx, kPacket * by, seen);
}

// None where the four packets of the grid around lie on one even piece of surface in full light.
ShadowRays RegionTracer::shadow_rays(int bx, int by) const {
  const int cx = bx / kLampPackets, cy = by / kLampPackets;
  if (rays_ == Rays::all || cx + 1 >= lamp_columns_ || cy + 1 >= lamp_rows_) return {};
  const Lamp* const around[] = {&lamp(cx, cy), &lamp(cx + 1, cy), &lamp(cx, cy + 1),
                                &lamp(cx + 1, cy + 1)};
  ShadowRays rays{.microscope = false, .projector = false, .is_dark_too = false};
  float nearest = around[0]->nearest, farthest = around[0]->farthest;
  for (const Lamp* l : around) {
    if (l->surface < 0 || l->surface != around[0]->surface) return {};
    nearest = std::min(nearest, l->nearest);
    farthest = std::max(farthest, l->farthest);
    rays.microscope = rays.microscope || !l->has_microscope_light;
    rays.projector = rays.projector || !l->has_projector_light;
  }
  return farthest - nearest < kLampDepthMm ? rays : ShadowRays{};
}

void RegionTracer::trace(const kernel::Frame& frame, const cv::Rect& region, Rays rays,
                         Seen& seen) {
  rays_ = rays;
  resize(region, seen);
  if (rays == Rays::where_needed) look(frame, region);
  tbb::parallel_for(0, lamp_rows_, [&](int row) {
    Samples s;
    for (int column = 0; column < lamp_columns_; ++column) {
      trace_packet(frame, region, kLampPackets * column, kLampPackets * row, kLampRays, seen, s);
      Lamp found{s.surface[0], s.depth[0], s.depth[0]};
      for (int i = 0; i < kLanes; ++i) {
        if (s.surface[i] != found.surface) found.surface = -1;
        found.nearest = std::min(found.nearest, s.depth[i]);
        found.farthest = std::max(found.farthest, s.depth[i]);
        found.has_microscope_light &= s.sees_microscope_light[i] != 0;
        found.has_projector_light &= s.sees_projector[i] != 0;
      }
      lamps_[static_cast<std::size_t>(row) * static_cast<std::size_t>(lamp_columns_) +
             static_cast<std::size_t>(column)] = found;
    }
  });
  tbb::parallel_for(0, packets_y_, [&](int by) {
    Samples s;
    for (int bx = 0; bx < packets_x_; ++bx) {
      if (bx % kLampPackets == 0 && by % kLampPackets == 0) continue;
      trace_packet(frame, region, bx, by, shadow_rays(bx, by), seen, s);
    }
    for (int y = kPacket * by; y < std::min(region.height, kPacket * (by + 1)); ++y)
      extend_shadows(region.width, y, seen);
  });
}

}  // namespace holdfast::sim
