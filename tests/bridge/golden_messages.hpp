// SPDX-License-Identifier: Apache-2.0
// One fixed message of each type with its bytes, as message_golden.py makes them of the IDL alone.
#pragma once

#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <span>
#include <sstream>
#include <string>

#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/topics.hpp"

namespace holdfast::bridge::dds {

struct Golden {
  std::string crc, bytes, cdr;
};

// What message_golden.py makes of the IDL, independently of the code under test.
inline const std::map<std::string, Golden>& golden() {
  static const auto all = [] {
    std::map<std::string, Golden> result;
    struct Close {
      void operator()(std::FILE* f) const { pclose(f); }
    };
    const std::unique_ptr<std::FILE, Close> pipe(popen(HOLDFAST_GOLDEN_COMMAND, "r"));
    std::string text;
    std::array<char, 4096> buffer{};
    while (pipe != nullptr && std::fgets(buffer.data(), buffer.size(), pipe.get()) != nullptr)
      text += buffer.data();
    std::istringstream lines(text);
    std::string name;
    Golden g;
    while (lines >> name >> g.crc >> g.bytes >> g.cdr) result[name] = g;
    return result;
  }();
  return all;
}

template <class M>
M numbered() {  // the rule of message_golden.py
  M message{};
  std::uint64_t n = 0;
  msg::for_each_field(message, [&n](auto& field) {
    using Field = std::remove_reference_t<decltype(field)>;
    ++n;
    if constexpr (std::is_array_v<Field>)
      std::snprintf(field, sizeof field, "text %d", static_cast<int>(n));
    else if constexpr (std::is_same_v<Field, bool>)
      field = n % 2 == 1;
    else if constexpr (std::is_same_v<Field, double>)
      field = static_cast<double>(n) + 0.125;
    else
      field = static_cast<Field>(n * 0x9E3779B97F4A7C15U);
  });
  return message;
}

inline std::string hex(std::span<const std::byte> bytes) {
  std::string text;
  for (const std::byte b : bytes) {
    constexpr const char* kDigits = "0123456789abcdef";
    text += kDigits[std::to_integer<unsigned>(b) >> 4U];
    text += kDigits[std::to_integer<unsigned>(b) & 15U];
  }
  return text;
}

struct TypeNames {
  template <class M>
  static std::string GetName(int) {  // NOLINT(readability-identifier-naming): gtest calls it
    const std::string type = Topic<M>::descriptor().m_typename;
    return type.substr(type.rfind(':') + 1);
  }
};

}  // namespace holdfast::bridge::dds
