// SPDX-License-Identifier: Apache-2.0
// DDS Security as the deployed profile has it: who gets in, over the real middleware, each intruder
// its own process.
#include "bridge/dds/security.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <gtest/gtest.h>

#include "bridge/client/client.hpp"
#include "bridge/key_store.hpp"
#include "rt/core/error.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/dds_peer.hpp"
#include "tests/bridge/key_folder.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;
using dds::eventually;
using dds::Peer;
using dds::test_domain;

std::string text_of(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

std::string refusal_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& e) {
    return e.what();
  }
  return "accepted";
}

class Security : public KeyFolderTest {
 protected:
  /// A robot with keys of its own on the test's domain.
  client::Client robot(const std::string& name = "robot") {
    client::Parameters parameters;
    parameters.domain = test_domain();
    parameters.security = keys_of("robot", name);
    parameters.guard = client::Guard::absent;  // it would be a third process with keys of its own
    return client::Client(parameters);
  }
  static bool is_permitted_soon(client::Client& client) {
    return eventually([&client] {
      client.wait(std::chrono::milliseconds(100));
      return client.poll().is_permitted();
    });
  }
  /// Permission comes from the true daemon although `intruder` floods the domain with good, fresh
  /// messages: had one of them been heard, two senders would mean no permission for a second.
  void expect_unheard(const fs::path& intruder_keys) {
    client::Client client = robot();
    const Peer intruder("flood", test_domain(), intruder_keys.string());
    ASSERT_EQ(intruder.first_line(), "ready");
    const Peer daemon("publish", test_domain(), keys_of("daemon", "daemon").string());
    ASSERT_EQ(daemon.first_line(), "ready");
    ASSERT_TRUE(is_permitted_soon(client));
    EXPECT_EQ(client.counts().poses_refused, 0U);
  }
};

TEST_F(Security, TheDaemonReachesTheRobot) {
  client::Client client = robot();
  const Peer daemon("publish", test_domain(), keys_of("daemon", "daemon").string());
  ASSERT_EQ(daemon.first_line(), "ready");
  EXPECT_TRUE(is_permitted_soon(client));
}

TEST_F(Security, NobodyWithoutKeysIsHeard) {
  RecordProperty("requirement", "SR-88");
  expect_unheard({});
}

TEST_F(Security, NobodyOfAnotherAuthorityIsHeard) {
  RecordProperty("requirement", "SR-88");
  make_authorities(folder / "other", std::chrono::days{2});
  expect_unheard(keys_of("daemon", "impostor", 1, "other"));
}

TEST_F(Security, WithoutSecurityTheIntruderWouldBeHeard) {
  client::Parameters parameters;
  parameters.domain = test_domain();
  parameters.guard = client::Guard::absent;
  client::Client client(parameters);
  const Peer intruder("flood", test_domain());
  const Peer daemon("publish", test_domain());
  EXPECT_TRUE(eventually([&client] {
    client.wait(std::chrono::milliseconds(100));
    return client.poll().refusal == client::Refusal::second_source;
  }));
}

TEST_F(Security, OnlyADaemonMayPublishPoses) {
  RecordProperty("requirement", "SR-88");
  for (const char* role : {"robot", "operator", "observer"}) {
    const Peer peer("flood", test_domain(), keys_of(role, role).string());
    EXPECT_NE(peer.first_line().find("Not Allowed By Security"), std::string::npos)
        << role << ": " << peer.first_line();
  }
}

TEST_F(Security, KeysThatHaveEndedOpenNothing) {
  RecordProperty("requirement", "SR-88");
  const fs::path keys = keys_of("daemon", "late", -1);
  const Peer peer("flood", test_domain(), keys.string());
  EXPECT_NE(peer.first_line().find("cannot join domain"), std::string::npos) << peer.first_line();
  EXPECT_NE(refusal_of([&] {
              (void)require_valid_identity(keys, std::chrono::system_clock::now());
            }).find("not now"),
            std::string::npos);
}

TEST_F(Security, PermissionsThatWereTamperedWithOpenNothing) {
  RecordProperty("requirement", "SR-88");
  const fs::path keys = keys_of("observer", "observer");
  std::string text = text_of(keys / dds::kPermissionsFile);
  const auto at = text.find("<subscribe>");
  ASSERT_NE(at, std::string::npos);
  text.insert(at, "<publish><topics><topic>*</topic></topics></publish>");
  std::ofstream(keys / dds::kPermissionsFile, std::ios::binary) << text;
  const Peer peer("flood", test_domain(), keys.string());
  EXPECT_NE(peer.first_line().find("cannot join domain"), std::string::npos) << peer.first_line();
}

TEST_F(Security, KeysAreForTheirOwnerOnlyAndNeverReplaced) {
  const fs::path keys = keys_of("robot", "robot");
  const auto others = fs::perms::group_all | fs::perms::others_all;
  EXPECT_EQ(fs::status(keys / dds::kPrivateKeyFile).permissions() & others, fs::perms::none);
  const std::string before = text_of(keys / dds::kPrivateKeyFile);
  EXPECT_NE(refusal_of([&] { (void)keys_of("robot", "robot"); }).find("exists"), std::string::npos);
  EXPECT_EQ(text_of(keys / dds::kPrivateKeyFile), before);
  fs::permissions(keys / dds::kPrivateKeyFile, fs::perms::group_read, fs::perm_options::add);
  EXPECT_NE(refusal_of([&] { (void)read_identity(keys); }).find("others may read it"),
            std::string::npos);
}

TEST_F(Security, AnIdentityIsReadWholeOrRefusedByName) {
  const fs::path keys = keys_of("robot", "left_robot");
  EXPECT_EQ(read_identity(keys).subject, "CN=left_robot,O=Holdfast");
  const fs::path other = keys_of("robot", "right_robot");
  fs::copy_file(other / dds::kPrivateKeyFile, keys / dds::kPrivateKeyFile,
                fs::copy_options::overwrite_existing);
  EXPECT_NE(refusal_of([&] { (void)read_identity(keys); }).find("is not the key of"),
            std::string::npos);
  std::ofstream(other / dds::kCertificateFile) << "-----BEGIN CERTIFICATE-----\nAAAA\n";
  EXPECT_NE(refusal_of([&] { (void)read_identity(other); }).find("no certificate"),
            std::string::npos);
  fs::remove(other / dds::kGovernanceFile);
  EXPECT_NE(refusal_of([&] { (void)dds::security_configuration(other); }).find("governance.p7s"),
            std::string::npos);
}

TEST_F(Security, ANameThatIsNoNameIsRefused) {
  for (const char* name : {"", "a b", "../up", "x,O=Other"})
    EXPECT_NE(refusal_of([&] {
                make_participant(folder / "authority", folder / "new", *dds::find_role("robot"),
                                 name, std::chrono::days{1});
              }).find("letters, digits"),
              std::string::npos)
        << name;
  EXPECT_FALSE(fs::exists(folder / "new"));
}

TEST_F(Security, AParticipantDoesNotOutliveItsAuthorities) {
  EXPECT_NE(refusal_of([&] { (void)keys_of("robot", "robot", 3); }).find("the authorities end on"),
            std::string::npos);
  EXPECT_FALSE(fs::exists(folder / "robot"));
}

TEST(SecurityRights, AreTheLeastForEachRole) {
  RecordProperty("requirement", "SR-88");
  const auto publishers_of = [](std::string_view topic) {
    std::string roles;
    for (const dds::RoleRights& rights : dds::role_rights())
      if (std::find(rights.publishes.begin(), rights.publishes.end(), topic) !=
          rights.publishes.end())
        roles += std::string{rights.role} + " ";
    return roles;
  };
  EXPECT_EQ(publishers_of("holdfast/compensated_pose"), "daemon ");
  EXPECT_EQ(publishers_of("holdfast/motion_stop"), "daemon ");
  EXPECT_EQ(publishers_of("holdfast/guard_permission"), "guard ");
  EXPECT_EQ(publishers_of("holdfast/operator_command"), "operator ");
  EXPECT_EQ(publishers_of("holdfast/robot_status"), "robot ");
  EXPECT_TRUE(dds::find_role("observer")->publishes.empty());
  EXPECT_EQ(dds::find_role("nobody"), nullptr);
}

}  // namespace
}  // namespace holdfast::bridge
