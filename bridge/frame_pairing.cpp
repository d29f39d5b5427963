// SPDX-License-Identifier: Apache-2.0
#include "bridge/frame_pairing.hpp"

#include <algorithm>

namespace holdfast::bridge {

FramePairing::FramePairing(const PairingParameters& parameters) : parameters_(parameters) {
  for (Queue& queue : queues_) queue.frames.reserve(static_cast<std::size_t>(slots()));
}

int FramePairing::free_slot(Side side) const noexcept {
  const auto& frames = of(side).frames;
  for (int slot = 0; slot < slots(); ++slot)
    if (std::ranges::none_of(frames, [slot](const auto& frame) { return frame.slot == slot; }))
      return slot;
  return 0;
}

void FramePairing::add(Side side, const WaitingFrame& frame) noexcept {
  of(side).frames.push_back(frame);
}

std::optional<Matched> FramePairing::next(std::chrono::nanoseconds now) noexcept {
  const auto& left = of(Side::left).frames;
  const auto& right = of(Side::right).frames;
  if (!left.empty() && !right.empty()) {
    const auto skew = left.front().t_exposure - right.front().t_exposure;
    if (std::chrono::abs(skew) <= parameters_.same_trigger_max) return both();
    return alone(skew < skew.zero() ? Side::left : Side::right);
  }
  if (left.empty() && right.empty()) return std::nullopt;
  const Side side = left.empty() ? Side::right : Side::left;
  const auto& waiting = of(side).frames;
  const bool is_full = waiting.size() > static_cast<std::size_t>(parameters_.capacity);
  if (is_full || now - waiting.front().t_received >= parameters_.partner_timeout)
    return alone(side);
  return std::nullopt;
}

std::optional<std::chrono::nanoseconds> FramePairing::deadline() const noexcept {
  for (const Queue& queue : queues_)  // after next() at most one of them has frames
    if (!queue.frames.empty()) return queue.frames.front().t_received + parameters_.partner_timeout;
  return std::nullopt;
}

WaitingFrame FramePairing::pop(Queue& queue) noexcept {
  const WaitingFrame frame = queue.frames.front();
  queue.frames.erase(queue.frames.begin());
  queue.advanced += frame.ids_advanced;
  queue.is_known = queue.is_known && frame.ids_advanced > 0;
  return frame;
}

Matched FramePairing::alone(Side side) noexcept {
  ++unpaired_;
  const WaitingFrame frame = pop(of(side));
  if (side == Side::left) return {Match::right_missing, frame, std::nullopt};
  return {Match::left_missing, std::nullopt, frame};
}

Matched FramePairing::both() noexcept {
  const WaitingFrame left = pop(of(Side::left));
  const WaitingFrame right = pop(of(Side::right));
  Matched matched{Match::pair, left, right};
  if (std::chrono::abs(left.t_exposure - right.t_exposure) > parameters_.skew_max)
    matched.match = Match::skewed;
  else if (has_slipped())
    matched.match = Match::slipped;
  for (Queue& queue : queues_) {
    queue.advanced = 0;
    queue.is_known = true;
  }
  unpaired_ = 0;
  return matched;
}

bool FramePairing::has_slipped() const noexcept {
  const Queue& left = of(Side::left);
  const Queue& right = of(Side::right);
  if (!left.is_known || !right.is_known) return false;
  const std::uint64_t apart =
      std::max(left.advanced, right.advanced) - std::min(left.advanced, right.advanced);
  return apart > unpaired_;
}

}  // namespace holdfast::bridge
