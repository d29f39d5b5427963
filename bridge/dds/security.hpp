// SPDX-License-Identifier: Apache-2.0
// DDS Security: who may do what on Holdfast's topics, in one table, and the documents that make a
// DDS implementation enforce it. Keys and signatures are made elsewhere (bridge/key_store.hpp).
//
// Any thread, start-up only: all functions allocate.
#pragma once

#include <chrono>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

namespace holdfast::bridge::dds {

/// What a role may write and read; whatever is not listed is denied.
struct RoleRights {
  std::string_view role;
  std::span<const std::string_view> publishes, subscribes;  ///< topic names
};

/// daemon, robot, operator, guard, observer. A robot cannot publish poses, an observer cannot
/// publish at all, only the operator can acknowledge a stop.
[[nodiscard]] std::span<const RoleRights> role_rights() noexcept;
/// Null when there is no such role.
[[nodiscard]] const RoleRights* find_role(std::string_view role) noexcept;

/// What holds for everybody on domains 0..230: no participant without an identity, everything
/// encrypted, every topic under access control (OMG DDS Security 1.1, 9.4.1.2).
[[nodiscard]] std::string governance_xml();

/// What the holder of the certificate `subject` (RFC 2253) may do, from `not_before` to `not_after`
/// (OMG DDS Security 1.1, 9.4.1.3).
[[nodiscard]] std::string permissions_xml(const RoleRights& rights, std::string_view subject,
                                          std::chrono::sys_seconds not_before,
                                          std::chrono::sys_seconds not_after);

/// The files of one participant's folder.
inline constexpr std::string_view kIdentityAuthorityFile = "identity_ca.pem";
inline constexpr std::string_view kPermissionsAuthorityFile = "permissions_ca.pem";
inline constexpr std::string_view kCertificateFile = "certificate.pem";
inline constexpr std::string_view kPrivateKeyFile = "key.pem";
inline constexpr std::string_view kGovernanceFile = "governance.p7s";
inline constexpr std::string_view kPermissionsFile = "permissions.p7s";

/// Cyclone DDS configuration (XML) that makes a participant who it is: to be appended to the
/// network part. Throws InputError naming the file when one of `folder`'s is missing, or when the
/// folder's path cannot stand in XML or in a list of URIs (one of < > & " ,).
[[nodiscard]] std::string security_configuration(const std::filesystem::path& folder);

}  // namespace holdfast::bridge::dds
