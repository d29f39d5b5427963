// SPDX-License-Identifier: Apache-2.0
// Compiled for what every x86-64 has (see CMakeLists.txt).
#define HOLDFAST_KERNEL_NAMESPACE v2
#include "tests/sim/or/kernel/kernel_body.hpp"  // IWYU pragma: keep
