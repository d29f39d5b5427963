// SPDX-License-Identifier: Apache-2.0
#define HOLDFAST_KERNEL_NAMESPACE v2
#include "tests/sim/or/kernel/kernel_body.hpp"  // IWYU pragma: keep

namespace holdfast::sim::kernel {

namespace v3 {
void trace(const Frame&, const float*, const float*, const int*, float, Samples&);
void filter_rows(const float* const*, const float*, int, int, float*);
void filter_row(const float*, const float*, int, int, float*);
void combine(const float*, const float*, const float*, const std::uint8_t* const*,
             const std::uint8_t* const*, int, float*, float*);
void expose(const float*, const float*, std::uint64_t, float, float, float, int, std::uint16_t*);
}  // namespace v3

namespace v4 {
void trace(const Frame&, const float*, const float*, const int*, float, Samples&);
void filter_rows(const float* const*, const float*, int, int, float*);
void filter_row(const float*, const float*, int, int, float*);
void combine(const float*, const float*, const float*, const std::uint8_t* const*,
             const std::uint8_t* const*, int, float*, float*);
void expose(const float*, const float*, std::uint64_t, float, float, float, int, std::uint16_t*);
}  // namespace v4

const Kernel& best_kernel() noexcept {
  static const Kernel plain{&v2::trace, &v2::filter_rows, &v2::filter_row, &v2::combine,
                            &v2::expose};
  static const Kernel avx2{&v3::trace, &v3::filter_rows, &v3::filter_row, &v3::combine,
                           &v3::expose};
  static const Kernel avx512{&v4::trace, &v4::filter_rows, &v4::filter_row, &v4::combine,
                             &v4::expose};
  static const bool has_avx2 =
      __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0;
  static const bool has_avx512 = has_avx2 && __builtin_cpu_supports("avx512f") != 0 &&
                                 __builtin_cpu_supports("avx512vl") != 0 &&
                                 __builtin_cpu_supports("avx512bw") != 0 &&
                                 __builtin_cpu_supports("avx512dq") != 0;
  return has_avx512 ? avx512 : has_avx2 ? avx2 : plain;
}

}  // namespace holdfast::sim::kernel
