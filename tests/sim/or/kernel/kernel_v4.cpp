// SPDX-License-Identifier: Apache-2.0
// Compiled for AVX-512 (see CMakeLists.txt).
#define HOLDFAST_KERNEL_NAMESPACE v4
#include "tests/sim/or/kernel/kernel_body.hpp"  // IWYU pragma: keep
