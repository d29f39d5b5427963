// SPDX-License-Identifier: Apache-2.0
// The real head CT of Debian's invesalius-examples, as a smooth field of CT numbers.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

namespace holdfast::sim {

/// Frame head: LPS axes, mm: x = 0.957 * column, y = -0.957 * row, z = 1.5 * slice.
class HeadCt {
 public:
  /// Reads the project archive. Throws UnavailableError when it is absent or not as expected.
  explicit HeadCt(const std::string& path);

  /// CT number (HU) by cubic interpolation (Catmull-Rom); the border's value outside. Any thread.
  [[nodiscard]] float hounsfield(const Eigen::Vector3f& p_head) const noexcept;

  /// Where that package puts it.
  static constexpr const char* kDebianPath =
      "/usr/share/doc/invesalius-examples/examples/Cranium.inv3";

 private:
  std::vector<std::int16_t> values_;  // slices of rows of columns
};

}  // namespace holdfast::sim
