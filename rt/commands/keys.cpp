// SPDX-License-Identifier: Apache-2.0
// `holdfast keys`: who may take part on DDS, and as what.
#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/key_store.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using bridge::dds::RoleRights;

constexpr const char* kExample =
    "Examples:\n"
    "  holdfast keys --out keys                             authorities, and one folder a role\n"
    "  holdfast keys --out keys --for observer:wall_display  one more participant\n"
    "  holdfast keys --check keys/robot                     whose keys these are, and until when\n"
    "Give each machine its own folder and no other. Keep keys/authority off the network: who has "
    "it\n"
    "can be anybody. Folders are never overwritten.";

struct Options {
  std::string out, check;
  std::vector<std::string> participants;  ///< ROLE or ROLE:NAME
  int days = 365, authority_days = 3650;
  bool is_json = false;
};

struct Participant {
  const RoleRights* rights;
  std::string name;
};

Participant parse(const std::string& text) {
  const auto colon = text.find(':');
  const std::string role = text.substr(0, colon);
  const RoleRights* rights = bridge::dds::find_role(role);
  if (rights == nullptr) {
    std::string roles;
    for (const RoleRights& known : bridge::dds::role_rights())
      roles += (roles.empty() ? "" : ", ") + std::string{known.role};
    throw InputError(fmt::format("--for {}: no role '{}'; there are {}", text, role, roles));
  }
  return {rights, colon == std::string::npos ? role : text.substr(colon + 1)};
}

std::vector<Participant> wanted(const Options& options) {
  std::vector<Participant> participants;
  for (const std::string& text : options.participants) participants.push_back(parse(text));
  if (!participants.empty()) return participants;
  for (const RoleRights& rights : bridge::dds::role_rights())
    participants.push_back({&rights, std::string{rights.role}});
  return participants;
}

void make(const Options& options) {
  const fs::path out = options.out, authority = out / "authority";
  const auto participants = wanted(options);
  for (const Participant& p : participants)  // before anything is made
    if (fs::exists(out / p.name))
      throw InputError(fmt::format("{}: exists; keys are not replaced", (out / p.name).string()));
  nlohmann::json made = nlohmann::json::array();
  if (!fs::exists(authority)) {
    bridge::make_authorities(authority, std::chrono::days{options.authority_days});
    made.push_back({{"folder", authority.string()}});
  }
  for (const Participant& p : participants) {
    const fs::path folder = out / p.name;
    bridge::make_participant(authority, folder, *p.rights, p.name, std::chrono::days{options.days});
    made.push_back({{"folder", folder.string()}, {"role", p.rights->role}});
  }
  if (options.is_json) {
    fmt::print("{}\n", nlohmann::json{{"made", made}}.dump());
    return;
  }
  for (const auto& entry : made)
    fmt::print("{}{}\n", entry["folder"].get<std::string>(),
               entry.contains("role") ? "  " + entry["role"].get<std::string>() : "");
}

void check(const Options& options) {
  const bridge::Identity identity = bridge::read_identity(options.check);
  const auto now = std::chrono::system_clock::now();
  const bool is_valid = identity.not_before <= now && now <= identity.not_after;
  if (options.is_json)
    fmt::print("{}\n", nlohmann::json{{"subject", identity.subject},
                                      {"not_after", fmt::format("{:%FT%TZ}", identity.not_after)},
                                      {"is_valid", is_valid}}
                           .dump());
  else if (is_valid)
    fmt::print("{}: {}, until {:%F %R} UTC\n", options.check, identity.subject, identity.not_after);
  if (!is_valid)
    throw RefusedError(fmt::format("{}: {} is valid from {:%F %R} to {:%F %R} UTC, not now",
                                   options.check, identity.subject, identity.not_before,
                                   identity.not_after));
}

}  // namespace

void add_keys(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "keys", "Keys, certificates and signed permissions: who may take part on DDS, as what.");
  auto* what = command->add_option_group("what");
  what->add_option("--out", options->out, "Folder to make them in");
  what->add_option("--check", options->check, "A participant's folder to look at");
  what->require_option(1);
  command->add_option("--for", options->participants,
                      "ROLE or ROLE:NAME (repeatable); absent: one of each role");
  command->add_option("--days", options->days, "Validity of a participant's keys")
      ->check(CLI::Range(1, 3650))
      ->capture_default_str();
  command->add_option("--authority-days", options->authority_days, "Validity of the authorities")
      ->check(CLI::Range(1, 7300))
      ->capture_default_str();
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { options->check.empty() ? make(*options) : check(*options); });
}

}  // namespace holdfast::rt
