// SPDX-License-Identifier: Apache-2.0
// Surfaces as the kernel meets them: in an Embree scene, with the OR light that reaches each vertex
// worked out once.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

class LitScene {
 public:
  /// As Renderer().
  LitScene(std::vector<LitSurface> surfaces, const Eigen::Vector3d& n_up_ct);
  ~LitScene();
  LitScene(const LitScene&) = delete;
  LitScene& operator=(const LitScene&) = delete;

  /// Works out the OR light, once; needed before a frame that has any.
  void light_up();

  [[nodiscard]] RTCScene scene() const noexcept { return scene_; }
  [[nodiscard]] const std::vector<kernel::Surface>& kernel_surfaces() const noexcept {
    return kernel_surfaces_;
  }
  [[nodiscard]] const std::vector<LitSurface>& surfaces() const noexcept { return surfaces_; }
  [[nodiscard]] const float* table() const noexcept { return table_.data(); }

 private:
  void add(std::size_t index);
  void make_table();

  std::vector<LitSurface> surfaces_;
  Eigen::Vector3f n_up_ct_;
  RTCDevice device_;
  RTCScene scene_;
  std::vector<std::vector<float>> or_irradiance_;
  std::vector<cv::Mat_<float>> prints_;
  std::vector<kernel::Surface> kernel_surfaces_;
  std::vector<float> table_;
  bool is_lit_ = false;
};

}  // namespace holdfast::sim
