// SPDX-License-Identifier: Apache-2.0
// The named codes of a recording, and how a set of reasons lies in it.
#pragma once

#include <algorithm>

#include "rt/recording.hpp"

namespace holdfast::bridge::ros2 {

namespace detail {
inline std::string upper(std::string_view prefix, std::string_view name) {
  std::string text = std::string(prefix) + std::string(name);
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return text;
}
/// The codes that have a name.
template <typename E>
std::vector<std::pair<std::string, unsigned>> names(std::string_view prefix) {
  constexpr unsigned kCodes = 64;  // as many as a ReasonSet holds; every enumeration is smaller
  std::vector<std::pair<std::string, unsigned>> list;
  for (unsigned code = 0; code < kCodes; ++code) {
    const std::string_view text = name(static_cast<E>(code));
    if (text != "unknown") list.emplace_back(upper(prefix, text), code);
  }
  return list;
}
}  // namespace detail

template <>
struct EnumNames<safety::Mode> {
  static auto list() { return detail::names<safety::Mode>("MODE_"); }
};
template <>
struct EnumNames<safety::Reason> {
  static auto list() { return detail::names<safety::Reason>("REASON_"); }
};
template <>
struct EnumNames<perception::TrackingStatus> {
  static auto list() { return detail::names<perception::TrackingStatus>("STATUS_"); }
};
template <>
struct EnumNames<perception::TrackingReason> {
  static auto list() { return detail::names<perception::TrackingReason>("TRACKING_"); }
};
template <>
struct EnumNames<safety::Command> {
  static std::vector<std::pair<std::string, unsigned>> list() {
    return {{"COMMAND_NONE", 0}, {"COMMAND_ARM", 1},         {"COMMAND_DISARM", 2},
            {"COMMAND_STOP", 3}, {"COMMAND_ACKNOWLEDGE", 4}, {"COMMAND_CONFIRM", 5}};
  }
};

template <>
struct Wire<safety::ReasonSet> {
  using Type = std::uint64_t;
  static Type to(safety::ReasonSet value) { return value.bits(); }
  static safety::ReasonSet from(Type value) { return safety::ReasonSet{value}; }
};

}  // namespace holdfast::bridge::ros2
