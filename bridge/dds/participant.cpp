// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/participant.hpp"

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <utility>

#include <dds/dds.h>

#include "bridge/dds/security.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge::dds {
namespace {

// Above it the port numbers of the DDSI mapping (7400 + 250 * domain) exceed 65535.
constexpr std::uint32_t kMaxDomain = 232;

std::uint32_t checked_domain(std::uint32_t domain) {
  if (domain > kMaxDomain)
    throw InputError("dds: domain " + std::to_string(domain) + " is out of range, 0.." +
                     std::to_string(kMaxDomain));
  return domain;
}

/// A comma-separated list, as Cyclone takes it: what comes later adds to what came before. Empty:
/// Cyclone reads its environment by itself.
std::string configuration_of(const ParticipantParameters& parameters) {
  if (parameters.security.empty()) return parameters.configuration;
  const char* environment = std::getenv("CYCLONEDDS_URI");
  std::string list = !parameters.configuration.empty() ? parameters.configuration
                     : environment != nullptr          ? environment
                                                       : "";
  if (!list.empty()) list += ',';
  return list + security_configuration(parameters.security);
}

}  // namespace

void require(std::int32_t code, const std::string& what) {
  if (code < 0) throw UnavailableError("dds: cannot " + what + ": " + dds_strretcode(code));
}

Entity::Entity(std::int32_t handle, const std::string& what) : handle_(handle) {
  require(handle, what);
}

Entity::~Entity() {
  if (handle_ > 0) dds_delete(handle_);
}

Entity::Entity(Entity&& other) noexcept : handle_(std::exchange(other.handle_, 0)) {}

Entity& Entity::operator=(Entity&& other) noexcept {
  std::swap(handle_, other.handle_);
  return *this;
}

struct MismatchLog::Impl {
  mutable std::mutex mutex;
  std::vector<std::string> lines;
};

MismatchLog::MismatchLog() : impl_(std::make_unique<Impl>()) {}
MismatchLog::~MismatchLog() = default;

void MismatchLog::add(const std::string& line) {
  const std::scoped_lock lock(impl_->mutex);
  auto& lines = impl_->lines;
  if (std::find(lines.begin(), lines.end(), line) == lines.end()) lines.push_back(line);
}

std::vector<std::string> MismatchLog::lines() const {
  const std::scoped_lock lock(impl_->mutex);
  return impl_->lines;
}

Participant::Participant(const ParticipantParameters& parameters)
    : domain_(checked_domain(parameters.domain)) {
  const std::string where = " domain " + std::to_string(domain_);
  if (const std::string configuration = configuration_of(parameters); !configuration.empty())
    domain_entity_ = Entity(dds_create_domain(domain_, configuration.c_str()), "configure" + where);
  participant_ = Entity(dds_create_participant(domain_, nullptr, nullptr), "join" + where);
}

}  // namespace holdfast::bridge::dds
