// SPDX-License-Identifier: Apache-2.0
// A process's presence on a DDS domain, and what its endpoints found incompatible there. DDS stays
// silent about QoS that does not match; here it is recorded by name.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace holdfast::bridge::dds {

/// Owns one DDS entity (dds_entity_t) and with it everything created below it. Move-only.
class Entity {
 public:
  Entity() noexcept = default;
  /// Takes ownership of `handle`, or throws UnavailableError "dds: cannot `what`: reason" when it
  /// is an error code.
  Entity(std::int32_t handle, const std::string& what);
  ~Entity();
  Entity(Entity&& other) noexcept;
  Entity& operator=(Entity&& other) noexcept;
  Entity(const Entity&) = delete;
  Entity& operator=(const Entity&) = delete;
  [[nodiscard]] std::int32_t handle() const noexcept { return handle_; }

 private:
  std::int32_t handle_ = 0;
};

/// Throws UnavailableError "dds: cannot `what`: reason" when `code` is an error.
void require(std::int32_t code, const std::string& what);

/// Endpoints that found each other but cannot talk, one line each. Any thread.
class MismatchLog {
 public:
  MismatchLog();
  ~MismatchLog();
  void add(const std::string& line);  ///< a line already there is not repeated
  [[nodiscard]] std::vector<std::string> lines() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct ParticipantParameters {
  std::uint32_t domain = 0;   ///< 0..232
  std::string configuration;  ///< Cyclone XML or file URI; empty: the CYCLONEDDS_URI environment
  std::string security{};     ///< folder of `holdfast keys` (security.hpp); empty: unsecured
};

class Participant {
 public:
  /// Throws InputError on a domain id out of range and on a security folder that is not whole,
  /// UnavailableError with Cyclone's reason when the network or the configuration does not allow
  /// it. `configuration` and `security` can be given once per domain and process.
  explicit Participant(const ParticipantParameters& parameters);

  [[nodiscard]] std::int32_t handle() const noexcept { return participant_.handle(); }
  [[nodiscard]] std::uint32_t domain() const noexcept { return domain_; }
  [[nodiscard]] const std::shared_ptr<MismatchLog>& mismatches() const noexcept { return log_; }
  /// For example "holdfast/motion_stop: a reader elsewhere requests another DURABILITY".
  [[nodiscard]] std::vector<std::string> qos_mismatches() const { return log_->lines(); }

 private:
  std::uint32_t domain_;
  std::shared_ptr<MismatchLog> log_ = std::make_shared<MismatchLog>();
  Entity domain_entity_;
  Entity participant_;
};

}  // namespace holdfast::bridge::dds
