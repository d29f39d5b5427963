// SPDX-License-Identifier: Apache-2.0
// Compiled for AVX2 and FMA (see CMakeLists.txt).
#define HOLDFAST_KERNEL_NAMESPACE v3
#include "tests/sim/or/kernel/kernel_body.hpp"  // IWYU pragma: keep
