// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/rig.hpp"

#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <thread>

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/key_store.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using namespace std::chrono_literals;

constexpr auto kLook = 2ms;  // how often the observer looks for messages
constexpr auto kStartPatience = 10s;
constexpr auto kEndPatience = 5000ms;

/// The last line a process wrote, for the message that says it is gone.
std::string last_line(const std::filesystem::path& log) {
  std::string line, last;
  if (std::FILE* file = std::fopen(log.c_str(), "r"); file != nullptr) {
    std::array<char, 1024> buffer{};
    while (std::fgets(buffer.data(), static_cast<int>(buffer.size()), file) != nullptr)
      last = buffer.data();
    std::fclose(file);
  }
  while (!last.empty() && last.back() == '\n') last.pop_back();
  return last;
}

/// One line to a control socket; when it took effect, CLOCK_MONOTONIC.
std::chrono::nanoseconds ask(int control, const char* whom, const std::string& command) {
  const std::string line = command + "\n";
  if (send(control, line.data(), line.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(line.size()))
    throw UnavailableError(fmt::format("{}: {}", whom, std::strerror(errno)));
  std::string answer;
  char c = 0;
  while (recv(control, &c, 1, 0) == 1 && c != '\n') answer += c;
  std::int64_t t_ns = 0;
  if (!answer.starts_with("ok ") ||
      std::from_chars(answer.data() + 3, answer.data() + answer.size(), t_ns).ec != std::errc{})
    throw UnavailableError(fmt::format("{}, '{}': {}", whom, command, answer));
  return std::chrono::nanoseconds{t_ns};
}

}  // namespace

Rig::Rig(const RigParameters& parameters)
    : folder_(std::filesystem::absolute(parameters.folder)),
      domain_(parameters.domain),
      camera_address_(parameters.camera_address) {
  std::filesystem::create_directories(folder_);
  for (const char* old : {"camera.log", "microscope.log", "daemon.log", "guard.log", "robot.log",
                          "operator.log", "robot.csv", "truth.csv", "events.csv"})
    std::filesystem::remove(folder_ / old);
  const auto sim = program_folder() / "holdfast-sim";
  ChildProcess setup{
      sim,
      {"camera", "--write-setup", folder_.string(), "--seed", std::to_string(parameters.seed)},
      folder_ / "camera.log"};
  if (setup.wait(60'000ms) != 0)
    throw UnavailableError("set-up failed: " + last_line(folder_ / "camera.log"));
  write_registration(folder_);
  const std::filesystem::path config = folder_ / "holdfastd.toml";
  std::filesystem::copy_file(parameters.daemon_config, config,
                             std::filesystem::copy_options::overwrite_existing);
  config_ = rt::load_daemon_config(config);
  if (parameters.is_secured) make_keys();

  bridge::dds::ParticipantParameters observer;
  observer.domain = static_cast<std::uint32_t>(domain_);
  if (!keys_.empty()) observer.security = keys_ / "observer";
  participant_ = std::make_unique<bridge::dds::Participant>(observer);
  stops_ = std::make_unique<bridge::dds::Reader<msg::MotionStop>>(*participant_);
  health_ = std::make_unique<bridge::dds::Reader<msg::TrackingHealth>>(*participant_);

  start_camera(parameters);
  if (!config_.optics.local.empty()) start_microscope();
  const std::string domain = std::to_string(domain_);
  robot_.emplace(sim,
                 identified("robot", {"robot", "--domain", domain, "--log", robot_file().string()}),
                 folder_ / "robot.log");
  if (parameters.has_operator)
    operator_.emplace(
        sim,
        identified("operator", {"operator", "--domain", domain, "--auto", "--reaction-ms", "100"}),
        folder_ / "operator.log");
  start_daemon();
  start_guard(parameters);
}

Rig::~Rig() {
  try {
    finish();  // so that the logs are whole also when something went wrong
  } catch (
      ...) {  // NOLINT(bugprone-empty-catch): the error that brought us here is the one to report
  }
  for (const int control : {camera_control_, microscope_control_})
    if (control >= 0) close(control);
}

void Rig::make_keys() {
  keys_ = folder_ / "keys";
  std::filesystem::remove_all(keys_);
  constexpr std::chrono::days kValidity{1};
  // Longer than what they sign, however long the making takes.
  bridge::make_authorities(keys_ / "authority", 2 * kValidity);
  for (const bridge::dds::RoleRights& rights : bridge::dds::role_rights()) {
    const std::string role{rights.role};
    bridge::make_participant(keys_ / "authority", keys_ / role, rights, role, kValidity);
  }
}

std::vector<std::string> Rig::identified(const std::string& role,
                                         std::vector<std::string> words) const {
  if (!keys_.empty()) words.insert(words.end(), {"--security", (keys_ / role).string()});
  return words;
}

void Rig::start_camera(const RigParameters& parameters) {
  camera_.emplace(program_folder() / "holdfast-sim",
                  std::vector<std::string>{
                      "camera", "--interface", camera_address_, "--motion", parameters.motion,
                      "--seed", std::to_string(parameters.seed), "--truth", truth_file().string(),
                      "--events", events_file().string(), "--control", folder_ / "camera.sock"},
                  folder_ / "camera.log");
  camera_control_ = connect_control("camera.sock");
}

void Rig::start_microscope() {
  microscope_.emplace(
      program_folder() / "holdfast-sim",
      std::vector<std::string>{"can", "--local", config_.optics.local.string(), "--zoom",
                               fmt::format("{}", config_.registration.zoom), "--focus-mm",
                               fmt::format("{}", config_.registration.focus_mm), "--control",
                               folder_ / "knob.sock"},
      folder_ / "microscope.log");
  microscope_control_ = connect_control("knob.sock");
}

void Rig::start_daemon() {
  daemon_.emplace(program_folder() / "holdfastd",
                  identified("daemon", {"--config", folder_ / "holdfastd.toml", "--domain",
                                        std::to_string(domain_), "--camera", camera_address_}),
                  folder_ / "daemon.log");
}

void Rig::start_guard(const RigParameters& parameters) {
  const std::filesystem::path config = folder_ / "guard.toml";
  std::filesystem::copy_file(parameters.guard_config, config,
                             std::filesystem::copy_options::overwrite_existing);
  guard_.emplace(program_folder() / "holdfast-guard",
                 identified("guard", {"--config", config, "--domain", std::to_string(domain_)}),
                 folder_ / "guard.log");
}

int Rig::connect_control(const std::string& name) {
  const int control = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string path = folder_ / name;
  if (path.size() >= sizeof(address.sun_path))
    throw InputError(fmt::format("{}: longer than a socket's name may be ({} characters)", path,
                                 sizeof(address.sun_path) - 1));
  std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
  const auto deadline = rt::monotonic_now() + kStartPatience;
  // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): the socket API's own convention
  while (connect(control, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    require_running();
    if (rt::monotonic_now() > deadline)
      throw UnavailableError(fmt::format("{}: {}", path, std::strerror(errno)));
    std::this_thread::sleep_for(10ms);
  }
  return control;
}

std::chrono::nanoseconds Rig::inject(const std::string& command) {
  return ask(camera_control_, "virtual camera", command);
}

std::chrono::nanoseconds Rig::turn(const std::string& command) {
  return ask(microscope_control_, "virtual microscope", command);
}

void Rig::require_running() {
  const auto check = [this](std::optional<ChildProcess>& process, const char* log) {
    if (process && !process->is_running())
      throw UnavailableError(fmt::format("{} ended: {}", log, last_line(folder_ / log)));
  };
  check(camera_, "camera.log");
  check(microscope_, "microscope.log");
  check(daemon_, "daemon.log");
  check(guard_, "guard.log");
  check(robot_, "robot.log");
  check(operator_, "operator.log");
}

bool Rig::wait_until(const std::function<bool(const msg::MotionStop&)>& holds,
                     std::chrono::nanoseconds patience) {
  const auto deadline = rt::monotonic_now() + patience;
  while (true) {
    listen();
    if (newest_ && holds(*newest_)) return true;
    if (rt::monotonic_now() > deadline) return false;
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    require_running();
    std::this_thread::sleep_for(kLook);
  }
}

void Rig::listen() {
  for (const msg::MotionStop& stop : stops_->take()) newest_ = stop;
  for (const msg::TrackingHealth& health : health_->take()) {
    tracker_us_[health.frame] = health.tracker_us;
    health_csv_ += fmt::format("{},{},{},{},{},{:.3f},{:.3f},{:.3f},{:.4f},{},{}\n", health.frame,
                               health.t_exposure_ns, health.status, health.reason, health.inliers,
                               health.dx_um, health.dy_um, health.drift_um, health.sigma_target_mm,
                               health.tracker_us, health.wake_lateness_max_us);
  }
}

bool Rig::wait_permitted(std::chrono::nanoseconds patience) {
  return wait_until([](const msg::MotionStop& stop) { return stop.is_permitted; }, patience);
}

bool Rig::wait_withdrawn(std::chrono::nanoseconds patience) {
  return wait_until([](const msg::MotionStop& stop) { return !stop.is_permitted; }, patience);
}

void Rig::run_for(std::chrono::nanoseconds duration) {
  (void)wait_until([](const msg::MotionStop&) { return false; }, duration);
}

std::chrono::nanoseconds Rig::kill_daemon() {
  const auto t = rt::monotonic_now();
  daemon_->kill_now();
  daemon_.reset();
  newest_.reset();
  return t;
}

void Rig::restart_daemon() {
  start_daemon();
}

void Rig::finish() {
  for (auto* process : {&operator_, &robot_, &guard_, &daemon_, &microscope_, &camera_})
    if (*process) (void)(*process)->end(kEndPatience);
  bridge::write_file_atomically(
      (folder_ / "health.csv").string(),
      "frame,t_exposure_ns,status,reason,inliers,dx_um,dy_um,drift_um,sigma_target_mm,tracker_us,"
      "wake_lateness_max_us\n" +
          health_csv_);
}

}  // namespace holdfast::sim
