// SPDX-License-Identifier: Apache-2.0
#include "rt/commands/pattern_rig.hpp"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <sstream>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "rt/core/error.hpp"

extern char** environ;

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;

/// Runs it to its end with its stdout on our stderr: ours belongs to --json.
int exit_status_of(std::vector<std::string> words) {
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, STDERR_FILENO, STDOUT_FILENO);
  pid_t child = 0;
  const int error =
      posix_spawnp(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0)
    throw UnavailableError(
        fmt::format("--rig {}: cannot be started: {}", words[0], std::strerror(error)));
  int status = 0;
  while (waitpid(child, &status, 0) < 0)
    if (errno != EINTR)
      throw UnavailableError(
          fmt::format("--rig {}: cannot be waited for: {}", words[0], std::strerror(errno)));
  return status;
}

}  // namespace

PatternRig::PatternRig(const std::string& command) {
  std::istringstream words(command);
  for (std::string word; words >> word;) command_.push_back(word);
  if (command_.empty()) throw InputError("--rig: a command is needed");
  std::string name = (fs::temp_directory_path() / "holdfast-pattern-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr)
    throw UnavailableError(name + ": cannot be made: " + std::strerror(errno));
  folder_ = name;
}

PatternRig::~PatternRig() {
  std::error_code ignored;  // a folder left behind in the temporary place harms nobody
  fs::remove_all(folder_, ignored);
}

registration::StereoShot PatternRig::take(double zoom, const cv::Mat& pattern) {
  const std::string file = folder_ + "/pattern.png", left = folder_ + "/left.png",
                    right = folder_ + "/right.png";
  std::vector<uchar> png;
  cv::imencode(".png", pattern, png);
  bridge::write_file_atomically(
      file, std::string_view{reinterpret_cast<const char*>(png.data()), png.size()});
  fs::remove(left);  // so that those of the last pattern cannot be taken for these
  fs::remove(right);
  std::vector<std::string> words = command_;
  words.insert(words.end(),
               {"--zoom", fmt::format("{}", zoom), "--pattern", file, "--out", folder_});
  const int status = exit_status_of(words);
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  if (status != 0)
    throw UnavailableError(
        WIFEXITED(status)
            ? fmt::format("--rig {}: ended with {}, must be 0", command_[0], WEXITSTATUS(status))
            : fmt::format("--rig {}: ended by signal {}", command_[0], WTERMSIG(status)));
  return {bridge::read_image_file(left), bridge::read_image_file(right)};
}

}  // namespace holdfast::rt
