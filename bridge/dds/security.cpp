// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/security.hpp"

#include <algorithm>
#include <array>
#include <ctime>

#include "rt/core/error.hpp"

namespace holdfast::bridge::dds {
namespace {

using namespace std::string_view_literals;

constexpr auto kPose = "holdfast/compensated_pose"sv;
constexpr auto kStop = "holdfast/motion_stop"sv;
constexpr auto kHealth = "holdfast/tracking_health"sv;
constexpr auto kRegistration = "holdfast/registration_info"sv;
constexpr auto kStatus = "holdfast/robot_status"sv;
constexpr auto kCommand = "holdfast/operator_command"sv;
constexpr auto kGuard = "holdfast/guard_permission"sv;

constexpr std::array kDaemonWrites{kPose, kStop, kHealth, kRegistration};
constexpr std::array kDaemonReads{kStatus, kCommand};
constexpr std::array kRobotWrites{kStatus};
constexpr std::array kRobotReads{kPose, kStop, kGuard};
constexpr std::array kOperatorWrites{kCommand};
constexpr std::array kOperatorReads{kStop, kHealth, kRegistration, kStatus, kGuard};
constexpr std::array kGuardWrites{kGuard};
constexpr std::array kGuardReads{kPose, kStop, kHealth, kRegistration, kStatus};
constexpr std::array kAll{kPose, kStop, kHealth, kRegistration, kStatus, kCommand, kGuard};

constexpr std::array<RoleRights, 5> kRights{{
    {.role = "daemon", .publishes = kDaemonWrites, .subscribes = kDaemonReads},
    {.role = "robot", .publishes = kRobotWrites, .subscribes = kRobotReads},
    {.role = "operator", .publishes = kOperatorWrites, .subscribes = kOperatorReads},
    {.role = "guard", .publishes = kGuardWrites, .subscribes = kGuardReads},
    {.role = "observer", .publishes = {}, .subscribes = kAll},
}};

constexpr auto kDomains = "<domains><id_range><min>0</min><max>230</max></id_range></domains>\n"sv;

std::string document(std::string_view schema, std::string_view body) {
  return R"(<?xml version="1.0" encoding="utf-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
     xsi:noNamespaceSchemaLocation="https://www.omg.org/spec/DDS-SECURITY/20170901/)" +
         std::string(schema) + "\">\n" + std::string(body) + "</dds>\n";
}

std::string element(std::string_view name, std::string_view content) {
  return '<' + std::string(name) + '>' + std::string(content) + "</" + std::string(name) + ">\n";
}

std::string utc(std::chrono::sys_seconds t) {
  const std::time_t seconds = std::chrono::system_clock::to_time_t(t);
  std::tm parts{};
  gmtime_r(&seconds, &parts);
  std::array<char, sizeof "2026-01-01T00:00:00"> text{};
  (void)std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &parts);
  return text.data();
}

std::string topics(std::string_view direction, std::span<const std::string_view> names) {
  if (names.empty()) return {};
  std::string list;
  for (const std::string_view name : names) list += element("topic", name);
  return element(direction, element("topics", list));
}

std::string file_uri(const std::filesystem::path& folder, std::string_view name) {
  const std::filesystem::path file = folder / name;
  if (!std::filesystem::is_regular_file(file))
    throw InputError("security: " + file.string() + " is missing (`holdfast keys` makes it)");
  return "file:" + file.string();
}

/// Cyclone loads its plugins by path; the dynamic loader searches for a name without one.
std::string plugin(std::string_view name, std::string_view what) {
#ifndef HOLDFAST_DDS_PLUGINS
#error "the folder of Cyclone's security plugins"
#endif
  return "<Library path=\"" HOLDFAST_DDS_PLUGINS "/libdds_security_" + std::string(name) +
         ".so\" initFunction=\"init_" + std::string(what) + "\" finalizeFunction=\"finalize_" +
         std::string(what) + "\"/>";
}

}  // namespace

std::span<const RoleRights> role_rights() noexcept {
  return kRights;
}

const RoleRights* find_role(std::string_view role) noexcept {
  const auto found = std::find_if(kRights.begin(), kRights.end(),
                                  [role](const RoleRights& r) { return r.role == role; });
  return found == kRights.end() ? nullptr : &*found;
}

std::string governance_xml() {
  const std::string topic_rule =
      element("topic_expression", "*") + element("enable_discovery_protection", "true") +
      element("enable_liveliness_protection", "true") +
      element("enable_read_access_control", "true") +
      element("enable_write_access_control", "true") +
      element("metadata_protection_kind", "ENCRYPT") + element("data_protection_kind", "ENCRYPT");
  const std::string domain_rule =
      std::string(kDomains) + element("allow_unauthenticated_participants", "false") +
      element("enable_join_access_control", "true") +
      element("discovery_protection_kind", "ENCRYPT") +
      element("liveliness_protection_kind", "ENCRYPT") + element("rtps_protection_kind", "SIGN") +
      element("topic_access_rules", element("topic_rule", topic_rule));
  return document("omg_shared_ca_governance.xsd",
                  element("domain_access_rules", element("domain_rule", domain_rule)));
}

std::string permissions_xml(const RoleRights& rights, std::string_view subject,
                            std::chrono::sys_seconds not_before,
                            std::chrono::sys_seconds not_after) {
  const std::string grant =
      element("subject_name", subject) +
      element("validity",
              element("not_before", utc(not_before)) + element("not_after", utc(not_after))) +
      element("allow_rule", std::string(kDomains) + topics("publish", rights.publishes) +
                                topics("subscribe", rights.subscribes)) +
      element("default", "DENY");
  return document("omg_shared_ca_permissions.xsd",
                  element("permissions", "<grant name=\"" + std::string(rights.role) + "\">\n" +
                                             grant + "</grant>\n"));
}

std::string security_configuration(const std::filesystem::path& folder) {
  const std::filesystem::path absolute = std::filesystem::absolute(folder);
  if (const auto bad = absolute.string().find_first_of("<>&\","); bad != std::string::npos)
    throw InputError("security: " + absolute.string() + ": no '" + absolute.string()[bad] +
                     "' allowed in this folder's path");
  const auto file = [&absolute](std::string_view tag, std::string_view name) {
    return element(tag, file_uri(absolute, name));
  };
  // In the order in which Cyclone's schema has them.
  const std::string authentication =
      plugin("auth", "authentication") + file("IdentityCA", kIdentityAuthorityFile) +
      file("IdentityCertificate", kCertificateFile) + file("PrivateKey", kPrivateKeyFile);
  const std::string access =
      plugin("ac", "access_control") + file("PermissionsCA", kPermissionsAuthorityFile) +
      file("Governance", kGovernanceFile) + file("Permissions", kPermissionsFile);
  return "<CycloneDDS><Domain Id=\"any\">" +
         element("Security", element("Authentication", authentication) +
                                 element("Cryptographic", plugin("crypto", "crypto")) +
                                 element("AccessControl", access)) +
         "</Domain></CycloneDDS>";
}

}  // namespace holdfast::bridge::dds
