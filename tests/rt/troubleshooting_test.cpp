// SPDX-License-Identifier: Apache-2.0
// docs/troubleshooting.md lists every code that a person can meet, with its name, and no other.
#include <fstream>
#include <map>
#include <regex>
#include <string>

#include <gtest/gtest.h>

#include "bridge/client/client.hpp"
#include "perception/motion_estimate.hpp"
#include "rt/guard/guard_core.hpp"
#include "safety/reason.hpp"

namespace holdfast {
namespace {

struct Row {
  std::string name, kind;  ///< kind: the cell after the name
};
using Table = std::map<int, Row>;

/// The rows of one section, by code.
Table table_of(const std::string& section) {
  std::ifstream file(HOLDFAST_TROUBLESHOOTING_MD);
  EXPECT_TRUE(file) << HOLDFAST_TROUBLESHOOTING_MD;
  static const std::regex kRow(R"(^\| (\d+) \| `(\w+)` \| ([^|]*) \|.*)");
  Table table;
  std::string line;
  bool is_here = false;
  while (std::getline(file, line)) {
    if (line.starts_with("## ")) is_here = line == "## " + section;
    std::smatch cells;
    if (!is_here || !std::regex_match(line, cells, kRow)) continue;
    const bool is_new = table.emplace(std::stoi(cells[1]), Row{cells[2], cells[3]}).second;
    EXPECT_TRUE(is_new) << line;
  }
  return table;
}

/// `named(code)`: the program's name of it, or "unknown".
template <typename Named>
void expect_complete(const Table& table, int codes, const Named& named) {
  for (int code = 1; code < codes; ++code) {
    const std::string name(named(code));
    const auto row = table.find(code);
    if (name == "unknown") {
      EXPECT_EQ(row, table.end()) << code << " is documented, but is no code";
    } else {
      ASSERT_NE(row, table.end()) << code << " " << name << " is not documented";
      EXPECT_EQ(row->second.name, name) << code;
    }
  }
  EXPECT_TRUE(table.empty() || table.rbegin()->first < codes);
}

std::string kind_of(safety::Severity severity) {
  switch (severity) {
    case safety::Severity::stop:
      return "stop";
    case safety::Severity::hold:
      return "hold";
    case safety::Severity::readiness:
      return "readiness";
    case safety::Severity::advisory:
      return "advisory";
    case safety::Severity::none:
      break;
  }
  return "";
}

TEST(Troubleshooting, NamesEveryReasonOfTheGateAndItsKind) {
  const Table table = table_of("The gate");
  expect_complete(table, 64, [](int code) { return name(static_cast<safety::Reason>(code)); });
  for (const auto& [code, row] : table)
    EXPECT_EQ(row.kind, kind_of(severity(static_cast<safety::Reason>(code)))) << row.name;
}

TEST(Troubleshooting, NamesEveryReasonOfTheTracker) {
  expect_complete(table_of("The tracker"), 64,
                  [](int code) { return name(static_cast<perception::TrackingReason>(code)); });
}

TEST(Troubleshooting, NamesEveryCauseOfTheGuard) {
  expect_complete(table_of("The guard"), 64,
                  [](int code) { return name(static_cast<guard::GuardCause>(code)); });
}

TEST(Troubleshooting, NamesEveryRefusalOfTheClient) {
  expect_complete(table_of("The robot's client"), static_cast<int>(client::kRefusalCodes),
                  [](int code) { return name(static_cast<client::Refusal>(code)); });
}

}  // namespace
}  // namespace holdfast
