// SPDX-License-Identifier: Apache-2.0
// Keys, certificates and signed documents of DDS Security, by OpenSSL: EC P-256, SHA-256, X.509 v3,
// S/MIME (OMG DDS Security 1.1, 9.3 and 9.4). Start-up and tools only.
//
// Two authorities, so that who may say who somebody is, and who may say what they may do, can be
// kept apart. Their private keys are needed only to make participants: keep them off the network.
// There is no revocation list in Cyclone 0.10.2: to shut a participant out before its certificate
// ends, make new authorities and all participants anew.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>

#include "bridge/dds/security.hpp"

namespace holdfast::bridge {

/// Makes `folder` (identity_ca.pem, identity_ca.key, permissions_ca.pem, permissions_ca.key), whole
/// or not at all; readable by the owner only. Throws InputError when it exists or cannot be made.
void make_authorities(const std::filesystem::path& folder, std::chrono::days validity);

/// Makes `folder` with the files of dds/security.hpp for a participant called `name` (1..40 of
/// letters, digits, _ and -) in the role `rights`, signed by `authorities`; whole or not at all.
/// Throws InputError when it exists, when the authorities' files cannot be read, or end before
/// `validity` does.
void make_participant(const std::filesystem::path& authorities, const std::filesystem::path& folder,
                      const dds::RoleRights& rights, const std::string& name,
                      std::chrono::days validity);

struct Identity {
  std::string subject;  ///< RFC 2253
  std::chrono::sys_seconds not_before, not_after;
};

/// Who a participant's folder says it is. Throws InputError, naming the file, when one is missing
/// or unreadable, when others than the owner may read the private key, when the key is not the
/// certificate's, or when the certificate is not signed by the identity authority beside it.
[[nodiscard]] Identity read_identity(const std::filesystem::path& folder);

/// As read_identity(); throws InputError also when the certificate is not valid at `now`.
[[nodiscard]] Identity require_valid_identity(const std::filesystem::path& folder,
                                              std::chrono::system_clock::time_point now);

}  // namespace holdfast::bridge
