// SPDX-License-Identifier: Apache-2.0
// The kernel's code, included by one source file for each instruction set, each with its own
// HOLDFAST_KERNEL_NAMESPACE: best_kernel.cpp chooses among them.
#pragma once

#include "tests/sim/or/kernel/between.hpp"
#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/rows.hpp"
#include "tests/sim/or/kernel/trace.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {

extern const Kernel functions;
constexpr Kernel functions{&trace,      &look,    &trace_between, &filter_rows,
                           &filter_row, &combine, &expose};

}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
