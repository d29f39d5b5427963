// SPDX-License-Identifier: Apache-2.0
// The virtual operating room with the real programs in it: virtual camera and microscope,
// holdfastd, virtual robot and operator, guard, each its own process, talking GigE Vision, CAN
// frames over a local bus, and DDS.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bridge/dds/endpoint.hpp"
#include "rt/daemon_config.hpp"
#include "tests/sim/demo/child_process.hpp"

namespace holdfast::sim {

struct RigParameters {
  std::filesystem::path folder;         ///< everything is written here
  std::filesystem::path daemon_config;  ///< copied into the folder
  std::filesystem::path guard_config;   ///< likewise
  int domain = 77;
  std::string camera_address = "127.0.0.1";
  std::string motion = "still";  ///< `holdfast-sim camera --motion`
  std::uint64_t seed = 1;
  bool has_operator = true;  ///< false: the test gives the operator's commands
  bool is_secured = false;   ///< keys are made in the folder, and everybody uses them
};

class Rig {
 public:
  /// Writes the set-up (keyframe, depth, calibration, registration) and starts all processes.
  /// Throws Error when one does not start.
  explicit Rig(const RigParameters& parameters);
  ~Rig();
  Rig(const Rig&) = delete;
  Rig& operator=(const Rig&) = delete;

  /// Watches the daemon's motion-stop messages until `holds` or `patience` is over; throws
  /// UnavailableError when a process ends meanwhile (its log names the reason).
  bool wait_until(const std::function<bool(const msg::MotionStop&)>& holds,
                  std::chrono::nanoseconds patience);
  bool wait_permitted(std::chrono::nanoseconds patience);
  bool wait_withdrawn(std::chrono::nanoseconds patience);
  /// Lets the scene run.
  void run_for(std::chrono::nanoseconds duration);

  /// One line to the virtual camera's control socket; when it took effect, CLOCK_MONOTONIC.
  std::chrono::nanoseconds inject(const std::string& command);

  /// One line to the virtual microscope ("zoom 1.3"); when it took effect, CLOCK_MONOTONIC. The
  /// image stays as it is: the encoder alone must stop the robot.
  std::chrono::nanoseconds turn(const std::string& command);

  /// SIGKILL to the daemon; the instant just before. restart_daemon() brings it back.
  std::chrono::nanoseconds kill_daemon();
  void restart_daemon();
  [[nodiscard]] pid_t daemon_pid() const { return daemon_.value().pid(); }

  /// Ends every process so that its log is whole.
  void finish();

  /// The tracker's time by frame, from the health messages seen while waiting or running.
  [[nodiscard]] const std::map<std::uint64_t, std::uint32_t>& tracker_us() const noexcept {
    return tracker_us_;
  }
  [[nodiscard]] const rt::DaemonConfig& config() const noexcept { return config_; }
  [[nodiscard]] std::filesystem::path truth_file() const { return folder_ / "truth.csv"; }
  [[nodiscard]] std::filesystem::path events_file() const { return folder_ / "events.csv"; }
  [[nodiscard]] std::filesystem::path robot_file() const { return folder_ / "robot.csv"; }

 private:
  void make_keys();
  /// `words`, and who `role` is when the rig is secured.
  [[nodiscard]] std::vector<std::string> identified(const std::string& role,
                                                    std::vector<std::string> words) const;
  void start_camera(const RigParameters& parameters);
  void start_microscope();
  void start_daemon();
  void start_guard(const RigParameters& parameters);
  void require_running();
  void listen();
  [[nodiscard]] int connect_control(const std::string& name);

  std::filesystem::path folder_;
  int domain_;
  std::string camera_address_;
  std::filesystem::path keys_;  ///< a folder a role; empty: unsecured
  rt::DaemonConfig config_;
  std::unique_ptr<bridge::dds::Participant> participant_;
  std::unique_ptr<bridge::dds::Reader<msg::MotionStop>> stops_;
  std::unique_ptr<bridge::dds::Reader<msg::TrackingHealth>> health_;
  std::optional<msg::MotionStop> newest_;
  std::map<std::uint64_t, std::uint32_t> tracker_us_;
  std::string health_csv_;  ///< health.csv, written by finish()
  std::optional<ChildProcess> camera_, microscope_, daemon_, guard_, robot_, operator_;
  int camera_control_ = -1, microscope_control_ = -1;
};

/// Writes registration.json for the set-up files in `folder`: where the simulator put the CT, its
/// target on the optical axis at the site.
void write_registration(const std::filesystem::path& folder);

}  // namespace holdfast::sim
