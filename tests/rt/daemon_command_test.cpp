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

#include "bridge/camera_file.hpp"
#include "bridge/dds/daemon_claim.hpp"
#include "bridge/key_store.hpp"
#include "registration/hand_eye_file.hpp"
#include "rt/daemon_config.hpp"
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
  static void TearDownTestSuite() {
    fs::remove_all(setup_);
    is_rendered_ = false;
  }
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

/// Where the camera stands, as measured with the virtual microscope's own calibration.
class DaemonHandEye : public DaemonCommand {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(DaemonCommand::SetUp());
    const auto camera = holdfast::bridge::read_camera_file((folder_ / "camera.yaml").string());
    const auto registration =
        holdfast::registration::load_registration(folder_ / "registration.json");
    found_.T_robot_camera = Eigen::Translation3d(120, -35, 310) * Eigen::Isometry3d::Identity();
    found_.covariance = 1e-6 * holdfast::registration::Matrix6d::Identity();
    found_.zoom = registration.zoom;
    found_.focus_mm = registration.focus_mm;
    found_.image_width_px = camera.width_px;
    found_.image_height_px = camera.height_px;
    found_.camera_matrix << camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1;
    const auto begin = config_.find("[robot]"), end = config_.find("\n[", begin + 1);
    ASSERT_NE(begin, std::string::npos);
    config_.replace(begin, end - begin, "[robot]\nhand_eye = \"hand_eye.json\"\n");
  }
  void write() {
    std::ofstream(folder_ / "hand_eye.json") << holdfast::registration::sealed_hand_eye(found_);
  }
  void expect_refused_file(const std::string& part) {
    write();
    expect_refused(part);
    EXPECT_NE(err_.find("hand_eye.json"), std::string::npos) << err_;
  }
  holdfast::registration::HandEyeCalibration found_;
};

TEST_F(DaemonHandEye, TakesTheFileWithItsCovariance) {
  RecordProperty("requirement", "SR-140,SR-31");
  write();
  EXPECT_EQ(run("--check"), 0) << err_;
  const auto config = holdfast::rt::load_daemon_config(folder_ / "d.toml");
  EXPECT_TRUE(config.T_robot_camera.isApprox(found_.T_robot_camera));
  EXPECT_TRUE(config.hand_eye_sigma.covariance.isApprox(found_.covariance));
}

TEST_F(DaemonHandEye, RefusesToStartWithoutOne) {
  RecordProperty("requirement", "SR-140");
  expect_refused("hand_eye.json");  // named, but not there
  replace("hand_eye = \"hand_eye.json\"", "");
  expect_refused("without T_robot_camera no pose can be given");
}

TEST_F(DaemonHandEye, RefusesATypedTransformWithoutItsUncertainty) {
  RecordProperty("requirement", "SR-140");
  const std::string typed =
      "translation_mm = [120.0, -35.0, 310.0]\nrotation_xyzw = [0, 0, 0, 1.0]\n";
  replace("hand_eye = \"hand_eye.json\"", typed + "sigma_t_mm = 0\n");
  expect_refused("robot.sigma_r_rad");
  replace("sigma_t_mm = 0\n", "sigma_t_mm = 0\nsigma_r_rad = 0\n");
  EXPECT_EQ(run("--check"), 0) << err_;
  replace("sigma_t_mm", "hand_eye = \"hand_eye.json\"\nsigma_t_mm");
  expect_refused("contradicts hand_eye");
}

TEST_F(DaemonHandEye, RefusesAnotherSetUpsFile) {
  RecordProperty("requirement", "SR-140");
  const auto good = found_;
  found_.zoom *= 1.01;
  expect_refused_file("made at zoom");
  found_ = good;
  found_.focus_mm += 1;
  expect_refused_file("working distance");
  found_ = good;
  found_.image_width_px += 2;
  expect_refused_file("px, the camera's are");
  found_ = good;
  found_.camera_matrix(0, 2) += 0.15 / good.focus_mm * good.camera_matrix(0, 0);
  expect_refused_file("another camera calibration");
  found_ = good;
  write();
  std::string text = content(folder_ / "hand_eye.json");
  text.replace(text.find("120.0"), 5, "121.0");
  std::ofstream(folder_ / "hand_eye.json") << text;
  expect_refused("wrong checksum");
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
