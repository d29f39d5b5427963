// SPDX-License-Identifier: Apache-2.0
// holdfast-outlets as a process, heard by those who know nothing of ours: Fast DDS with ROS 2's
// names and definitions, and an OpenIGTLink client in Python.
#include <gtest/gtest.h>

#include "bridge/key_store.hpp"
#include "tests/rt/dashboard_room.hpp"

namespace holdfast::outlets {
namespace {

using dashboard::testing::PlayedCamera;
using dashboard::testing::PlayedRoom;
using dashboard::testing::text_of;
using nlohmann::json;
using safety::Reason;
using std::chrono::milliseconds;
namespace dds = bridge::dds;
namespace fs = std::filesystem;

std::size_t count(const std::string& text, const std::string& word) {
  std::size_t n = 0;
  for (auto at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) ++n;
  return n;
}

class OutletsProcess : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] fs::path log(const std::string& name) const { return folder_ / (name + ".log"); }
  [[nodiscard]] std::string said(const std::string& name) const { return text_of(log(name)); }
  [[nodiscard]] std::string ros2_domain() const {
    return std::to_string(domain_ < 99 ? domain_ + 1 : domain_ - 1);
  }
  /// The program's configuration; the ROS side has its own network, without our discovery tag.
  [[nodiscard]] fs::path configuration(const std::string& security = "allow_unsecured = true",
                                       const std::string& ros2 = "on = true\n") const {
    const fs::path file = folder_ / "outlets.toml";
    std::ofstream(file) << "domain = " << domain_ << "\n[dds]\n"
                        << security << "\n[ros2]\n"
                        << ros2 << "domain = " << ros2_domain()
                        << "\nnetwork = \"" HOLDFAST_LOOPBACK_CONFIG "\"\n"
                        << "[openigtlink]\non = true\nport = 0\n";
    return file;
  }
  [[nodiscard]] sim::ChildProcess start(const fs::path& config,
                                        const std::vector<std::string>& more = {}) const {
    std::vector<std::string> words{"--config", config};
    words.insert(words.end(), more.begin(), more.end());
    sim::ChildProcess process(HOLDFAST_OUTLETS, words, log("outlets"));
    EXPECT_TRUE(dds::eventually([&] {
      return said("outlets").find("ready") != std::string::npos || !process.is_running();
    }));
    return process;
  }
  [[nodiscard]] sim::ChildProcess hear_ros2() const {
    return {HOLDFAST_FASTDDS_PEER,
            {ros2_domain(), "rt/tf", "tf2_msgs::msg::dds_::TFMessage_", "reliable", "volatile",
             "rt/tf_static", "tf2_msgs::msg::dds_::TFMessage_", "reliable", "transient",
             "rt/holdfast/target_pose", "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
             "best_effort", "volatile", "rt/diagnostics",
             "diagnostic_msgs::msg::dds_::DiagnosticArray_", "reliable", "volatile"},
            log("ros2")};
  }
  [[nodiscard]] sim::ChildProcess hear_igtl(const std::vector<std::string>& first = {}) const {
    const std::string text = said("outlets");
    const auto at = text.find("OpenIGTLink on 127.0.0.1:");
    std::vector<std::string> words{HOLDFAST_OUTLETS_SCRIPTS "/igtl_client.py",
                                   std::to_string(std::stoi(text.substr(at + 25)))};
    words.insert(words.end(), first.begin(), first.end());
    return {"/usr/bin/python3", words, log("igtl")};
  }
  [[nodiscard]] bool igtl_says(const std::string& word, std::size_t times = 1) const {
    return dds::eventually([&] { return count(said("igtl"), word) >= times; });
  }
  /// Every message that the Python client read, oldest first.
  [[nodiscard]] std::vector<json> igtl_messages() const {
    std::vector<json> all;
    std::istringstream lines(said("igtl"));
    for (std::string line; std::getline(lines, line);)
      if (auto message = json::parse(line, nullptr, false); message.is_object())
        all.push_back(std::move(message));
    return all;
  }
  /// Exit code of the program with this configuration; its one line in outlets.log.
  [[nodiscard]] int check(const std::string& config) const {
    const fs::path file = folder_ / "check.toml";
    std::ofstream(file) << config;
    fs::remove(log("outlets"));
    sim::ChildProcess process(HOLDFAST_OUTLETS, {"--config", file, "--check"}, log("outlets"));
    return process.wait(milliseconds(60'000));
  }

  const std::uint32_t domain_ = dds::test_domain();
  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-outlets-" + std::to_string(::getpid()));
};

/// What ROS 2's own definitions make of what Fast DDS heard.
json read_ros2(const fs::path& heard, const fs::path& out) {
  setenv("NODE_PATH", HOLDFAST_NODE_MODULES, 1);
  sim::ChildProcess node("/usr/bin/env", {"node", HOLDFAST_OUTLETS_SCRIPTS "/read_ros2.cjs", heard},
                         out);
  EXPECT_EQ(node.wait(milliseconds(60'000)), 0) << text_of(out);
  return json::parse(text_of(out), nullptr, false);
}

/// Translation and rotation, x y z and x y z w.
void expect_near(const json& vector, const std::vector<double>& wanted) {
  const char* const names[] = {"x", "y", "z", "w"};
  for (std::size_t i = 0; i < wanted.size(); ++i)
    EXPECT_NEAR(vector[names[i]].get<double>(), wanted[i], 1e-12) << vector << i;
}

void expect_transform(const json& t, const std::string& frame, const std::string& child,
                      const std::vector<double>& translation_m,
                      const std::vector<double>& rotation_xyzw) {
  EXPECT_EQ(t["header"]["frame_id"], frame);
  EXPECT_EQ(t["child_frame_id"], child);
  expect_near(t["transform"]["translation"], translation_m);
  expect_near(t["transform"]["rotation"], rotation_xyzw);
}

const json* find_transform(const json& messages, const std::string& child) {
  for (const json& message : messages)
    for (const json& t : message["transforms"])
      if (t["child_frame_id"] == child) return &t;
  return nullptr;
}

TEST_F(OutletsProcess, RosNodesReadTheMirrorInMetresAndTheirAxesAndNothingOfAStop) {
  RecordProperty("requirement", "SR-141");
  const dds::Participant participant({.domain = domain_, .configuration = {}});
  const sim::ChildProcess outlets = start(configuration());
  const sim::ChildProcess ros2 = hear_ros2();
  const auto heard = [this](const std::string& topic, std::size_t times) {
    return dds::eventually([&] { return count(said("ros2"), topic + " 00010000") >= times; });
  };
  ASSERT_TRUE(heard("rt/diagnostics", 1)) << said("outlets") << said("ros2");
  ASSERT_EQ(count(said("ros2"), "rt/tf 0001"), 0U) << "nothing is at work yet";
  std::optional<PlayedRoom> room(std::in_place, participant);
  ASSERT_TRUE(heard("rt/tf", 40));
  ASSERT_TRUE(heard("rt/holdfast/target_pose", 10));
  ASSERT_TRUE(heard("rt/tf_static", 1));

  // After the stop: two more diagnostics let pass what was under way, then none of a pose may come.
  room->cause = Reason::drift_exceeded;
  const std::string reason = "64726966745f6578636565646564";  // drift_exceeded
  ASSERT_TRUE(dds::eventually([&] { return count(said("ros2"), reason) >= 2; }));
  const std::string before = said("ros2");
  ASSERT_TRUE(dds::eventually([&] { return count(said("ros2"), reason) >= 7; }));
  const std::string after = said("ros2");
  EXPECT_EQ(count(after, "rt/tf 0001"), count(before, "rt/tf 0001"));
  EXPECT_EQ(count(after, "target_pose 0001"), count(before, "target_pose 0001"));
  room->is_silent = true;
  ASSERT_TRUE(
      dds::eventually([&] { return count(said("ros2"), "6461656d6f6e5f73696c656e74") >= 2; }));
  room.reset();

  const json read = read_ros2(log("ros2"), folder_ / "read.json");
  ASSERT_TRUE(read.is_object());
  const double half = std::sqrt(0.5);
  const json* const t = find_transform(read["rt/tf"], "holdfast_patient");
  ASSERT_NE(t, nullptr);
  expect_transform(*t, "holdfast_robot", "holdfast_patient", {0.1, -0.02, 0.3}, {0, 0, 0, 1});
  const json* const site = find_transform(read["rt/tf"], "holdfast_site_optical");
  ASSERT_NE(site, nullptr);
  expect_transform(*site, "holdfast_ct_lps", "holdfast_site_optical", {-0.005, -0.006, -0.25},
                   {0, 0, 0, 1});
  expect_transform(*find_transform(read["rt/tf"], "holdfast_camera_optical"),
                   "holdfast_site_optical", "holdfast_camera_optical", {-0.001, -0.002, -0.003},
                   {0, 0, 0, 1});
  const json& fixed = read["rt/tf_static"][0]["transforms"];
  expect_transform(fixed[0], "holdfast_patient", "holdfast_ct_lps", {0, 0, 0}, {0, 0, half, half});
  expect_transform(fixed[1], "holdfast_camera_optical", "holdfast_camera", {0, 0, 0},
                   {0.5, -0.5, 0.5, 0.5});

  const json& pose = read["rt/holdfast/target_pose"].back();
  EXPECT_EQ(pose["header"]["frame_id"], "holdfast_robot");
  expect_near(pose["pose"]["pose"]["position"], {0.11, -0.015, 0.32});
  expect_near(pose["pose"]["pose"]["orientation"], {0, 0, 0, 1});
  const json& covariance = pose["pose"]["covariance"];
  EXPECT_NEAR(covariance[0].get<double>(), 0.04e-6, 1e-18) << "m2";
  EXPECT_NEAR(covariance[3].get<double>(), 0.003e-3, 1e-15) << "m rad";
  EXPECT_NEAR(covariance[21].get<double>(), 0.04, 1e-12) << "rad2";
  const auto now_s = std::chrono::duration<double>(dds::read_clocks().utc).count();
  EXPECT_NEAR(pose["header"]["stamp"]["sec"].get<double>(), now_s, 120);
  EXPECT_EQ(read["rt/diagnostics"][0]["status"][0]["level"], 3);
  EXPECT_EQ(read["rt/diagnostics"][0]["status"][0]["hardware_id"], "holdfast");
}

TEST_F(OutletsProcess, SlicerGetsTransformsWhileTheyHoldAndStatusWithTheReason) {
  RecordProperty("requirement", "SR-141");
  const dds::Participant participant({.domain = domain_, .configuration = {}});
  const sim::ChildProcess outlets = start(configuration());
  const sim::ChildProcess client = hear_igtl();
  ASSERT_TRUE(igtl_says("daemon_silent")) << said("igtl");
  PlayedRoom room(participant);
  ASSERT_TRUE(igtl_says("RobotToPatient", 5)) << said("igtl");
  ASSERT_TRUE(igtl_says("CameraToPatient", 5));
  room.cause = Reason::drift_exceeded;
  ASSERT_TRUE(igtl_says("\"name\": \"drift_exceeded\"", 5));

  const std::vector<json> all = igtl_messages();
  EXPECT_EQ(all.front()["type"], "STATUS") << "before anything else";
  EXPECT_EQ(all.front()["code"], 7);
  int code = 0;
  for (const json& message : all) {
    if (message["type"] == "STATUS") code = message["code"];
    if (message["type"] == "TRANSFORM") {
      EXPECT_EQ(code, 1) << "by the newest STATUS before it";
    }
  }
  EXPECT_EQ(code, 3);
  const auto matrix = [&all](const std::string& device) {
    for (const json& message : all)
      if (message["device"] == device) return message["matrix"];
    return json();
  };
  const auto expect = [](const json& got, const std::vector<std::vector<double>>& wanted) {
    ASSERT_TRUE(got.is_array());
    for (std::size_t row = 0; row < 3; ++row)
      for (std::size_t column = 0; column < 4; ++column)
        EXPECT_NEAR(got[row][column].get<double>(), wanted[row][column], 1e-5) << row << column;
  };
  expect(matrix("CameraToPatient"), {{-1, 0, 0, 6}, {0, -1, 0, 8}, {0, 0, 1, -253}});
  expect(matrix("RobotToPatient"), {{0, -1, 0, -20}, {1, 0, 0, -100}, {0, 0, 1, -300}});
  EXPECT_NEAR(all.back()["t_utc_s"].get<double>(),
              std::chrono::duration<double>(dds::read_clocks().utc).count(), 120);
}

TEST_F(OutletsProcess, SlicerGetsTheLivePictureInItsPlaceAndABlackOneAfterTheLast) {
  RecordProperty("requirement", "SR-146");
  const sim::ChildProcess outlets = start(configuration(), {"--live-view", folder_ / "live_view"});
  const sim::ChildProcess client = hear_igtl();
  ASSERT_TRUE(igtl_says("STATUS")) << said("igtl");
  std::optional<PlayedCamera> camera(std::in_place, folder_ / "live_view");
  ASSERT_TRUE(igtl_says("IMAGE", 5)) << said("igtl") << said("outlets");
  const auto is_black = [](const json& m) {
    return m["type"] == "IMAGE" && m["left"] == 0 && m["right"] == 0;
  };
  const auto blacks = [&] {
    const auto all = igtl_messages();
    return std::count_if(all.begin(), all.end(), is_black);
  };
  EXPECT_EQ(blacks(), 0);
  camera->is_stuck = true;
  ASSERT_TRUE(dds::eventually([&] { return blacks() == 1; })) << said("igtl");
  camera->is_stuck = false;
  const std::size_t before = count(said("igtl"), "IMAGE");
  ASSERT_TRUE(igtl_says("IMAGE", before + 2));
  camera.reset();
  ASSERT_TRUE(dds::eventually([&] { return blacks() == 2; })) << said("igtl");
  ASSERT_TRUE(igtl_says("STATUS", count(said("igtl"), "STATUS") + 3));

  json image;
  for (const json& m : igtl_messages()) {
    if (m["type"] != "IMAGE") continue;
    EXPECT_EQ(m["device"], "CameraImage");
    if (!is_black(m)) image = m;
  }
  EXPECT_TRUE(is_black([&] {
    json last;
    for (const json& m : igtl_messages())
      if (m["type"] == "IMAGE") last = m;
    return last;
  }()));
  EXPECT_EQ(image["size"], (json{320, 180, 1}));
  EXPECT_EQ(image["components"], 1);
  EXPECT_EQ(image["coordinates"], 1) << "not to be turned";
  EXPECT_EQ(image["left"], dashboard::testing::kLiveDark);
  EXPECT_EQ(image["right"], dashboard::testing::kLiveLight);
  // 200 mm / 3000 px; the axis is half a pixel from the middle.
  const double spacing = 200.0 / 3000;
  const std::vector<std::vector<double>> wanted{
      {spacing, 0, 0, -0.5 * spacing}, {0, spacing, 0, -0.5 * spacing}, {0, 0, spacing, 200}};
  for (std::size_t row = 0; row < 3; ++row)
    for (std::size_t column = 0; column < 4; ++column)
      EXPECT_NEAR(image["matrix"][row][column].get<double>(), wanted[row][column], 1e-5)
          << row << column;
  EXPECT_NEAR(image["t_utc_s"].get<double>(),
              std::chrono::duration<double>(dds::read_clocks().utc).count(), 120);
}

TEST_F(OutletsProcess, RosNodesReadTheLivePictureAndNoOldOne) {
  RecordProperty("requirement", "SR-146");
  std::optional<PlayedCamera> camera(std::in_place, folder_ / "live_view");
  const sim::ChildProcess outlets = start(configuration(), {"--live-view", folder_ / "live_view"});
  EXPECT_NE(said("outlets").find("holdfast/image"), std::string::npos) << said("outlets");
  const sim::ChildProcess ros2(
      HOLDFAST_FASTDDS_PEER,
      {ros2_domain(), "rt/holdfast/image", "sensor_msgs::msg::dds_::Image_", "best_effort",
       "volatile", "rt/diagnostics", "diagnostic_msgs::msg::dds_::DiagnosticArray_", "reliable",
       "volatile"},
      log("ros2"));
  const std::string image = "rt/holdfast/image 00010000", silent = "6461656d6f6e5f73696c656e74";
  ASSERT_TRUE(dds::eventually([&] { return count(said("ros2"), image) >= 3; })) << said("outlets");
  camera->is_stuck = true;
  // After kLiveAgeMax none may come: diagnostics are told five times a second.
  const auto diagnostics = [&](std::size_t more) {
    const std::size_t wanted = count(said("ros2"), silent) + more;
    return dds::eventually([&] { return count(said("ros2"), silent) >= wanted; });
  };
  ASSERT_TRUE(diagnostics(4));
  const std::size_t before = count(said("ros2"), image);
  ASSERT_TRUE(diagnostics(4));
  EXPECT_EQ(count(said("ros2"), image), before);
  const json read = read_ros2(log("ros2"), folder_ / "read.json");
  const json& m = read["rt/holdfast/image"].back();
  EXPECT_EQ(m["header"]["frame_id"], "holdfast_camera_optical");
  EXPECT_EQ(m["width"], 320);
  EXPECT_EQ(m["height"], 180);
  EXPECT_EQ(m["encoding"], "mono8");
  EXPECT_EQ(m["step"], 320);
  EXPECT_EQ(m["is_bigendian"], 0);
  ASSERT_EQ(m["data"].size(), 320U * 180U);
  EXPECT_EQ(m["data"][5], dashboard::testing::kLiveDark);
  EXPECT_EQ(m["data"][319], dashboard::testing::kLiveLight);
  EXPECT_NEAR(m["header"]["stamp"]["sec"].get<double>(),
              std::chrono::duration<double>(dds::read_clocks().utc).count(), 120);
}

TEST_F(OutletsProcess, NothingThatComesInChangesAnything) {
  RecordProperty("requirement", "SR-142");
  const dds::Participant participant({.domain = domain_, .configuration = {}});
  const dds::Reader<msg::RobotStatus> status(participant);
  const dds::Reader<msg::OperatorCommand> commands(participant);
  PlayedRoom room(participant);
  sim::ChildProcess outlets = start(configuration());
  const sim::ChildProcess client =
      hear_igtl({std::string(300, '\x7f'), "GET_TRANSFORM", "STP_TDATA"});
  ASSERT_TRUE(igtl_says("RobotToPatient", 20)) << said("igtl");
  EXPECT_EQ(commands.status().matched, 0U) << "it has no writer where robots listen";
  EXPECT_EQ(status.status().matched, 1U) << "the room's own alone";
  EXPECT_EQ(outlets.end(milliseconds(20'000)), 0);
}

TEST_F(OutletsProcess, HearsASecuredDomainAsObserverAndSaysWhatIsNot) {
  RecordProperty("requirement", "SR-142");
  const fs::path keys = folder_ / "keys";
  bridge::make_authorities(keys / "authority", std::chrono::days{2});
  for (const char* role : {"daemon", "observer"})
    bridge::make_participant(keys / "authority", keys / role, *dds::find_role(role), role,
                             std::chrono::days{1});
  const dds::Participant secured(
      {.domain = domain_, .configuration = {}, .security = (keys / "daemon").string()});
  dds::ProtectedWriter<msg::MotionStop> stops(secured, dds::random_source());
  const sim::ChildProcess outlets = start(configuration("security = \"keys/observer\""));
  EXPECT_NE(said("outlets").find("secured, as observer"), std::string::npos) << said("outlets");
  EXPECT_NE(said("outlets").find("ROS 2 on domain " + ros2_domain() + ", UNSECURED"),
            std::string::npos);
  EXPECT_NE(said("outlets").find("UNENCRYPTED"), std::string::npos);
  const sim::ChildProcess client = hear_igtl();
  EXPECT_TRUE(dds::eventually([&] {
    msg::MotionStop stop{};
    stop.mode = static_cast<std::uint8_t>(safety::Mode::ready);
    stop.cause = static_cast<std::uint8_t>(Reason::not_armed);
    (void)stops.publish(stop);
    return said("igtl").find("not_armed") != std::string::npos;
  })) << said("outlets")
      << said("igtl");
}

TEST_F(OutletsProcess, RefusesToMirrorOntoTheDaemonsDomainAndNamesEachMistake) {
  RecordProperty("requirement", "SR-142");
  const std::string dds = "[dds]\nallow_unsecured = true\n";
  EXPECT_EQ(check(dds + "[openigtlink]\non = true\n"), 0) << said("outlets");
  for (const auto& [config, wanted] : std::vector<std::pair<std::string, std::string>>{
           {"domain = 3\n" + dds + "[ros2]\non = true\ndomain = 3\n", "is the daemon's"},
           {dds, "none is on"},
           {dds + "[openigtlink]\non = true\naddress = \"0.0.0.0\"\n", "beyond loopback"},
           {dds + "[ros2]\non = true\nrobot_frame = \"\"\n", "robot_frame"},
           {dds + "[ros2]\non = true\nrate_h = 3\n", "did you mean 'rate_hz'?"},
           {"[ros2]\non = true\n", "allow_unsecured"}}) {
    EXPECT_EQ(check(config), 2) << config;
    EXPECT_NE(said("outlets").find(wanted), std::string::npos) << said("outlets");
    EXPECT_EQ(count(said("outlets"), "\n"), 1U) << said("outlets");
  }
}

}  // namespace
}  // namespace holdfast::outlets
