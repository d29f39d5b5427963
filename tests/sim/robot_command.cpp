// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim robot`: a robot controller that knows Holdfast only through holdfast::client, and
// writes down what it did and when.
#include <array>
#include <cinttypes>
#include <cstdio>
#include <ctime>
#include <memory>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "bridge/client/client.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "safety/gate.hpp"
#include "tests/sim/commands.hpp"

namespace holdfast::sim {
namespace {

using client::Permission;
using client::Refusal;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

struct RobotOptions {
  client::Parameters client;
  std::string log_file;
  double duration_s = 0;  ///< 0: until interrupted
  double rate_hz = 1000;
  double fault_at_s = -1;
  bool has_json = false;
  bool is_without_guard = false;
  bool is_disobedient = false;  ///< reports that it is enabled, whatever it was told
};

nanoseconds monotonic_now() {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

nanoseconds from_seconds(double s) {
  return std::chrono::duration_cast<nanoseconds>(std::chrono::duration<double>(s));
}

// A CSV file that appears under its name when it is complete.
class Log {
 public:
  explicit Log(std::string name) : name_(std::move(name)) {
    if (name_.empty()) return;
    file_.reset(std::fopen(part().c_str(), "w"));
    if (!file_) throw InputError("cannot write " + part());
    constexpr std::size_t kBuffer = 1 << 20;
    (void)std::setvbuf(file_.get(), nullptr, _IOFBF, kBuffer);
    std::fputs(
        "event,t_monotonic_ns,permitted,refusal,t_permission_end_ns,frame,first_of_frame,counter,"
        "t_pose_ns,t_exposure_ns,t_frame_received_ns,t_valid_until_ns,tx_mm,ty_mm,tz_mm,qx,qy,qz,"
        "qw,target_x_mm,target_y_mm,target_z_mm,mode,cause,is_latched,stop_id,t_changed_ns,"
        "t_evidence_ns,t_stop_received_ns\n",
        file_.get());
  }
  ~Log() {
    if (file_) std::remove(part().c_str());  // not closed: not complete
  }
  Log(const Log&) = delete;
  Log& operator=(const Log&) = delete;

  void write(const char* event, const Permission& p, std::int64_t t_end_ns, bool is_first) {
    if (!file_) return;
    std::fprintf(file_.get(), "%s,%" PRId64 ",%d,%s,", event, p.t_ns, p.is_permitted() ? 1 : 0,
                 name(p.refusal).data());
    if (t_end_ns > 0) std::fprintf(file_.get(), "%" PRId64, t_end_ns);
    write_pose(p.pose, is_first);
    const auto& s = p.stop;
    std::fprintf(file_.get(), ",%s,%s,%d,%" PRIu32 ",%" PRId64 ",%" PRId64 ",%" PRId64 "\n",
                 safety::name(static_cast<safety::Mode>(s.mode)).data(),
                 safety::name(static_cast<safety::Reason>(s.cause)).data(), s.is_latched ? 1 : 0,
                 s.stop_id, s.t_changed_ns, s.t_evidence_ns, s.t_received_ns);
  }
  void close() {
    if (!file_) return;
    const bool is_written = std::fflush(file_.get()) == 0 && std::ferror(file_.get()) == 0;
    if (!is_written || std::rename(part().c_str(), name_.c_str()) != 0)
      throw InputError("cannot write " + name_);
    file_.reset();
  }

 private:
  struct Close {
    void operator()(std::FILE* f) const { (void)std::fclose(f); }
  };
  [[nodiscard]] std::string part() const { return name_ + ".part"; }
  void write_pose(const std::optional<client::Pose>& pose, bool is_first) {
    if (!pose) {
      std::fputs(",,,,,,,,,,,,,,,,,", file_.get());
      return;
    }
    std::fprintf(file_.get(),
                 ",%" PRIu64 ",%d,%" PRIu32 ",%" PRId64 ",%" PRId64 ",%" PRId64 ",%" PRId64,
                 pose->frame, is_first ? 1 : 0, pose->counter, pose->t_pose_ns, pose->t_exposure_ns,
                 pose->t_frame_received_ns, pose->t_valid_until_ns);
    for (const double v : pose->translation_mm) std::fprintf(file_.get(), ",%.9g", v);
    for (const double v : pose->rotation_xyzw) std::fprintf(file_.get(), ",%.12g", v);
    for (const double v : pose->target_robot_mm) std::fprintf(file_.get(), ",%.9g", v);
  }

  std::string name_;
  std::unique_ptr<std::FILE, Close> file_;
};

class Robot {
 public:
  explicit Robot(const RobotOptions& options)
      : options_(options), log_(options.log_file), client_(options.client) {}

  void run() {
    const nanoseconds start = monotonic_now();
    const nanoseconds end =
        options_.duration_s > 0 ? start + from_seconds(options_.duration_s) : nanoseconds::max();
    const nanoseconds fault =
        options_.fault_at_s >= 0 ? start + from_seconds(options_.fault_at_s) : nanoseconds::max();
    nanoseconds next_report = start;
    for (nanoseconds now = start; now < end && !bridge::is_interrupted(); now = monotonic_now()) {
      if (!has_fault_ && now >= fault) {
        has_fault_ = true;
        next_report = now;  // at once
      }
      if (now >= next_report) {
        (void)client_.report(
            {is_moving_ || options_.is_disobedient, has_fault_, has_fault_ ? 1U : 0U});
        next_report = now + kReportPeriod;
      }
      client_.wait(std::min({next_report, end, fault > now ? fault : end}) - now);
      if (act(client_.poll())) next_report = {};  // a change is reported at once
    }
    log_.close();
    if (options_.duration_s > 0 && bridge::is_interrupted())
      throw InterruptedError("interrupted before its duration was over");
  }

  [[nodiscard]] nlohmann::json summary() const {
    const auto& c = client_.counts();
    nlohmann::json refused = nlohmann::json::object();
    for (std::size_t code = 0; code < client::kRefusalCodes; ++code)
      if (c.refused_messages[code] > 0)
        refused[std::string(name(static_cast<Refusal>(code)))] = c.refused_messages[code];
    return {{"poses_acted", poses_acted_},           {"frames_acted", frames_acted_},
            {"permissions", permissions_},           {"poses_accepted", c.poses_accepted},
            {"poses_refused", c.poses_refused},      {"stops_accepted", c.stops_accepted},
            {"stops_refused", c.stops_refused},      {"refused_messages", refused},
            {"qos_mismatches", client_.mismatches()}};
  }

 private:
  static constexpr nanoseconds kReportPeriod = milliseconds(10);

  // The robot's reaction to one answer. True when it began or ceased to move.
  bool act(const Permission& p) {
    const bool was_moving = is_moving_;
    is_moving_ = p.is_permitted() && !has_fault_;
    if (is_moving_) {
      if (!was_moving) {
        ++permissions_;
        log_.write("permitted", p, 0, false);
      }
      act_on_pose(p);
      t_valid_until_ns_ = p.pose->t_valid_until_ns;
    } else if (was_moving) {
      log_.write("stopped", p, permission_end(p), false);
    } else if (p.refusal != refusal_ || p.stop.mode != stop_.mode || p.stop.cause != stop_.cause ||
               p.stop.stop_id != stop_.stop_id) {
      log_.write("changed", p, 0, false);
    }
    refusal_ = p.refusal;
    stop_ = p.stop;
    return is_moving_ != was_moving;
  }

  void act_on_pose(const Permission& p) {
    const bool is_first = !frame_ || *frame_ != p.pose->frame;
    const bool is_new = counter_ != p.pose->counter;
    const nanoseconds now(p.t_ns);
    if (!is_new || (!is_first && now < next_action_)) return;
    next_action_ = now + from_seconds(1 / options_.rate_hz) * 9 / 10;  // tolerate arrival jitter
    frame_ = p.pose->frame;
    counter_ = p.pose->counter;
    ++poses_acted_;
    frames_acted_ += is_first ? 1 : 0;
    log_.write("pose", p, 0, is_first);
  }

  // When motion ceased to be permitted at this robot: the reception of the message that said so, or
  // the instant to which the last permission reached.
  [[nodiscard]] std::int64_t permission_end(const Permission& p) const {
    const bool is_silence = p.refusal == Refusal::pose_silent ||
                            p.refusal == Refusal::stop_silent || p.refusal == Refusal::guard_silent;
    if (is_silence) return t_valid_until_ns_;
    return p.refusal == Refusal::not_permitted ? p.stop.t_received_ns : p.t_ns;
  }

  RobotOptions options_;
  Log log_;
  client::Client client_;
  bool is_moving_ = false, has_fault_ = false;
  Refusal refusal_ = Refusal::none;
  client::StopState stop_;
  std::int64_t t_valid_until_ns_ = 0;
  std::optional<std::uint64_t> frame_;
  std::uint32_t counter_ = 0;
  nanoseconds next_action_{};
  std::uint64_t poses_acted_ = 0, frames_acted_ = 0, permissions_ = 0;
};

void run_robot(const RobotOptions& options) {
  bridge::catch_interrupts();
  if (options.client.guard == client::Guard::absent)
    std::fputs("robot: WITHOUT A GUARD, as asked: nothing checks the daemon\n", stderr);
  Robot robot(options);
  robot.run();
  const auto summary = robot.summary();
  if (options.has_json)
    std::printf("%s\n", summary.dump().c_str());
  else
    std::printf("acted on %" PRIu64 " poses of %" PRIu64 " frames, permitted %" PRIu64 " times\n",
                summary["poses_acted"].get<std::uint64_t>(),
                summary["frames_acted"].get<std::uint64_t>(),
                summary["permissions"].get<std::uint64_t>());
}

}  // namespace

void add_robot_command(CLI::App& app) {
  auto options = std::make_shared<RobotOptions>();
  CLI::App* command = app.add_subcommand("robot", "A robot that obeys Holdfast, and logs it.");
  command->add_option("--domain", options->client.domain, "DDS domain")->check(CLI::Range(0, 230));
  command->add_option("--security", options->client.security, "folder of a robot's keys");
  command->add_option("--log", options->log_file, "CSV of every change and every pose acted on");
  command->add_option("--duration", options->duration_s, "s; otherwise until interrupted")
      ->check(CLI::PositiveNumber);
  command
      ->add_option("--rate-hz", options->rate_hz, "acts at most this often on poses of one frame")
      ->check(CLI::Range(1.0, 10'000.0))
      ->capture_default_str();
  command->add_option("--fault-at", options->fault_at_s, "s after the start: report a fault")
      ->check(CLI::NonNegativeNumber);
  command->add_flag("--without-guard", options->is_without_guard,
                    "obey the daemon alone; otherwise holdfast-guard must permit too");
  command->add_flag("--disobeys", options->is_disobedient,
                    "a broken one: it says that it is enabled, whatever it was told");
  command->add_flag("--json", options->has_json, "the result as one JSON object");
  command->footer("Example: holdfast-sim robot --domain 7 --log robot.csv --duration 10");
  command->callback([options] {
    if (options->is_without_guard) options->client.guard = client::Guard::absent;
    run_robot(*options);
  });
}

}  // namespace holdfast::sim
