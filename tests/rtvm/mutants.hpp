// SPDX-License-Identifier: Apache-2.0
// The classic ways to break a real-time loop, one each, planted beside the product's cycle: the
// probe must find every one of them before its zeros mean anything.
#pragma once

#include <memory>
#include <string_view>

namespace holdfast::rtvm {

class Mutant {
 public:
  virtual ~Mutant() = default;
  /// In each cycle, on the control thread.
  virtual void act() {}
  /// The loop keeps no absolute grid: each cycle begins a period after the previous one ended.
  [[nodiscard]] virtual bool drifts() const { return false; }
};

/// "none", "malloc", "page_touch", "mutex", "printf" or "grid_drift"; null for any other name.
/// Construct it after the memory is locked, destroy it after the loop has ended.
[[nodiscard]] std::unique_ptr<Mutant> make_mutant(std::string_view name);

}  // namespace holdfast::rtvm
