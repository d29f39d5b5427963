// SPDX-License-Identifier: Apache-2.0
// Which kernels run. The build's base instruction set is x86-64-v2; AVX2 with FMA is chosen at run
// time, per function.
#pragma once

namespace holdfast::perception {

enum class Simd { scalar, avx2 };

/// The best that this CPU has.
[[nodiscard]] inline Simd best_simd() noexcept {
  static const bool has_avx2 =
      __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0;
  return has_avx2 ? Simd::avx2 : Simd::scalar;
}

}  // namespace holdfast::perception
