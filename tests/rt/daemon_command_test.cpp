// SPDX-License-Identifier: Apache-2.0
// The built `holdfastd`, from outside: every mistake is one clear line and the right exit code.
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/dds/daemon_claim.hpp"
#include "bridge/key_store.hpp"
#include "tests/sim/demo/rig.hpp"

namespace {

namespace fs = std::filesystem;

class DaemonCommand : public ::testing::Test {
 protected:
  /// The virtual site's files, rendered once for all tests of this process. Not in
  /// SetUpTestSuite(): when that fails the tests are skipped, which ctest takes for success.
  static void render_setup() {
    if (is_rendered_) return;
    fs::create_directories(setup_);
    const std::string command =
        "'" HOLDFAST_SIM "' camera --write-setup '" + setup_.string() + "' >/dev/null";
    ASSERT_EQ(std::system(command.c_str()), 0);
    ASSERT_NO_THROW(holdfast::sim::write_registration(setup_));
    is_rendered_ = true;
  }
  static void TearDownTestSuite() { fs::remove_all(setup_); }
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(render_setup());
    folder_ = fs::path(::testing::TempDir()) /
              (std::string("holdfastd-") +
               ::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    fs::copy(setup_, folder_, fs::copy_options::recursive);
    config_ = content(HOLDFAST_DEMO_CONFIG);
  }
  void TearDown() override { fs::remove_all(folder_); }

  static std::string content(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }
  void replace(const std::string& from, const std::string& to) {
    const auto at = config_.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    config_.replace(at, from.size(), to);
  }
  int run(const std::string& arguments, const std::string& before = "") {
    std::ofstream(folder_ / "d.toml") << config_;
    const std::string command = "cd '" + folder_.string() + "' && " + before +
                                " '" HOLDFASTD "' --config d.toml " + arguments +
                                " >out.txt 2>err.txt </dev/null";
    const int status = std::system(command.c_str());
    err_ = content(folder_ / "err.txt");
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  void expect_refused(const std::string& part_of_the_line) {
    EXPECT_EQ(run("--check"), 2);
    EXPECT_EQ(std::count(err_.begin(), err_.end(), '\n'), 1) << err_;
    EXPECT_NE(err_.find(part_of_the_line), std::string::npos) << err_;
  }

  static inline const fs::path setup_ =
      fs::path(::testing::TempDir()) / ("holdfastd-setup-" + std::to_string(getpid()));
  static inline bool is_rendered_ = false;
  fs::path folder_;
  std::string config_, err_;
};

TEST_F(DaemonCommand, AcceptsTheDemosConfiguration) {
  EXPECT_EQ(run("--check"), 0) << err_;
}

TEST_F(DaemonCommand, NamesAnUnknownKeyWithItsPlace) {
  RecordProperty("requirement", "SR-82");
  replace("pose_validity_ms", "pose_validity_us");
  expect_refused("did you mean 'pose_validity_ms'?");
  EXPECT_NE(err_.find("d.toml:"), std::string::npos);
}

TEST_F(DaemonCommand, NamesAValueOutOfRange) {
  RecordProperty("requirement", "SR-82");
  replace("pose_validity_ms = 18", "pose_validity_ms = 21");
  expect_refused("safety.pose_validity_ms = 21 is out of range 2 to 20 ms");
}

TEST_F(DaemonCommand, RefusesAMicroscopeLeftOut) {
  RecordProperty("requirement", "SR-98");
  replace("local = \"can.sock\"", "");
  expect_refused("microscope.interface");
  EXPECT_NE(err_.find("optics = \"fixed\""), std::string::npos) << err_;
}

TEST_F(DaemonCommand, RefusesAMicroscopeThatIsAlsoDeclaredFixed) {
  RecordProperty("requirement", "SR-98");
  replace("local = \"can.sock\"", "local = \"can.sock\"\noptics = \"fixed\"");
  expect_refused("microscope.interface");
}

TEST_F(DaemonCommand, AcceptsDeclaredFixedOptics) {
  replace("local = \"can.sock\"", "optics = \"fixed\"");
  EXPECT_EQ(run("--check"), 0) << err_;
}

TEST_F(DaemonCommand, EndsWhenTheCanInterfaceIsNotThere) {
  replace("local = \"can.sock\"", "interface = \"holdfast9\"");
  EXPECT_EQ(run("--domain 93 --allow-non-rt"), 3) << err_;
  EXPECT_NE(err_.find("can: holdfast9: cannot "), std::string::npos) << err_;
}

TEST_F(DaemonCommand, ChecksWhereToRecord) {
  RecordProperty("requirement", "SR-82");
  config_ += "\n[recorder]\nfolder = \"recordings/of/today\"\n";
  EXPECT_EQ(run("--check"), 0) << err_;
  EXPECT_FALSE(fs::exists(folder_ / "recordings")) << "a check makes nothing";
  config_ += "size_max_mb = 1\n";
  expect_refused("recorder.size_max_mb = 1 is out of range 32 to 1000000");
  replace("size_max_mb = 1\n", "");
  replace("recordings/of/today", "camera.yaml");
  expect_refused("camera.yaml is not a folder");
  replace("folder = \"camera.yaml\"", "size_max_mb = 100");
  expect_refused("recorder.folder");
}

TEST_F(DaemonCommand, RefusesToBeUnsecuredUnlessAsked) {
  RecordProperty("requirement", "SR-89");
  replace("allow_unsecured = true", "");
  expect_refused("dds.security");
  EXPECT_NE(err_.find("allow_unsecured = true"), std::string::npos) << err_;
}

TEST_F(DaemonCommand, StartsOnlyWithKeysThatAreValidNow) {
  RecordProperty("requirement", "SR-89");
  namespace bridge = holdfast::bridge;
  const fs::path authority = folder_ / "authority";
  bridge::make_authorities(authority, std::chrono::days{2});
  const auto make = [&](const char* name, int days) {
    bridge::make_participant(authority, folder_ / name, *bridge::dds::find_role("daemon"), name,
                             std::chrono::days{days});
  };
  make("now", 1);
  make("past", -1);
  replace("allow_unsecured = true", "security = \"now\"");
  EXPECT_EQ(run("--check"), 0) << err_;
  replace("\"now\"", "\"past\"");
  expect_refused("past/certificate.pem: valid from");
  replace("\"past\"", "\"nowhere\"");
  expect_refused("nowhere/");
  replace("security = \"nowhere\"", "security = \"now\"\nallow_unsecured = true");
  expect_refused("either");
}

TEST_F(DaemonCommand, RefusesLimitsThatContradict) {
  RecordProperty("requirement", "SR-29");
  replace("pose_validity_ms = 18", "pose_validity_ms = 10");
  expect_refused("must not exceed pose_validity");
}

TEST_F(DaemonCommand, RefusesARotationThatIsNone) {
  replace("rotation_xyzw = [0.0,", "rotation_xyzw = [0.5,");
  expect_refused("robot.rotation_xyzw has norm");
}

TEST_F(DaemonCommand, RefusesToGoWithoutTheRobotsCameraPose) {
  replace("translation_mm", "#");
  expect_refused("robot.translation_mm");
}

TEST_F(DaemonCommand, RefusesARegistrationWithAWrongChecksum) {
  RecordProperty("requirement", "SR-80");
  std::string text = content(folder_ / "registration.json");
  const auto at = text.find("\"fre_mm\": 0.1");
  ASSERT_NE(at, std::string::npos);
  text.replace(at, 13, "\"fre_mm\": 0.2");
  std::ofstream(folder_ / "registration.json") << text;
  expect_refused("wrong checksum");
}

TEST_F(DaemonCommand, RefusesAChangedKeyframe) {
  RecordProperty("requirement", "SR-80");
  std::ofstream(folder_ / "keyframe.png", std::ios::app) << "x";
  expect_refused("keyframe.png");
}

TEST_F(DaemonCommand, RefusesACalibrationOfAnotherSize) {
  replace("width_px = 1920", "width_px = 1280");
  expect_refused("the calibration is for 1920x1080 px, the camera is set to 1280x1080 px");
}

TEST_F(DaemonCommand, RefusesMissingFilesAndUsage) {
  fs::remove(folder_ / "camera.yaml");
  expect_refused("camera.yaml");
  EXPECT_EQ(run("--no-such-option"), 2);
  EXPECT_EQ(std::count(err_.begin(), err_.end(), '\n'), 1) << err_;
}

TEST_F(DaemonCommand, SaysThatTheCameraIsNotThere) {
  EXPECT_EQ(run("--camera 127.0.0.77 --domain 41 --allow-non-rt"), 3);
  EXPECT_NE(err_.find("127.0.0.77"), std::string::npos) << err_;
  EXPECT_EQ(err_.find("permitted"), std::string::npos) << err_;
}

TEST_F(DaemonCommand, RefusesASecondDaemonOnADomain) {
  RecordProperty("requirement", "SR-81");
  const holdfast::bridge::dds::DomainLock first{42};
  EXPECT_EQ(run("--camera 127.0.0.77 --domain 42 --allow-non-rt"), 2);
  EXPECT_NE(err_.find("domain 42 already has a Holdfast daemon"), std::string::npos) << err_;
}

TEST_F(DaemonCommand, RefusesToRunWithoutRealTimeUnlessTold) {
  RecordProperty("requirement", "SR-76");
  replace("allow_non_rt = true", "allow_non_rt = false");
  // Without these capabilities and limits the kernel denies SCHED_FIFO and mlockall, also to root.
  const std::string unprivileged =
      "prlimit --rtprio=0 --memlock=65536 setpriv --inh-caps -all --bounding-set "
      "-sys_nice,-ipc_lock";
  EXPECT_EQ(run("--camera 127.0.0.77 --domain 43", unprivileged), 3);
  EXPECT_NE(err_.find("denied"), std::string::npos) << err_;
  EXPECT_EQ(err_.find("127.0.0.77"), std::string::npos) << "it went on to the camera: " << err_;
  EXPECT_EQ(run("--camera 127.0.0.77 --domain 43 --allow-non-rt", unprivileged), 3);
  EXPECT_NE(err_.find("127.0.0.77"), std::string::npos)
      << "allowed, it reaches the camera: " << err_;
}

}  // namespace
