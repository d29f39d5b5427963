// SPDX-License-Identifier: Apache-2.0
#include "bridge/security_config.hpp"

#include <fmt/format.h>

#include "bridge/key_store.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {

void SecurityConfig::use(const std::filesystem::path& keys) {
  valid_until = require_valid_identity(keys, std::chrono::system_clock::now()).not_after;
  folder = keys;
}

SecurityConfig read_security(const ConfigSection& dds) {
  SecurityConfig security;
  const bool is_unsecured_allowed = dds.boolean("allow_unsecured", false);
  if (dds.has("security") == is_unsecured_allowed)
    throw InputError(
        fmt::format("{}: give either the folder of this program's keys (`holdfast keys` makes it) "
                    "or allow_unsecured = true",
                    dds.where("security")));
  if (!is_unsecured_allowed) security.use(dds.path("security"));
  return security;
}

}  // namespace holdfast::bridge
