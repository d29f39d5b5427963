// SPDX-License-Identifier: Apache-2.0
// The tracking study as tables and one self-contained page.
#pragma once

#include <string>

#include "rt/study/tracking_study.hpp"

namespace holdfast::rt {

/// One line a row of the result, with a header. NaN is an empty cell.
[[nodiscard]] std::string tracking_csv(const TrackingResult& result);
/// Likewise of where the beam landed.
[[nodiscard]] std::string beam_csv(const TrackingResult& result);
/// Paper B's Table 1, Table 2, Fig. 6 and Fig. 7 beside ours. Pure: same input, same bytes.
[[nodiscard]] std::string tracking_html(const TrackingSettings& settings,
                                        const TrackingResult& result);

}  // namespace holdfast::rt
