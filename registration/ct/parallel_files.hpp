// SPDX-License-Identifier: Apache-2.0
// Work on numbered files with a few threads. The first failure in file order is the one reported,
// however the threads run.
#pragma once

#include <cstddef>
#include <functional>

namespace holdfast::registration {

/// Calls work(k) for every k below count, on `threads` threads (at least one). `progress` may be
/// empty; it is called one call at a time. After a failure no new work begins; then rethrows the
/// failure of the smallest k.
void for_each_file(std::size_t count, int threads,
                   const std::function<void(std::size_t done, std::size_t total)>& progress,
                   const std::function<void(std::size_t k)>& work);

}  // namespace holdfast::registration
