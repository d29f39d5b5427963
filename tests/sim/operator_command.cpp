// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim operator`: the person at the console, for unattended runs. Sees what the
// motion-stop topic says, and sends protected commands.
#include <cinttypes>
#include <cstdio>
#include <ctime>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bridge/command_line.hpp"
#include "bridge/dds/endpoint.hpp"
#include "rt/core/error.hpp"
#include "safety/gate.hpp"
#include "tests/sim/commands.hpp"

namespace holdfast::sim {
namespace {

using bridge::dds::Clocks;
using safety::Command;
using safety::Mode;
using safety::Verdict;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

const std::map<std::string, Command> command_by_name{{"arm", Command::arm},
                                                     {"disarm", Command::disarm},
                                                     {"stop", Command::stop},
                                                     {"acknowledge", Command::acknowledge},
                                                     {"confirm", Command::confirm}};

const char* name_of(Command command) {
  for (const auto& [name, value] : command_by_name)
    if (value == command) return name.c_str();
  return "none";
}

std::vector<std::string> names() {
  std::vector<std::string> result;
  for (const auto& entry : command_by_name) result.push_back(entry.first);
  return result;
}

struct OperatorOptions {
  bridge::dds::ParticipantParameters dds;
  bool is_auto = false;
  std::string command;    ///< a name in command_by_name
  double duration_s = 0;  ///< --auto: 0 is until interrupted
  double timeout_s = 5;   ///< --command: how long to wait for the daemon
  double reaction_ms = 300;
};

nanoseconds from_seconds(double s) {
  return std::chrono::duration_cast<nanoseconds>(std::chrono::duration<double>(s));
}

void pause_ms(long ms) {
  const timespec pause{0, ms * 1'000'000};
  nanosleep(&pause, nullptr);
}

// What a calm operator does about what the console shows. Time is passed in.
class Habit {
 public:
  explicit Habit(nanoseconds reaction) : reaction_(reaction) {}

  [[nodiscard]] Command next(const msg::MotionStop& shown, nanoseconds now) {
    const auto mode = static_cast<Mode>(shown.mode);
    if (mode != mode_ || shown.stop_id != stop_id_) {
      mode_ = mode;
      stop_id_ = shown.stop_id;
      is_acknowledged_ = false;
      next_ = now + reaction_;
    }
    if (now < next_) return Command::none;
    if (mode == Mode::ready) {
      next_ = now + kRetry;
      return Command::arm;
    }
    if (mode != Mode::stop_latched) return Command::none;
    // Two steps, the second after the gate's confirm_min; from the start again if nothing came of
    // it.
    is_acknowledged_ = !is_acknowledged_;
    next_ = now + (is_acknowledged_ ? kConfirm : kRetry);
    return is_acknowledged_ ? Command::acknowledge : Command::confirm;
  }

 private:
  static constexpr nanoseconds kConfirm = milliseconds(300);
  static constexpr nanoseconds kRetry = milliseconds(500);
  nanoseconds reaction_;
  Mode mode_ = Mode::init;
  std::uint32_t stop_id_ = 0;
  bool is_acknowledged_ = false;
  nanoseconds next_{};
};

class Console {
 public:
  explicit Console(const bridge::dds::ParticipantParameters& dds)
      : participant_(dds),
        commands_(participant_, bridge::dds::random_source()),
        stops_(participant_, receiver_parameters()) {}

  /// The newest state, absent while there is none that is fresh.
  [[nodiscard]] std::optional<msg::MotionStop> look() {
    stops_.take([this](const msg::MotionStop& message, Verdict verdict, Clocks) {
      if (verdict == Verdict::accepted) newest_ = message;
    });
    const bool is_fresh = bridge::dds::read_clocks().monotonic <= stops_.receiver().valid_until();
    return is_fresh ? newest_ : std::nullopt;
  }
  [[nodiscard]] bool has_daemon() const { return commands_.status().matched > 0; }

  void send(Command command, const msg::MotionStop& shown) {
    msg::OperatorCommand message{};
    message.command = static_cast<std::uint8_t>(command);
    message.stop_id = shown.stop_id;
    if (!commands_.publish(message)) throw UnavailableError("the command was not sent");
    std::printf("%" PRId64 ",%s,%" PRIu32 ",%s,%s\n", message.protection.t_monotonic_ns,
                name_of(command), shown.stop_id, safety::name(static_cast<Mode>(shown.mode)).data(),
                safety::name(static_cast<safety::Reason>(shown.cause)).data());
    std::fflush(stdout);
  }
  [[nodiscard]] bool is_delivered(nanoseconds timeout) const {
    return commands_.writer().wait_for_acknowledgements(timeout);
  }

 private:
  // Display only: a lost message is no reason not to look at the next.
  static safety::ReceiverParameters receiver_parameters() {
    safety::ReceiverParameters parameters;
    parameters.max_counter_step = 1'000'000;
    parameters.max_validity = milliseconds(100);
    return parameters;
  }
  bridge::dds::Participant participant_;
  bridge::dds::ProtectedWriter<msg::OperatorCommand> commands_;
  bridge::dds::ProtectedReader<msg::MotionStop> stops_;
  std::optional<msg::MotionStop> newest_;
};

constexpr long kLookPeriodMs = 5;

void send_once(const OperatorOptions& options) {
  Console console(options.dds);
  const nanoseconds end = bridge::dds::read_clocks().monotonic + from_seconds(options.timeout_s);
  for (;;) {
    const auto shown = console.look();
    if (shown && console.has_daemon()) {
      console.send(command_by_name.at(options.command), *shown);
      if (!console.is_delivered(from_seconds(options.timeout_s)))
        throw UnavailableError("the daemon did not acknowledge the reception of the command");
      return;
    }
    if (bridge::is_interrupted()) throw InterruptedError("interrupted before the command was sent");
    if (bridge::dds::read_clocks().monotonic > end)
      throw UnavailableError("no daemon on domain " + std::to_string(options.dds.domain) +
                             " within " + std::to_string(options.timeout_s) + " s");
    pause_ms(kLookPeriodMs);
  }
}

void operate(const OperatorOptions& options) {
  Console console(options.dds);
  Habit habit(from_seconds(options.reaction_ms / 1000));
  nanoseconds now = bridge::dds::read_clocks().monotonic;
  const nanoseconds end =
      options.duration_s > 0 ? now + from_seconds(options.duration_s) : nanoseconds::max();
  std::printf("t_monotonic_ns,command,stop_id,mode,cause\n");
  std::fflush(stdout);
  for (; now < end && !bridge::is_interrupted(); now = bridge::dds::read_clocks().monotonic) {
    const auto shown = console.look();
    const Command command = shown ? habit.next(*shown, now) : Command::none;
    if (command != Command::none) console.send(command, *shown);
    pause_ms(kLookPeriodMs);
  }
  if (options.duration_s > 0 && bridge::is_interrupted())
    throw InterruptedError("interrupted before its duration was over");
}

}  // namespace

void add_operator_command(CLI::App& app) {
  auto options = std::make_shared<OperatorOptions>();
  CLI::App* command = app.add_subcommand("operator", "The person at the console.");
  command->add_option("--domain", options->dds.domain, "DDS domain")->check(CLI::Range(0, 230));
  command->add_option("--security", options->dds.security, "folder of an operator's keys");
  auto* what = command->add_option_group("what");
  what->add_flag("--auto", options->is_auto,
                 "arm when ready; acknowledge, confirm and re-arm after each stop");
  what->add_option("--command", options->command, "send one command and end")
      ->check(CLI::IsMember(names()));
  what->require_option(1);
  command
      ->add_option("--duration", options->duration_s, "s, with --auto; otherwise until interrupted")
      ->check(CLI::PositiveNumber);
  command->add_option("--timeout", options->timeout_s, "s to wait for the daemon, with --command")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--reaction-ms", options->reaction_ms, "from a change to the first action")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->footer(
      "Prints each command as CSV.\nExample: holdfast-sim operator --domain 7 --auto --duration "
      "60");
  command->callback([options] {
    bridge::catch_interrupts();
    if (options->is_auto)
      operate(*options);
    else
      send_once(*options);
  });
}

}  // namespace holdfast::sim
