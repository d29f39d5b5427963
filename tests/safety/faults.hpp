// SPDX-License-Identifier: Apache-2.0
// Everything that can be wrong with one cycle's inputs: the change that makes good inputs wrong,
// and the cause the gate must then name. And every limit, for the suite that all limits share.
#pragma once

#include <functional>
#include <ostream>
#include <string>
#include <vector>

#include "tests/safety/good_inputs.hpp"

namespace holdfast::safety::test {

struct Fault {
  std::string name;
  Reason reason;  ///< the primary one
  std::string requirement;
  std::function<void(Inputs&, const Limits&)> inject;
};
inline std::ostream& operator<<(std::ostream& out, const Fault& fault) {
  return out << fault.name;
}

/// Events and bad numbers; the limits are in limit_cases().
const std::vector<Fault>& faults();

struct LimitCase {
  std::string name;
  Reason reason;
  std::string requirement;
  std::function<void(Inputs&, const Limits&)> at;      ///< the value is the limit
  std::function<void(Inputs&, const Limits&)> beyond;  ///< the smallest value beyond it
};
inline std::ostream& operator<<(std::ostream& out, const LimitCase& limit) {
  return out << limit.name;
}
const std::vector<LimitCase>& limit_cases();

/// Limits that are real numbers: with NaN for the value, and with NaN for the limit.
struct RealLimitCase {
  std::string name;
  Reason reason;
  double Limits::*limit;
  std::function<void(Inputs&, double)> set;  ///< the value that is compared
};
inline std::ostream& operator<<(std::ostream& out, const RealLimitCase& limit) {
  return out << limit.name;
}
const std::vector<RealLimitCase>& real_limit_cases();

/// faults() and each limit exceeded.
const std::vector<Fault>& all_faults();

}  // namespace holdfast::safety::test
