// SPDX-License-Identifier: Apache-2.0
#include "rt/console/dialogue.hpp"

#include <charconv>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "rt/reason_text.hpp"

namespace holdfast::console {
namespace {

using safety::Command;
using safety::Mode;
using std::chrono::nanoseconds;

constexpr const char* kHelp =
    "stop | disarm | arm, then yes | acknowledge N, then confirm N (N: the stop's number) | quit";
constexpr const char* kNothingHeard =
    "nothing is heard from the daemon: only `stop` is sent without knowing its state";

Mode mode_of(const msg::MotionStop& m) {
  return static_cast<Mode>(m.mode);
}

std::optional<std::uint32_t> number_in(std::string_view text) {
  std::uint32_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return number;
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t' || text.back() == '\r'))
    text.remove_suffix(1);
  return text;
}

bool is_within(const std::optional<nanoseconds>& t, nanoseconds now) {
  return t && now >= *t && now - *t <= kSecondStepWithin;
}

/// Word and rest of a line.
struct Words {
  std::string_view first, rest;
};
Words split(std::string_view line) {
  const std::size_t at = line.find(' ');
  if (at == std::string_view::npos) return {line, {}};
  return {line.substr(0, at), trimmed(line.substr(at))};
}

}  // namespace

std::string objection(const Order& order, const msg::MotionStop* shown) {
  if (order.command == Command::stop) return {};
  if (shown == nullptr) return kNothingHeard;
  const Mode mode = mode_of(*shown);
  const auto cause = static_cast<safety::Reason>(shown->cause);
  if (order.command == Command::arm && mode != Mode::ready)
    return fmt::format("cannot be armed in mode {}: {} ({})", safety::name(mode),
                       rt::sentence(cause), safety::name(cause));
  const bool names_a_stop =
      order.command == Command::acknowledge || order.command == Command::confirm;
  if (!names_a_stop) return {};
  if (mode != Mode::stop_latched) return "no stop is latched";
  if (order.stop_id != shown->stop_id)
    return fmt::format("the stop that is latched now is {}, not {}", shown->stop_id, order.stop_id);
  return {};
}

Reply Dialogue::arm(const msg::MotionStop& shown, nanoseconds now) {
  if (const std::string why = objection({Command::arm, 0}, &shown); !why.empty())
    return {why, std::nullopt};
  t_arm_asked_ = now;
  return {
      "arm: the robot may move and fire as soon as every condition holds; type `yes` within "
      "10 s",
      std::nullopt};
}

Reply Dialogue::yes(const msg::MotionStop& shown, nanoseconds now) {
  const bool is_asked = is_within(t_arm_asked_, now);
  t_arm_asked_.reset();
  if (!is_asked) return {"`yes` to what? type `arm` first", std::nullopt};
  if (const std::string why = objection({Command::arm, 0}, &shown); !why.empty())
    return {why, std::nullopt};
  return {"arm sent", Order{Command::arm, 0}};
}

Reply Dialogue::acknowledge(std::string_view number, const msg::MotionStop& shown,
                            nanoseconds now) {
  const auto stop_id = number_in(number);
  if (!stop_id) return {"which stop? type `acknowledge N`, N as shown", std::nullopt};
  const Order order{Command::acknowledge, *stop_id};
  if (const std::string why = objection(order, &shown); !why.empty()) return {why, std::nullopt};
  t_acknowledged_ = now;
  acknowledged_id_ = *stop_id;
  return {fmt::format("stop {0} acknowledged; look at the site, then type `confirm {0}` within "
                      "10 s",
                      *stop_id),
          order};
}

Reply Dialogue::confirm(std::string_view number, const msg::MotionStop& shown, nanoseconds now) {
  const bool is_acknowledged = is_within(t_acknowledged_, now);
  t_acknowledged_.reset();
  const auto stop_id = number_in(number);
  if (!stop_id) return {"which stop? type `confirm N`, N as shown; acknowledge it again first", {}};
  if (!is_acknowledged || acknowledged_id_ != *stop_id)
    return {fmt::format("type `acknowledge {}` first, and confirm within 10 s", *stop_id), {}};
  const Order order{Command::confirm, *stop_id};
  if (const std::string why = objection(order, &shown); !why.empty()) return {why, std::nullopt};
  return {fmt::format("stop {} confirmed; it ends when the drift check passes", *stop_id), order};
}

Reply Dialogue::take(std::string_view line, const msg::MotionStop* shown, nanoseconds now) {
  const auto [word, rest] = split(trimmed(line));
  if (word == "stop" && rest.empty()) return {"stop sent", Order{Command::stop, 0}};
  if (word == "quit" || word == "exit") return {"", std::nullopt, true};
  if (word.empty()) return {};
  const bool is_known = word == "disarm" || word == "arm" || word == "yes" ||
                        word == "acknowledge" || word == "confirm";
  if (!is_known) return {kHelp, std::nullopt};
  if (shown == nullptr) return {kNothingHeard, std::nullopt};
  if (word == "acknowledge") return acknowledge(rest, *shown, now);
  if (word == "confirm") return confirm(rest, *shown, now);
  if (!rest.empty()) return {kHelp, std::nullopt};
  if (word == "arm") return arm(*shown, now);
  if (word == "yes") return yes(*shown, now);
  return {"disarm sent", Order{Command::disarm, 0}};
}

std::string state_line(const msg::MotionStop* shown) {
  if (shown == nullptr) return "STOP: NO DATA  nothing is heard from the daemon";
  const auto cause = static_cast<safety::Reason>(shown->cause);
  const Mode mode = mode_of(*shown);
  // The mode alone permits nothing: a message that contradicts itself shows none.
  if (shown->is_permitted && mode == Mode::permitted && shown->cause == 0)
    return "PERMITTED by the daemon (a robot needs the guard's permission too)";
  const std::string_view word = mode == Mode::stop_latched ? "STOP"
                                : mode == Mode::hold       ? "HOLD"
                                                           : "NOT PERMITTED";
  std::string line = fmt::format("{}  {} ({})", word, rt::sentence(cause), safety::name(cause));
  if (mode == Mode::stop_latched)
    line += fmt::format("; stop {0}: `acknowledge {0}`", shown->stop_id);
  if (mode == Mode::ready) line += "; `arm`";
  const auto others = safety::ReasonSet(shown->reasons);
  for (unsigned code = 1; code < 64; ++code) {
    const auto reason = static_cast<safety::Reason>(code);
    if (reason != cause && others.contains(reason))
      line += fmt::format("; also {}", safety::name(reason));
  }
  return line;
}

std::string state_json(const msg::MotionStop& shown) {
  nlohmann::json reasons = nlohmann::json::array();
  for (unsigned code = 1; code < 64; ++code) {
    if (safety::ReasonSet(shown.reasons).contains(static_cast<safety::Reason>(code)))
      reasons.push_back(safety::name(static_cast<safety::Reason>(code)));
  }
  const auto cause = static_cast<safety::Reason>(shown.cause);
  return nlohmann::json{
      {"mode", safety::name(mode_of(shown))}, {"cause", safety::name(cause)},
      {"text", rt::sentence(cause)},          {"is_permitted", shown.is_permitted},
      {"is_latched", shown.is_latched},       {"stop_id", shown.stop_id},
      {"reasons", std::move(reasons)}}
      .dump();
}

}  // namespace holdfast::console
