// SPDX-License-Identifier: Apache-2.0
// `holdfast console`: the operator's terminal.
#include <array>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include "bridge/command_line.hpp"
#include "rt/commands/commands.hpp"
#include "rt/console/dialogue.hpp"
#include "rt/console/operator_link.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using console::OperatorLink;
using console::Order;
using safety::Command;
using safety::Mode;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr int kLookPeriodMs = 5;
/// Between the two steps when both were given at once: the gate wants 200 ms (Limits::confirm_min),
/// and an image exposed after the first.
constexpr milliseconds kBetweenSteps{500};
constexpr milliseconds kEffect{3000};  // of a command, until the daemon's state must show it
constexpr std::size_t kLineMax = 200;

constexpr const char* kExample =
    "Examples:\n"
    "  holdfast console --domain 7                            a dialogue: help, arm, stop, quit "
    "...\n"
    "  holdfast console --once --json                         the state, as a script reads it\n"
    "  holdfast console --acknowledge 4 --confirm 4           both steps, both naming the stop\n"
    "  holdfast console --arm --yes\n"
    "Commands towards motion take two steps; in a script both must stand on the command line.\n"
    "One console at a time: commands of two at once stop the robot. Registering anew is done with\n"
    "`holdfast register` and a restart of the daemon.\n"
    "Exit codes: 0 done, 1 the daemon's state does not allow it or did not follow (the reason is "
    "the line\non stderr), 2 usage, 3 no daemon.";

struct Options {
  std::uint32_t domain = 0;
  std::string security;
  bool is_once = false, is_json = false, is_stop = false, is_disarm = false, is_arm = false,
       is_yes = false;
  std::optional<std::uint32_t> acknowledge, confirm;
  double timeout_s = 5;
};

void wait_a_look(OperatorLink& link) {
  (void)poll(nullptr, 0, kLookPeriodMs);
  link.look();
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
}

/// Looks until `holds`; false when `patience` is over first.
template <class F>
bool wait_until(OperatorLink& link, nanoseconds patience, F&& holds) {
  for (const nanoseconds end = monotonic_now() + patience; !holds();) {
    if (monotonic_now() > end) return false;
    wait_a_look(link);
  }
  return true;
}

void print_state(const OperatorLink& link, bool is_json) {
  const msg::MotionStop* shown = link.shown();
  if (shown == nullptr) throw UnavailableError("nothing is heard from the daemon any more");
  fmt::print("{}\n", is_json ? console::state_json(*shown) : console::state_line(shown));
}

/// Whether the daemon's state shows what `order` was for.
bool has_effect(const Order& order, const msg::MotionStop* shown) {
  if (shown == nullptr) return false;
  const auto mode = static_cast<Mode>(shown->mode);
  switch (order.command) {
    case Command::stop:
      return mode == Mode::stop_latched;
    case Command::arm:
      return mode == Mode::permitted;
    case Command::disarm:
      return mode != Mode::permitted && mode != Mode::hold;
    case Command::confirm:
      return mode != Mode::stop_latched;
    case Command::acknowledge:
    case Command::none:
      return true;
  }
  return false;
}

/// The orders of a script, each after the daemon's state was looked at.
void give(OperatorLink& link, const std::vector<Order>& orders) {
  for (const Order& order : orders) {
    if (order.command == Command::confirm)
      (void)wait_until(link, kBetweenSteps, [] { return false; });
    if (const std::string why = console::objection(order, link.shown()); !why.empty())
      throw RefusedError(why);
    link.send(order);
  }
  const Order& last = orders.back();
  if (!wait_until(link, kEffect, [&] { return has_effect(last, link.shown()); }))
    throw RefusedError("the daemon has the command, and its state is: " +
                       console::state_line(link.shown()));
}

std::vector<Order> orders_of(const Options& o) {
  if (o.is_stop) return {{Command::stop, 0}};
  if (o.is_disarm) return {{Command::disarm, 0}};
  if (o.is_arm) {
    if (!o.is_yes) throw InputError("--arm needs --yes: the robot may move and fire then");
    return {{Command::arm, 0}};
  }
  if (!o.acknowledge) return {};
  if (!o.confirm || *o.confirm != *o.acknowledge)
    throw InputError(fmt::format(
        "--acknowledge {0} needs --confirm {0}: two steps, both naming the stop", *o.acknowledge));
  return {{Command::acknowledge, *o.acknowledge}, {Command::confirm, *o.confirm}};
}

void run_script(const Options& options, const std::vector<Order>& orders) {
  OperatorLink link(options.domain, options.security);
  const bool is_reading = orders.empty();
  const nanoseconds patience =
      std::chrono::duration_cast<nanoseconds>(std::chrono::duration<double>(options.timeout_s));
  if (!wait_until(link, patience,
                  [&] { return link.shown() != nullptr && (is_reading || link.is_ready()); }))
    throw UnavailableError(
        fmt::format("no daemon on domain {} within {} s", options.domain, options.timeout_s));
  if (!is_reading) give(link, orders);
  print_state(link, options.is_json);
}

/// What was typed since the last call, as whole lines; empty optional at the end of input.
class Keyboard {
 public:
  [[nodiscard]] std::optional<std::vector<std::string>> lines() {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    if (poll(&input, 1, kLookPeriodMs) <= 0) return std::vector<std::string>();
    std::array<char, 256> buffer{};
    const ssize_t n = read(STDIN_FILENO, buffer.data(), buffer.size());
    if (n <= 0) return std::nullopt;
    std::vector<std::string> whole;
    for (ssize_t i = 0; i < n; ++i) {
      const char c = buffer[static_cast<std::size_t>(i)];
      if (c == '\n') {
        whole.push_back(std::exchange(line_, {}));
      } else if (line_.size() < kLineMax) {
        line_ += c;
      }
    }
    return whole;
  }

 private:
  std::string line_;
};

void print_line(const std::string& text) {
  fmt::print("\r{}\n> ", text);
  std::fflush(stdout);
}

/// One line of the dialogue; false when the person leaves.
bool answer(const console::Reply& reply, OperatorLink& link) {
  if (reply.order) {
    try {
      link.send(*reply.order);
    } catch (const UnavailableError& e) {
      print_line(e.what());
      return true;
    }
  }
  print_line(reply.text);
  return !reply.is_end;
}

void talk(const Options& options) {
  if (isatty(STDIN_FILENO) == 0)
    throw InputError(
        "not a terminal: in a script give --once, --stop, --disarm, --arm --yes, or --acknowledge "
        "N --confirm N");
  OperatorLink link(options.domain, options.security);
  console::Dialogue dialogue;
  Keyboard keyboard;
  std::string shown = console::state_line(nullptr);
  print_line(shown);
  while (!bridge::is_interrupted()) {
    const auto lines = keyboard.lines();
    link.look();
    if (!lines) return;
    for (const std::string& line : *lines)
      if (!answer(dialogue.take(line, link.shown(), monotonic_now()), link)) return;
    if (std::string now = console::state_line(link.shown()); now != shown) {
      shown = std::move(now);
      print_line(shown);
    }
  }
}

void run(const Options& options) {
  const std::vector<Order> orders = orders_of(options);
  bridge::catch_interrupts();
  if (orders.empty() && !options.is_once) {
    if (options.is_json) throw InputError("--json is for --once and for commands");
    talk(options);
  } else {
    run_script(options, orders);
  }
}

}  // namespace

void add_console(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "console", "The operator's terminal: state and reasons live; stop, arm, acknowledge.");
  command->add_option("--domain", options->domain, "DDS domain")->check(CLI::Range(0, 230));
  command->add_option("--security", options->security, "Folder of an operator's keys");
  auto* what = command->add_option_group("what");
  what->add_flag("--once", options->is_once, "Print the state and end");
  what->add_flag("--stop", options->is_stop, "Stop, and end");
  what->add_flag("--disarm", options->is_disarm, "Disarm, and end");
  auto* arm = what->add_flag("--arm", options->is_arm, "Arm, and end; needs --yes");
  auto* acknowledge = what->add_option("--acknowledge", options->acknowledge,
                                       "End the stop of this number; needs --confirm");
  what->require_option(0, 1);
  command->add_flag("--yes", options->is_yes, "The second step of --arm")->needs(arm);
  command->add_option("--confirm", options->confirm, "The second step: the same number again")
      ->needs(acknowledge);
  command->add_option("--timeout", options->timeout_s, "s to wait for the daemon")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
