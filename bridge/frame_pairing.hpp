// SPDX-License-Identifier: Apache-2.0
// Which of two cameras' frames belong together, by stamps and ids alone. Private to StereoSource,
// which has the pixels. No clock, no threads, no heap after construction.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

namespace holdfast::bridge {

enum class Side : std::uint8_t { left, right };

struct PairingParameters {
  std::chrono::nanoseconds skew_max{};          ///< simultaneous up to this, inclusive
  std::chrono::nanoseconds same_trigger_max{};  ///< of one trigger up to this; not below skew_max
  std::chrono::nanoseconds partner_timeout{};
  int capacity = 3;  ///< frames each side may have waiting
};

struct WaitingFrame {
  std::chrono::nanoseconds t_exposure{};
  std::chrono::nanoseconds t_received{};
  std::uint64_t ids_advanced = 0;  ///< since that side's previous frame; 0: unknown
  int slot = 0;                    ///< where the caller keeps the rest
};

enum class Match : std::uint8_t {
  pair,
  skewed,   ///< one trigger's two, further apart than skew_max
  slipped,  ///< simultaneous, but one side's ids have advanced further than frames went unpaired
  left_missing,   ///< `right` alone
  right_missing,  ///< `left` alone
};

struct Matched {
  Match match{};
  std::optional<WaitingFrame> left, right;
};

class FramePairing {
 public:
  explicit FramePairing(const PairingParameters& parameters);

  /// Slots of a side: 0..slots()-1.
  [[nodiscard]] int slots() const noexcept { return parameters_.capacity + 1; }
  /// One that no waiting frame of `side` holds. There is one when next() has been emptied.
  [[nodiscard]] int free_slot(Side side) const noexcept;
  /// Frames of a side come in the order of their exposure.
  void add(Side side, const WaitingFrame& frame) noexcept;
  /// What can be said at `now`; call it after each add() until it is empty. Frames that it names no
  /// longer wait.
  [[nodiscard]] std::optional<Matched> next(std::chrono::nanoseconds now) noexcept;
  /// When next() will have something to say without a further frame; empty: never.
  [[nodiscard]] std::optional<std::chrono::nanoseconds> deadline() const noexcept;

 private:
  struct Queue {
    std::vector<WaitingFrame> frames;  // oldest first; capacity is reserved
    std::uint64_t advanced = 0;        // ids since the last pair
    bool is_known = false;             // ... each of those steps was known
  };
  [[nodiscard]] Queue& of(Side side) noexcept { return queues_[static_cast<std::size_t>(side)]; }
  [[nodiscard]] const Queue& of(Side side) const noexcept {
    return queues_[static_cast<std::size_t>(side)];
  }
  [[nodiscard]] static WaitingFrame pop(Queue& queue) noexcept;
  [[nodiscard]] Matched alone(Side side) noexcept;
  [[nodiscard]] Matched both() noexcept;
  [[nodiscard]] bool has_slipped() const noexcept;

  PairingParameters parameters_;
  std::array<Queue, 2> queues_;
  std::uint64_t unpaired_ = 0;  // frames since the last pair
};

}  // namespace holdfast::bridge
