// SPDX-License-Identifier: Apache-2.0
// Between the thread that reads the microscope and the others: its newest look for the control
// loop, and the operator's wish to recover, from the publishing thread.
#pragma once

#include <atomic>

#include "rt/core/mailbox.hpp"
#include "safety/gate.hpp"

namespace holdfast::rt {

struct OpticsInbox {
  Mailbox<safety::OpticsInput> newest;  ///< optics thread to control thread
  /// Set by the publishing thread when the operator arms or acknowledges: the faults of the bus
  /// that stay may be forgotten. Carries no data, so relaxed is enough.
  std::atomic<bool> recovery{false};
};

}  // namespace holdfast::rt
