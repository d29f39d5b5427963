// SPDX-License-Identifier: Apache-2.0
// Adds `serve` to `holdfast-sim`, as the functions of commands.hpp add the others.
#pragma once

namespace CLI {
class App;
}

namespace holdfast::sim {

void add_serve_command(CLI::App& program);

}  // namespace holdfast::sim
