// SPDX-License-Identifier: Apache-2.0
#include "bridge/client/client.hpp"

#include <algorithm>

#include <dds/dds.h>

#include "bridge/client/permission.hpp"
#include "bridge/dds/endpoint.hpp"
#include "rt/core/error.hpp"

namespace holdfast::client {
namespace {

using namespace bridge::dds;  // NOLINT(google-build-using-namespace): this file is its façade
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

void require_range(const char* parameter, nanoseconds value, nanoseconds low, nanoseconds high) {
  if (value >= low && value <= high) return;
  const auto ms = [](nanoseconds t) {
    return std::to_string(std::chrono::duration<double, std::milli>(t).count());
  };
  throw InputError(std::string("client: ") + parameter + " is " + ms(value) + ", range " + ms(low) +
                   ".." + ms(high) + " ms");
}

const Parameters& checked(const Parameters& p) {
  require_range("validity_max", p.validity_max, milliseconds(1), milliseconds(20));
  require_range("future_tolerance", p.future_tolerance, nanoseconds(0), milliseconds(5));
  require_range("extrapolation_max", p.extrapolation_max, milliseconds(1), milliseconds(200));
  require_range("pose_lead_max", p.pose_lead_max, nanoseconds(0), milliseconds(50));
  require_range("second_source_hold", p.second_source_hold, milliseconds(100),
                std::chrono::hours(1));
  if (p.recovery_messages < 1 || p.recovery_messages > 100)
    throw InputError("client: recovery_messages is " + std::to_string(p.recovery_messages) +
                     ", range 1..100");
  return p;
}

}  // namespace

struct Client::Impl {
  explicit Impl(const Parameters& parameters)
      : core(checked(parameters)),
        participant({.domain = parameters.domain,
                     .configuration = parameters.configuration,
                     .security = parameters.security}),
        poses(participant),
        stops(participant),
        guards(participant),
        status(participant, random_source()),
        waitset(dds_create_waitset(participant.handle()), "create a waitset") {
    for (const std::int32_t reader : {poses.handle(), stops.handle(), guards.handle()}) {
      require(dds_set_status_mask(reader, DDS_DATA_AVAILABLE_STATUS), "watch for messages");
      require(dds_waitset_attach(waitset.handle(), reader, 0), "watch for messages");
    }
  }

  template <class M>
  void drain(Reader<M>& reader) noexcept {
    reader.drain([this](const M& message, Clocks now) { core.take(message, now); });
  }

  PermissionCore core;
  Participant participant;
  Reader<msg::CompensatedPose> poses;
  Reader<msg::MotionStop> stops;
  Reader<msg::GuardPermission> guards;
  ProtectedWriter<msg::RobotStatus> status;
  Entity waitset;
  std::int64_t t_valid_until_ns = 0;  ///< of the permission given last
  std::uint32_t last_pose_counter = 0;
};

Client::Client(const Parameters& parameters) : impl_(std::make_unique<Impl>(parameters)) {}
Client::~Client() = default;

Permission Client::poll() noexcept {
  impl_->drain(impl_->poses);
  impl_->drain(impl_->guards);
  impl_->drain(impl_->stops);  // last, so that no stop that has arrived is left out
  const Permission permission = impl_->core.decide(read_clocks().monotonic);
  impl_->t_valid_until_ns = permission.pose ? permission.pose->t_valid_until_ns : 0;
  if (permission.pose) impl_->last_pose_counter = permission.pose->counter;
  return permission;
}

void Client::wait(nanoseconds timeout) noexcept {
  nanoseconds until_expiry = timeout;
  if (impl_->t_valid_until_ns > 0)  // one more, so that it has expired when we wake
    until_expiry = nanoseconds(impl_->t_valid_until_ns + 1) - read_clocks().monotonic;
  const auto patience = std::clamp(until_expiry, nanoseconds(0), std::max(timeout, nanoseconds(0)));
  // Whatever woke us, or an error: the caller polls, and poll() needs no reason.
  (void)dds_waitset_wait(impl_->waitset.handle(), nullptr, 0, patience.count());
}

bool Client::report(const Report& report) noexcept {
  const Counts& counts = impl_->core.counts();
  msg::RobotStatus m{};
  m.is_enabled = report.is_enabled;
  m.has_fault = report.has_fault;
  m.fault_code = report.fault_code;
  m.poses_accepted = counts.poses_accepted;
  m.poses_refused = counts.poses_refused;
  m.refusal = static_cast<std::uint8_t>(impl_->core.newest_refusal());
  m.last_pose_counter = impl_->last_pose_counter;
  return impl_->status.publish(m);
}

const Counts& Client::counts() const noexcept {
  return impl_->core.counts();
}

std::vector<std::string> Client::mismatches() const {
  return impl_->participant.qos_mismatches();
}

}  // namespace holdfast::client
