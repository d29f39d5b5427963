// SPDX-License-Identifier: Apache-2.0
// Which kernels run. The build's base instruction set is x86-64-v2; AVX2 is chosen at run time, per
// function. Every AVX2 kernel has a scalar reference that gives the same bits.
#pragma once

namespace holdfast::registration {

enum class Simd { scalar, avx2 };

/// The best that this CPU has.
[[nodiscard]] inline Simd best_simd() noexcept {
  static const bool has_avx2 = __builtin_cpu_supports("avx2") != 0;
  return has_avx2 ? Simd::avx2 : Simd::scalar;
}

}  // namespace holdfast::registration
