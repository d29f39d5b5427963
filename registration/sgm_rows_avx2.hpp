// SPDX-License-Identifier: Apache-2.0
// The AVX2 versions of sgm_rows.hpp's loops: called by those, and by nobody else.
#pragma once

#include "registration/sgm_rows.hpp"

namespace holdfast::registration::sgm::avx2 {

void cost_row(const Row& row, const std::int32_t* left, const std::int32_t* right,
              std::uint8_t* cost);
void aggregate_along(const Row& row, const std::uint8_t* cost, Penalties penalties,
                     std::uint8_t* sum);
void aggregate_down(const Row& row, const std::int16_t* before_base, const std::uint8_t* cost,
                    Penalties penalties, const Gains& before, const Gains& now, std::uint8_t* sum);
void choose(const Row& row, const std::uint8_t* cost, const std::uint8_t* sum, const Choice& out);

}  // namespace holdfast::registration::sgm::avx2
