// SPDX-License-Identifier: Apache-2.0
// holdfastd: the whole house wired together.
#pragma once

#include <filesystem>

#include "rt/daemon_config.hpp"

namespace holdfast::rt {

/// Runs until interrupted (bridge/command_line.hpp). Throws subtypes of Error when it cannot start:
/// camera, DDS, real-time scheduling, memory lock or keyframe; no pose and no permission has been
/// published then.
void run_daemon(const DaemonConfig& config);

}  // namespace holdfast::rt
