// SPDX-License-Identifier: Apache-2.0
// `holdfast demo`: hands over to the virtual operating room, which is a program of its own because
// it alone knows the truth.
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <unistd.h>

#include "rt/commands/commands.hpp"
#include "rt/commands/rig_commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {

void add_demo(CLI::App& app) {
  CLI::App* command = app.add_subcommand(
      "demo",
      "The whole chain on the virtual operating room; options as holdfast-sim demo --help.\n"
      "demo --setup: what comes before it, from calibration to registration.");
  command->set_help_flag();  // --help goes through too
  command->prefix_command();
  command->callback([command] {
    std::vector<std::string> given = command->remaining();
    if (const auto setup = std::find(given.begin(), given.end(), "--setup"); setup != given.end()) {
      given.erase(setup);
      run_demo_setup(std::move(given));
      return;
    }
    const std::filesystem::path program =
        std::filesystem::read_symlink("/proc/self/exe").parent_path() / "holdfast-sim";
    std::vector<std::string> words{program.string(), "demo"};
    for (const std::string& word : given) words.push_back(word);
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    execv(program.c_str(), arguments.data());
    throw UnavailableError(fmt::format("{}: {}", program.string(), std::strerror(errno)));
  });
}

}  // namespace holdfast::rt
