// SPDX-License-Identifier: Apache-2.0
// A rig (microscope, projector, phantom and its CT scanner) as a program on two pipes: one JSON
// object a line, asked and answered. The virtual one is `holdfast-sim serve`; a real one would be
// another program with the same requests. What it knows of the truth stays in it: only the request
// "depth-error" is answered from it, with figures.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json_fwd.hpp>
#include <sys/types.h>

namespace holdfast::rt {

/// `holdfast-sim` beside the running program.
[[nodiscard]] std::filesystem::path default_rig();

class Rig {
 public:
  /// Starts `program serve`. Throws UnavailableError.
  explicit Rig(const std::filesystem::path& program);
  /// Ends the program: it ends with its input, and is killed when it does not within a second.
  ~Rig();
  Rig(const Rig&) = delete;
  Rig& operator=(const Rig&) = delete;

  /// One thread at a time. Throws RefusedError with the rig's own line when it could not do it,
  /// UnavailableError when the program has ended, InterruptedError after SIGINT or SIGTERM.
  [[nodiscard]] nlohmann::json request(const nlohmann::json& what);

 private:
  [[nodiscard]] std::string read_line();
  std::string name_, unread_;
  pid_t pid_ = -1;
  int to_rig_ = -1, from_rig_ = -1;
};

}  // namespace holdfast::rt
