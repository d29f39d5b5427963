// SPDX-License-Identifier: Apache-2.0
// An observer in virtual time, and the senders that it hears.
#pragma once

#include <chrono>
#include <cstdint>

#include <gtest/gtest.h>

#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/topics.hpp"
#include "rt/observer/observed_state.hpp"

namespace holdfast::observer {

class ObservedRoom : public ::testing::Test {
 protected:
  static constexpr std::uint32_t kDaemon = 7, kGuard = 8;  ///< sources

  [[nodiscard]] bridge::dds::Clocks clocks() const {
    return {now_, now_ + std::chrono::seconds(1'700'000'000)};
  }
  /// Protected as its sender does it, and heard at once.
  template <class M>
  void send(M message, std::uint32_t source = kDaemon) {
    bridge::dds::protect(message, source, ++counter_, bridge::dds::Topic<M>::policy().validity,
                         clocks());
    state_.take(message, clocks());
  }

  ObservedState state_{ObserverParameters{}};
  std::chrono::nanoseconds now_ = std::chrono::seconds(1000);
  std::uint32_t counter_ = 0;
};

}  // namespace holdfast::observer
