// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim camera`.
#include <cstdio>
#include <ctime>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include <fmt/core.h>
#include <nlohmann/json.hpp>

#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/camera_control.hpp"
#include "tests/sim/camera_log.hpp"
#include "tests/sim/camera_setup.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/moving_site.hpp"
#include "tests/sim/recorded_frames.hpp"
#include "tests/sim/virtual_camera.hpp"

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;
using std::chrono::nanoseconds;

constexpr std::chrono::milliseconds kTick{5};

const std::map<std::string, PixelFormat> pixel_formats{
    {"Mono8", PixelFormat::mono8},        {"Mono12", PixelFormat::mono12},
    {"BayerRG8", PixelFormat::bayer_rg8}, {"BayerGB8", PixelFormat::bayer_gb8},
    {"BayerGR8", PixelFormat::bayer_gr8}, {"BayerBG8", PixelFormat::bayer_bg8},
    {"RGB8", PixelFormat::rgb8},          {"BGR8", PixelFormat::bgr8}};

struct Options {
  VirtualCameraParameters camera;
  SceneParameters scene;
  std::string sequence, motion = "still", truth, events, setup, control, script;
  double scale = 1, duration_s = 0;
  bool loop = false, json = false;
};

nanoseconds monotonic_now() {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

nanoseconds from_seconds(double seconds) {
  return std::chrono::duration_cast<nanoseconds>(std::chrono::duration<double>(seconds));
}

// The running simulator: pixels, device, control and account.
class Session {
 public:
  explicit Session(const Options& options)
      : options_(options),
        script_(parse_fault_script(options.script)),
        t_start_(monotonic_now()),
        t_logged_(t_start_),
        events_(options.events) {
    if (options.sequence.empty()) {
      site_ = std::make_unique<MovingSite>(options.scene, options.motion, options.scale,
                                           options.loop, t_start_);
      truth_ = std::make_unique<TruthLog>(options.truth, *site_, t_start_);
    } else {
      if (!options.truth.empty())
        throw InputError("--truth: images from files have no known truth");
      sequence_ = std::make_unique<RecordedFrames>(options.sequence);
    }
    FrameSource& source = site_ ? static_cast<FrameSource&>(*site_) : *sequence_;
    camera_ = std::make_unique<VirtualCamera>(
        options.camera, source, [this](const SentFrame& frame) { events_.add(frame); });
    control_ = std::make_unique<CameraControl>(
        *camera_, site_.get(),
        [this](nanoseconds t, const std::string& event, const std::string& detail) {
          events_.add(t, event, detail);
        });
    if (!options.control.empty())
      socket_ = std::make_unique<ControlSocket>(
          options.control, [this](std::string_view line) { return control_->run(line); });
  }

  void run() {
    const nanoseconds t_end =
        options_.duration_s > 0 ? t_start_ + from_seconds(options_.duration_s) : nanoseconds::max();
    while (!bridge::is_interrupted() && monotonic_now() < t_end) {
      run_script();
      account();
      if (socket_)
        socket_->serve(kTick);
      else
        pause();
    }
    account();
    camera_->disconnect();
    if (truth_) truth_->finish();
    events_.finish();
  }

  [[nodiscard]] std::uint64_t frames() const { return camera_->frames(); }

 private:
  void run_script() {
    while (next_ < script_.size() && monotonic_now() >= t_start_ + script_[next_].t)
      control_->run(script_[next_++].line);
  }
  void account() {
    const nanoseconds now = monotonic_now();
    if (truth_) truth_->advance(now);
    if (site_)
      for (const auto& start : site_->starts(t_logged_, now))
        events_.add(start.t, "segment", start.name);
    t_logged_ = now;
  }
  static void pause() {
    const timespec tick{0, std::chrono::nanoseconds(kTick).count()};
    nanosleep(&tick, nullptr);
  }

  const Options& options_;
  const std::vector<ScriptedCommand> script_;
  const nanoseconds t_start_;
  nanoseconds t_logged_;
  std::size_t next_ = 0;
  EventLog events_;
  std::unique_ptr<MovingSite> site_;
  std::unique_ptr<RecordedFrames> sequence_;
  std::unique_ptr<TruthLog> truth_;
  std::unique_ptr<VirtualCamera> camera_;
  std::unique_ptr<CameraControl> control_;
  std::unique_ptr<ControlSocket> socket_;
};

void print(const Options& options, const nlohmann::json& result, const std::string& text) {
  std::fputs((options.json ? result.dump() : text).c_str(), stdout);
  std::fputc('\n', stdout);
}

void run(const Options& options) {
  if (!options.setup.empty()) {
    Scene scene(options.scene);
    write_setup(scene, options.camera.format, options.setup);
    print(options,
          {{"setup", options.setup},
           {"focal_px", scene.focal_px()},
           {"depth_mm", options.scene.depth_mm}},
          fmt::format("{}: keyframe.png, depth.tiff, camera.yaml", options.setup));
    return;
  }
  bridge::catch_interrupts();
  Session session(options);
  std::fprintf(stderr, "camera %s on %s: ready\n", options.camera.serial.c_str(),
               options.camera.interface.c_str());
  session.run();
  print(options, {{"frames", session.frames()}}, fmt::format("{} frames", session.frames()));
}

void add_device_options(CLI::App& command, Options& options) {
  VirtualCameraParameters& camera = options.camera;
  command.add_option("--interface", camera.interface, "network interface, by name or address")
      ->capture_default_str();
  command.add_option("--serial", camera.serial, "serial number, at most 15 characters")
      ->capture_default_str();
  command.add_option("--width", options.scene.width_px, "sensor, px")->capture_default_str();
  command.add_option("--height", options.scene.height_px, "sensor, px")->capture_default_str();
  command
      .add_option_function<std::string>(
          "--format",
          [&camera](const std::string& name) { camera.format = pixel_formats.at(name); },
          "pixel format until a client sets another (default Mono8)")
      ->check(CLI::IsMember(pixel_formats));
  command.add_option("--fps", camera.frame_rate_hz, "frames/s until a client sets another")
      ->capture_default_str();
  command.add_option("--exposure-us", camera.exposure_us, "until a client sets another")
      ->capture_default_str();
  command
      .add_option_function<int>(
          "--readout-us", [&camera](int us) { camera.readout = std::chrono::microseconds(us); },
          "from the end of exposure to the first packet (default 2000)")
      ->check(CLI::Range(0, 50'000));
  command.add_option("--clock-drift-ppm", camera.clock_drift_ppm, "of the camera's clock")
      ->capture_default_str();
}

void add_scene_options(CLI::App& command, Options& options) {
  command.add_option("--sequence", options.sequence,
                     "folder of images or video, instead of a scene");
  command
      .add_option("--motion", options.motion,
                  "segments: still:S linear:F spiral:F bump:MM breathing:S roll:DEG tilt:DEG "
                  "lift:MM, comma-separated")
      ->capture_default_str();
  command.add_option("--scale", options.scale, "multiplies every amplitude")->capture_default_str();
  command.add_flag("--loop", options.loop, "begin the motion again at its end");
  command.add_option("--depth-mm", options.scene.depth_mm, "of the site")->capture_default_str();
  command.add_option("--um-per-px", options.scene.um_per_px, "at the site")->capture_default_str();
  command
      .add_option("--margin-mm", options.scene.margin_mm, "textured beyond the view, on each side")
      ->capture_default_str();
  command.add_option("--noise-dn", options.scene.read_noise_dn, "read noise, of 255")
      ->capture_default_str();
  command.add_option("--glints", options.scene.glints, "specular highlights")
      ->capture_default_str();
  command.add_option("--seed", options.scene.seed, "same seed, same scene")->capture_default_str();
}

}  // namespace

void add_camera_command(CLI::App& program) {
  const auto options = std::make_shared<Options>();
  CLI::App& command = *program.add_subcommand(
      "camera", "A GigE Vision camera over a moving site with known truth.");
  command.footer("Example: holdfast-sim camera --motion still:2,linear:0.2,bump --truth truth.csv");
  add_device_options(command, *options);
  add_scene_options(command, *options);
  command.add_option("--truth", options->truth, "CSV of T_camera_site once a millisecond");
  command.add_option("--events", options->events, "CSV of segments, faults and frames");
  command.add_option("--write-setup", options->setup,
                     "write keyframe.png, depth.tiff, camera.yaml into this folder and end");
  command.add_option("--control", options->control, "Unix socket that takes fault commands");
  command.add_option("--fault-script", options->script, "\"SECONDS:COMMAND;SECONDS:COMMAND\"");
  command.add_option("--duration", options->duration_s, "s; otherwise until interrupted");
  command.add_flag("--json", options->json, "one JSON object on stdout");
  command.callback([options] { run(*options); });
}

}  // namespace holdfast::sim
