// SPDX-License-Identifier: Apache-2.0
// holdfast-dashboard as a process: what it answers while daemon and guard come and go, and what it
// does with those who ask otherwise than a page does.
#include <cstring>
#include <random>

#include <gtest/gtest.h>

#include "bridge/key_store.hpp"
#include "tests/rt/dashboard_room.hpp"
#include "tests/sim/demo/rig.hpp"

namespace holdfast::dashboard::testing {
namespace {

using nlohmann::json;

/// What `/live` says, and how long its picture is.
json live_json(const std::string& body) {
  if (body.size() < 12 || !body.starts_with("HFL1")) return {};
  std::uint32_t text = 0, mask = 0;
  std::memcpy(&text, body.data() + 4, 4);
  std::memcpy(&mask, body.data() + 8, 4);
  if (body.size() < 12 + std::size_t{text} + mask) return {};
  json answer = json::parse(body.substr(12, text), nullptr, false);
  answer["jpeg_bytes"] = body.size() - 12 - text - mask;
  return answer;
}

class DashboardProcess : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }
  /// Exit code of the program with this configuration, checked only; its one line in said_.
  int check(const std::string& config) {
    std::ofstream(folder_ / "check.toml") << config;
    fs::remove(folder_ / "check.log");
    sim::ChildProcess process(HOLDFAST_DASHBOARD, {"--config", folder_ / "check.toml", "--check"},
                              folder_ / "check.log");
    const int code = process.wait(milliseconds(60'000));
    said_ = text_of(folder_ / "check.log");
    return code;
  }

  const std::uint32_t domain_ = dds::test_domain();
  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-dashboard-" + std::to_string(::getpid()));
  dds::Participant participant_{{.domain = domain_, .configuration = {}}};
  std::string said_;
};

TEST_F(DashboardProcess, ShowsPermissionItsEndAndItsReturn) {
  RecordProperty("requirement", "SR-130");
  const Dashboard dashboard(folder_);
  ASSERT_NE(dashboard.port(), 0) << dashboard.log();
  EXPECT_EQ(dashboard.level(), "no_data");
  PlayedRoom room(participant_);
  EXPECT_TRUE(dashboard.becomes("permitted"));
  room.is_silent = true;
  EXPECT_TRUE(dashboard.becomes("no_data"));
  room.is_silent = false;
  EXPECT_TRUE(dashboard.becomes("permitted"));
  room.is_guard_silent = true;
  EXPECT_TRUE(dashboard.becomes("no_data"));
  EXPECT_EQ(dashboard.ask("/state")["shown"]["reason"], "guard_silent");
  room.is_guard_silent = false;
  EXPECT_TRUE(dashboard.becomes("permitted"));
  room.cause = safety::Reason::drift_exceeded;
  EXPECT_TRUE(dashboard.becomes("stop"));

  const json state = dashboard.ask("/state");
  EXPECT_EQ(state["shown"]["word"], "STOP");
  EXPECT_EQ(state["daemon"]["reasons"][0]["name"], "drift_exceeded");
  EXPECT_EQ(state["tracking"]["inliers"], 150);
  EXPECT_EQ(state["registration"]["zoom"], 1.3);
  EXPECT_TRUE(state["robot"]["is_enabled"]);
  const json history = dashboard.ask("/history");
  EXPECT_GE(history["stops"].size(), 3U);
  EXPECT_EQ(history["stops"][0]["reason"], "drift_exceeded");
  EXPECT_GT(history["exposure_to_pose"]["count"], 0);
}

TEST_F(DashboardProcess, NeverAnswersPermittedLaterThanItsTimeAfterTheLastMessage) {
  RecordProperty("requirement", "SR-130");
  const Dashboard dashboard(folder_);
  PlayedRoom room(participant_);
  ASSERT_TRUE(dashboard.becomes("permitted"));
  room.is_silent = true;
  const auto t_silent = dds::read_clocks().monotonic;
  // Answers to questions asked later than that may not be "permitted": 20 ms validity, 100 ms
  // silence, 10 ms an answer is kept, and what one call of publish() may take after is_silent.
  constexpr milliseconds kBound{200};
  for (;;) {
    const auto t_asked = dds::read_clocks().monotonic;
    const std::string level = dashboard.level();
    if (t_asked - t_silent > kBound) {
      EXPECT_EQ(level, "no_data");
      break;
    }
  }
}

TEST_F(DashboardProcess, ShowsTheLossAndReturnOfARealDaemon) {
  RecordProperty("requirement", "SR-130");
  sim::RigParameters parameters;
  parameters.folder = folder_ / "rig";
  parameters.daemon_config = HOLDFAST_DEMO_CONFIG;
  parameters.guard_config = HOLDFAST_GUARD_CONFIG;
  parameters.domain = static_cast<int>(domain_);
  sim::Rig rig(parameters);
  const Dashboard dashboard(folder_);
  const auto is_permitted = [&] { return rig.wait_permitted(std::chrono::seconds(60)); };
  ASSERT_TRUE(is_permitted());
  EXPECT_TRUE(dashboard.becomes("permitted"));
  EXPECT_TRUE(dashboard.ask("/state")["registration"].is_object());
  rig.kill_daemon();
  EXPECT_TRUE(dashboard.becomes("no_data"));
  EXPECT_TRUE(dashboard.ask("/state")["daemon"].is_null());
  rig.restart_daemon();
  ASSERT_TRUE(is_permitted());
  EXPECT_TRUE(dashboard.becomes("permitted"));
}

TEST_F(DashboardProcess, ShowsTheLiveViewOfARealDaemonAndNoneWhenItIsKilled) {
  RecordProperty("requirement", "SR-146");
  const fs::path daemon_config = folder_ / "daemon.toml";
  std::ofstream(daemon_config) << text_of(HOLDFAST_DEMO_CONFIG)
                               << "\n[live_view]\nfile = \"live_view\"\n";
  sim::RigParameters parameters;
  parameters.folder = folder_ / "rig";
  parameters.daemon_config = daemon_config;
  parameters.guard_config = HOLDFAST_GUARD_CONFIG;
  parameters.domain = static_cast<int>(domain_);
  sim::Rig rig(parameters);
  const Dashboard dashboard(folder_, "", {"--live-view", folder_ / "rig" / "live_view"});
  ASSERT_TRUE(rig.wait_permitted(std::chrono::seconds(60)));
  json live;
  const auto shows = [&](bool is_there) {
    return dds::eventually([&] {
      live = live_json(body_of(get(dashboard.port(), "/live")));
      return live.is_object() && live["why"].is_null() == is_there;
    });
  };
  ASSERT_TRUE(shows(true)) << live;
  EXPECT_EQ(live["width_px"], 640);
  EXPECT_EQ(live["height_px"], 360);
  EXPECT_LT(live["age_ms"], 500);
  EXPECT_EQ(live["status"], "tracking") << live;
  EXPECT_GT(live["points_tenth_px"].size(), 100U);
  EXPECT_TRUE(live["to_tenth_px"].is_array());
  EXPECT_GT(live["jpeg_bytes"], 2000);
  rig.kill_daemon();
  ASSERT_TRUE(fs::exists(folder_ / "rig" / "live_view")) << "its last picture is still there";
  EXPECT_TRUE(shows(false)) << live;
  EXPECT_EQ(live["why"], "no new frame comes");
  EXPECT_EQ(live["jpeg_bytes"], 0);
  rig.restart_daemon();
  ASSERT_TRUE(rig.wait_permitted(std::chrono::seconds(60)));
  EXPECT_TRUE(shows(true)) << live;
}

TEST_F(DashboardProcess, ReadsASecuredDomainAsObserver) {
  RecordProperty("requirement", "SR-131");
  const std::uint32_t other = domain_ + (domain_ < 99 ? 1 : 0U - 1);
  const fs::path keys = folder_ / "keys";
  bridge::make_authorities(keys / "authority", std::chrono::days{2});
  for (const char* role : {"daemon", "observer"})
    bridge::make_participant(keys / "authority", keys / role, *dds::find_role(role), role,
                             std::chrono::days{1});
  ASSERT_TRUE(dds::find_role("observer")->publishes.empty());
  const dds::Participant secured(
      {.domain = other, .configuration = {}, .security = (keys / "daemon").string()});
  dds::ProtectedWriter<msg::MotionStop> stops(secured, dds::random_source());
  const Dashboard dashboard(folder_, "", {"--domain", std::to_string(other)},
                            "security = \"keys/observer\"");
  ASSERT_NE(dashboard.port(), 0) << dashboard.log();
  EXPECT_TRUE(dds::eventually([&] {
    msg::MotionStop stop{};
    stop.mode = static_cast<std::uint8_t>(safety::Mode::ready);
    stop.cause = static_cast<std::uint8_t>(safety::Reason::not_armed);
    (void)stops.publish(stop);
    return dashboard.level() == "not_ready";
  }));
  // It holds no right to write, and no writer: nothing of it matches on the daemon's side.
  const dds::Reader<msg::RobotStatus> status(secured);
  EXPECT_EQ(status.status().matched, 0U);
}

TEST_F(DashboardProcess, RefusesWhatIsNotASmallGet) {
  RecordProperty("requirement", "SR-132");
  const Dashboard dashboard(folder_);
  const auto port = dashboard.port();
  EXPECT_EQ(status_of(get(port, "/")), 200);
  for (const char* method : {"POST", "PUT", "DELETE", "OPTIONS", "HEAD", "PATCH", "CONNECT"})
    EXPECT_EQ(status_of(talk(port, std::string(method) + " / HTTP/1.1\r\nHost: localhost\r\n\r\n")),
              405)
        << method;
  for (const char* path : {"/..", "/../etc/passwd", "/%2e%2e/etc/passwd", "/index.html", "//", "*",
                           "/state/", "/package.json", "/surfaces/ct"})
    EXPECT_EQ(status_of(get(port, path)), 404) << path;
  const std::string endless(200'000, 'a');
  for (const std::string& request : std::vector<std::string>{
           "GET /" + endless + " HTTP/1.1\r\n\r\n", "GET / HTTP/1.1\r\nX: " + endless + "\r\n\r\n",
           "GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello",
           "GET / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: "
           "chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
           std::string("\0\1\2\3\r\n\r\n", 8), std::string("GET\r\n\r\n")}) {
    const int status = status_of(talk(port, request));
    EXPECT_TRUE(status == 400 || status == 0) << status << " " << request.substr(0, 40);
  }
  EXPECT_EQ(status_of(get(port, "/", "", "evil.example")), 421);
  EXPECT_EQ(status_of(get(port, "/state")), 200) << "it still serves";
}

TEST_F(DashboardProcess, SurvivesRequestsWithBytesChangedAddedAndCutOff) {
  RecordProperty("requirement", "SR-132");
  Dashboard dashboard(folder_);
  const std::string good = "GET /state HTTP/1.1\r\nHost: localhost\r\nCookie: a=b\r\n\r\n";
  const std::string additions[] = {"\r\n", "Content-Length: 99999999999999999999\r\n",
                                   "Transfer-Encoding: chunked\r\n", "Upgrade: websocket\r\n"};
  std::mt19937 random(1);
  const auto below = [&random](std::size_t n) { return random() % n; };
  for (int i = 0; i < 1000; ++i) {
    std::string request = good;
    for (std::size_t changes = below(6); changes > 0; --changes) {
      const std::size_t at = below(request.size());
      if (below(3) == 0) request.insert(at, additions[below(4)]);
      request[at] = static_cast<char>(below(256));
    }
    const Connection connection(dashboard.port());
    ASSERT_TRUE(connection.send(request.substr(0, 1 + below(request.size()))));
  }
  EXPECT_TRUE(dashboard.process().is_running()) << dashboard.log();
  EXPECT_TRUE(dds::eventually([&] { return status_of(get(dashboard.port(), "/state")) == 200; }));
}

TEST_F(DashboardProcess, SaysInEachAnswerWhatAPageMayDo) {
  const Dashboard dashboard(folder_);
  for (const char* path : {"/", "/state", "/nowhere", "/main.js"}) {
    const std::string answer = get(dashboard.port(), path);
    EXPECT_NE(answer.find("Content-Security-Policy: default-src 'none'; script-src 'self'"),
              std::string::npos)
        << answer.substr(0, 600);
    EXPECT_EQ(answer.find("unsafe"), std::string::npos) << path;
    EXPECT_NE(answer.find("X-Content-Type-Options: nosniff"), std::string::npos);
    EXPECT_NE(answer.find("Cache-Control: no-store"), std::string::npos);
  }
}

TEST_F(DashboardProcess, ServesNoMoreConnectionsThanItIsSetTo) {
  RecordProperty("requirement", "SR-132");
  const Dashboard dashboard(folder_, "http.connections_max = 3");
  ASSERT_NE(dashboard.port(), 0) << dashboard.log();
  const Connection idle[] = {Connection(dashboard.port()), Connection(dashboard.port()),
                             Connection(dashboard.port())};
  EXPECT_TRUE(dds::eventually([&] { return get(dashboard.port(), "/").empty(); }));
  // Those who say nothing lose their place when its patience (10 s) is over.
  EXPECT_TRUE(dds::eventually([&] { return status_of(get(dashboard.port(), "/")) == 200; }));
  EXPECT_TRUE(idle[0].is_open());
}

TEST_F(DashboardProcess, DemandsATokenBeyondLoopback) {
  RecordProperty("requirement", "SR-132");
  const std::string dds = "[dds]\nallow_unsecured = true\n";
  EXPECT_EQ(check(dds), 0) << said_;
  EXPECT_EQ(check(dds + "[http]\naddress = \"0.0.0.0\"\n"), 2);
  EXPECT_NE(said_.find("a token is needed"), std::string::npos) << said_;
  const fs::path token = folder_ / "token";
  const std::string secret = "0123456789abcdef01234567";
  std::ofstream(token) << secret << "\n";
  const std::string opened = "[http]\naddress = \"0.0.0.0\"\ntoken_file = \"token\"\n";
  fs::permissions(token, fs::perms::owner_read | fs::perms::others_read);
  EXPECT_EQ(check(dds + opened), 2);
  EXPECT_NE(said_.find("others may read it"), std::string::npos) << said_;
  fs::permissions(token, fs::perms::owner_read);
  EXPECT_EQ(check(dds + opened), 0) << said_;

  const Dashboard dashboard(folder_, "http.address = \"0.0.0.0\"\nhttp.token_file = \"token\"");
  const auto port = dashboard.port();
  ASSERT_NE(port, 0) << dashboard.log();
  for (const char* path :
       {"/", "/state", "/main.js", "/nowhere", "/?token=0123456789abcdef01234568"})
    EXPECT_EQ(status_of(get(port, path)), 401) << path;
  const std::string answer = get(port, "/?token=" + secret);
  EXPECT_EQ(status_of(answer), 303);
  EXPECT_NE(answer.find("HttpOnly; SameSite=Strict"), std::string::npos) << answer;
  EXPECT_EQ(body_of(answer).find(secret), std::string::npos);
  EXPECT_EQ(status_of(get(port, "/state", "Cookie: holdfast_token=" + secret + "\r\n")), 200);
  EXPECT_EQ(dashboard.log().find(secret), std::string::npos) << "the log holds no token";
}

TEST_F(DashboardProcess, NamesEachMistakeOfItsConfiguration) {
  RecordProperty("requirement", "SR-82");
  EXPECT_EQ(check("[dds]\nallow_unsecured = true\n[http]\nports = 80\n"), 2);
  EXPECT_NE(said_.find("did you mean 'port'?"), std::string::npos) << said_;
  EXPECT_EQ(check("domain = 0\n"), 2);
  EXPECT_NE(said_.find("allow_unsecured"), std::string::npos) << said_;
  EXPECT_EQ(check("[dds]\nallow_unsecured = true\n[surfaces]\nct = \"nowhere.ply\"\n"), 2);
  EXPECT_NE(said_.find("nowhere.ply"), std::string::npos) << said_;
}

}  // namespace
}  // namespace holdfast::dashboard::testing
