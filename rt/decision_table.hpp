// SPDX-License-Identifier: Apache-2.0
// Decisions as rows of text (CSV, one a cycle), for spreadsheets and scripts. docs/recording.md
// explains the columns. Allocates; not for the real-time path.
#pragma once

#include <string>

#include "rt/recording.hpp"

namespace holdfast::rt {

/// The names of the columns, with the line's end.
[[nodiscard]] std::string decision_table_header();

/// Appends the cycle's row to `text`. Numbers are the shortest that read back to the same bits;
/// what is not there (no pose, no sigma, no frame yet) is empty.
void append_decision_row(std::string& text, const RecordedInput& input,
                         const ControlOutput& output);

}  // namespace holdfast::rt
