// SPDX-License-Identifier: Apache-2.0
// The queue between the camera thread and the control thread.
#pragma once

#include "rt/control_step.hpp"
#include "rt/core/event_queue.hpp"

namespace holdfast::rt {

using FrameArrivals = EventQueue<FrameArrival, 64>;

}  // namespace holdfast::rt
