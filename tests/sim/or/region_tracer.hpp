// SPDX-License-Identifier: Apache-2.0
// Part of the renderer: what each pixel of a region sees, and which lights reach it, with the rays
// saved that would find nothing new.
//
// Lines of sight are cast at every second pixel of every second row. Where 3x3 of them meet one
// even piece of a surface, depth, normal and OR light of the pixels in between are interpolated.
// Shadow rays are cast from all pixels of every fourth packet; where four such packets meet one
// piece of surface in full light, those in between need none.
#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/renderer.hpp"

namespace holdfast::sim {

/// A value a pixel, in arrays that are kept from frame to frame.
struct Seen {
  static constexpr int kMargin = 2;  ///< columns beyond both ends of a row of shadows
  cv::Mat_<float> base, microscope, irradiance, albedo, depth;
  cv::Mat_<std::uint8_t> sees_light, sees_projector;
  cv::Mat_<std::int16_t> surface;
};

class RegionTracer {
 public:
  /// Fills `seen`, resized to the region. All cores; one thread at a time.
  void trace(const kernel::Frame& frame, const cv::Rect& region, Rays rays, Seen& seen);

 private:
  struct Look {
    float value[kernel::Looks::kValues];
    std::int32_t surface;
  };
  /// What one packet of every fourth found.
  struct Lamp {
    int surface = -1;  ///< of all its samples; -1: of different ones
    float nearest = 0, farthest = 0;
    bool has_microscope_light = true, has_projector_light = true;  ///< all of it
  };

  void resize(const cv::Rect& region, Seen& seen);
  void look(const kernel::Frame& frame, const cv::Rect& region);
  void trace_packet(const kernel::Frame& frame, const cv::Rect& region, int bx, int by,
                    kernel::ShadowRays rays, Seen& seen, kernel::Samples& samples) const;
  [[nodiscard]] bool is_even_around(int bx, int by, kernel::Nodes& nodes) const;
  [[nodiscard]] kernel::ShadowRays shadow_rays(int bx, int by) const;
  [[nodiscard]] const Lamp& lamp(int cx, int cy) const {
    return lamps_[static_cast<std::size_t>(cy) * static_cast<std::size_t>(lamp_columns_) +
                  static_cast<std::size_t>(cx)];
  }

  Rays rays_ = Rays::all;
  int packets_x_ = 0, packets_y_ = 0;
  int look_columns_ = 0, look_rows_ = 0, lamp_columns_ = 0, lamp_rows_ = 0;
  std::vector<Look> looks_;
  std::vector<Lamp> lamps_;
};

}  // namespace holdfast::sim
