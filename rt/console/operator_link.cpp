// SPDX-License-Identifier: Apache-2.0
#include "rt/console/operator_link.hpp"

#include "rt/core/error.hpp"

namespace holdfast::console {
namespace {

using bridge::dds::Clocks;
using bridge::dds::read_clocks;
using safety::Verdict;
using std::chrono::milliseconds;

constexpr milliseconds kSilenceMax{100};
constexpr milliseconds kSourceGap{150};  // beyond safety::ReceiverParameters::source_timeout
constexpr milliseconds kDelivery{1000};

/// Display only: a lost message is no reason not to look at the next.
safety::ReceiverParameters receiver_parameters() {
  safety::ReceiverParameters parameters;
  parameters.max_counter_step = 0x7fff'ffff;
  return parameters;
}

}  // namespace

OperatorLink::OperatorLink(std::uint32_t domain, const std::string& security)
    : participant_({.domain = domain, .configuration = {}, .security = security}),
      commands_(participant_, bridge::dds::random_source()),
      stops_(participant_, receiver_parameters()),
      t_start_(read_clocks().monotonic) {}

void OperatorLink::look() {
  stops_.take([this](const msg::MotionStop& message, Verdict verdict, Clocks now) {
    if (verdict != Verdict::accepted) return;
    newest_ = message;
    t_heard_ = now.monotonic;
    has_heard_ = true;
  });
}

const msg::MotionStop* OperatorLink::shown() const noexcept {
  const bool is_fresh = has_heard_ && read_clocks().monotonic - t_heard_ <= kSilenceMax;
  return is_fresh ? &newest_ : nullptr;
}

bool OperatorLink::is_ready() const noexcept {
  return commands_.status().matched > 0 && read_clocks().monotonic - t_start_ > kSourceGap;
}

void OperatorLink::send(const Order& order) {
  if (commands_.status().matched == 0)
    throw UnavailableError("no daemon listens: the command was not sent");
  msg::OperatorCommand message{};
  message.command = static_cast<std::uint8_t>(order.command);
  message.stop_id = order.stop_id;
  if (!commands_.publish(message) || !commands_.writer().wait_for_acknowledgements(kDelivery))
    throw UnavailableError("the daemon did not take the command");
}

}  // namespace holdfast::console
