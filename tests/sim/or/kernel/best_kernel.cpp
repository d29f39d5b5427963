// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/kernel/kernel.hpp"

namespace holdfast::sim::kernel {

namespace v2 {
extern const Kernel functions;
}
namespace v3 {
extern const Kernel functions;
}
namespace v4 {
extern const Kernel functions;
}

const Kernel& best_kernel() noexcept {
  static const bool has_avx2 =
      __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0;
  static const bool has_avx512 = has_avx2 && __builtin_cpu_supports("avx512f") != 0 &&
                                 __builtin_cpu_supports("avx512vl") != 0 &&
                                 __builtin_cpu_supports("avx512bw") != 0 &&
                                 __builtin_cpu_supports("avx512dq") != 0;
  return has_avx512 ? v4::functions : has_avx2 ? v3::functions : v2::functions;
}

}  // namespace holdfast::sim::kernel
