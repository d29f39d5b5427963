// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim stereo`: two GigE Vision cameras on one trigger line, serving image pairs.
#include <cstdio>
#include <ctime>
#include <memory>
#include <string>
#include <utility>

#include <fmt/core.h>
#include <nlohmann/json.hpp>

#include "bridge/command_line.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/camera_control.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/recorded_frames.hpp"
#include "tests/sim/trigger_line.hpp"
#include "tests/sim/virtual_camera.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

constexpr std::chrono::milliseconds kTick{5};

struct Options {
  std::string left, right, control;
  VirtualCameraParameters left_camera, right_camera;
  double rate_hz = 2, duration_s = 0;
  bool json = false;
};

/// One of the two: its images, its device, its faults.
class Half {
 public:
  Half(const std::string& images, VirtualCameraParameters parameters, TriggerLine& line)
      : frames_(images,
                [&line](nanoseconds t) {  // the first pulse shows the first image
                  const std::uint64_t number = line.number_at(t);
                  return static_cast<std::size_t>(number == 0 ? 0 : number - 1);
                }),
        camera_(with_line(std::move(parameters), line), frames_),
        control_(camera_, nullptr, [](nanoseconds, const std::string&, const std::string&) {}) {}

  nanoseconds run(std::string_view line) { return control_.run(line); }
  [[nodiscard]] const RecordedFrames& frames() const noexcept { return frames_; }
  [[nodiscard]] std::uint64_t exposures() const noexcept { return camera_.frames(); }

 private:
  static VirtualCameraParameters with_line(VirtualCameraParameters parameters, TriggerLine& line) {
    parameters.line1 = &line;
    return parameters;
  }
  RecordedFrames frames_;
  VirtualCamera camera_;
  CameraControl control_;
};

class Session {
 public:
  explicit Session(const Options& options)
      : options_(options),
        left_(options.left, options.left_camera, line_),
        right_(options.right, options.right_camera, line_) {
    if (left_.frames().size() != right_.frames().size())
      throw InputError(fmt::format("{} has {} images, {} has {}: they are not pairs", options.left,
                                   left_.frames().size(), options.right, right_.frames().size()));
    if (left_.frames().sensor_px() != right_.frames().sensor_px())
      throw InputError(
          fmt::format("{} and {}: the images differ in size", options.left, options.right));
    if (!options.control.empty())
      socket_ = std::make_unique<ControlSocket>(
          options.control, [this](std::string_view line) { return answer(line); });
    if (options.rate_hz > 0)
      generator_ = std::make_unique<TriggerGenerator>(line_, options.rate_hz);
  }

  void run() {
    const nanoseconds t_end =
        options_.duration_s > 0
            ? rt::monotonic_now() +
                  nanoseconds(static_cast<std::int64_t>(1e9 * options_.duration_s))
            : nanoseconds::max();
    while (!bridge::is_interrupted() && rt::monotonic_now() < t_end) {
      const timespec tick{0, nanoseconds(kTick).count()};
      if (socket_)
        socket_->serve(kTick);
      else
        nanosleep(&tick, nullptr);
    }
  }
  [[nodiscard]] nlohmann::json result() const {
    return {{"left_frames", left_.exposures()}, {"right_frames", right_.exposures()}};
  }

 private:
  nanoseconds answer(std::string_view line) {
    if (line == "fire") return line_.fire().t;
    if (line.starts_with("left ")) return left_.run(line.substr(5));
    if (line.starts_with("right ")) return right_.run(line.substr(6));
    throw InputError(fmt::format("\"{}\": expected fire, left COMMAND or right COMMAND", line));
  }

  const Options& options_;
  TriggerLine line_;
  Half left_, right_;
  std::unique_ptr<ControlSocket> socket_;
  std::unique_ptr<TriggerGenerator> generator_;
};

void run(const Options& options) {
  bridge::catch_interrupts();
  Session session(options);
  std::fprintf(stderr, "cameras %s on %s, %s on %s: ready\n", options.left_camera.serial.c_str(),
               options.left_camera.interface.c_str(), options.right_camera.serial.c_str(),
               options.right_camera.interface.c_str());
  session.run();
  const nlohmann::json result = session.result();
  const std::string text =
      fmt::format("{} left, {} right frames", result["left_frames"].get<std::uint64_t>(),
                  result["right_frames"].get<std::uint64_t>());
  std::puts((options.json ? result.dump() : text).c_str());
}

void add_device_options(CLI::App& command, const std::string& side,
                        VirtualCameraParameters& camera) {
  command.add_option("--" + side + "-interface", camera.interface, "name or address")
      ->capture_default_str();
  command.add_option("--" + side + "-serial", camera.serial, "at most 15 characters")
      ->capture_default_str();
}

}  // namespace

void add_stereo_command(CLI::App& program) {
  const auto options = std::make_shared<Options>();
  options->left_camera.serial = "LEFT";
  options->right_camera.serial = "RIGHT";
  options->right_camera.interface = "127.0.0.2";
  CLI::App& command = *program.add_subcommand(
      "stereo",
      "Two GigE Vision cameras on one trigger line (TriggerSource Line1), serving image pairs.\n"
      "Example: holdfast-sim stereo --left pairs/left --right pairs/right --rate 5");
  command.add_option("--left", options->left, "folder of images or video")->required();
  command.add_option("--right", options->right, "likewise, as many images")->required();
  add_device_options(command, "left", options->left_camera);
  add_device_options(command, "right", options->right_camera);
  command
      .add_option("--rate", options->rate_hz, "triggers a second; 0: only by the control socket")
      ->check(CLI::Range(0.0, 200.0))
      ->capture_default_str();
  command.add_option("--control", options->control,
                     "Unix socket: fire, left COMMAND, right COMMAND");
  command.add_option("--duration", options->duration_s, "s; otherwise until interrupted");
  command.add_flag("--json", options->json, "one JSON object on stdout");
  command.callback([options] { run(*options); });
}

}  // namespace holdfast::sim
