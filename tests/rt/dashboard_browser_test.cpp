// SPDX-License-Identifier: Apache-2.0
// The dashboard's page in Debian's Chromium: what a person sees while daemon and guard come and go.
#include <csignal>

#include <Eigen/Geometry>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "registration/mesh_file.hpp"
#include "tests/rt/dashboard_room.hpp"

namespace holdfast::dashboard::testing {
namespace {

using nlohmann::json;

/// browser.cjs, a line of words in, a line of JSON out.
class Browser {
 public:
  Browser() {
    int pair[2] = {-1, -1};
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) return;
    pid_ = fork();
    if (pid_ == 0) {
      dup2(pair[1], STDIN_FILENO);
      dup2(pair[1], STDOUT_FILENO);
      setenv("NODE_PATH", HOLDFAST_NODE_MODULES, 1);
      execlp("node", "node", HOLDFAST_BROWSER_SCRIPT, nullptr);
      _exit(127);
    }
    close(pair[1]);
    socket_ = pair[0];
  }
  ~Browser() {
    close(socket_);  // the end of its input: it closes Chromium and ends
    waitpid(pid_, nullptr, 0);
  }
  Browser(const Browser&) = delete;
  Browser& operator=(const Browser&) = delete;

  json operator()(const std::string& line) {
    const std::string out = line + "\n";
    std::string answer;
    if (::send(socket_, out.data(), out.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(out.size()))
      return {{"error", "the browser's script has ended; ./dev setup installs what it needs"}};
    for (char c = 0; recv(socket_, &c, 1, 0) == 1 && c != '\n';) answer += c;
    json parsed = json::parse(answer, nullptr, false);
    return parsed.is_object() ? parsed : json{{"error", "no answer to: " + line}};
  }

 private:
  pid_t pid_ = -1;
  int socket_ = -1;
};

class DashboardPage : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }

  /// True when what a person sees becomes so; the newest look is kept in seen_.
  bool sees(const std::string& word, const std::string& level) {
    return dds::eventually([&] {
      seen_ = browser_("look");
      return seen_.value("word", "") == word &&
             (seen_["is_covered"] == true || seen_["level"] == level);
    });
  }

  const std::uint32_t domain_ = dds::test_domain();
  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-page-" + std::to_string(::getpid()));
  dds::Participant participant_{{.domain = domain_, .configuration = {}}};
  Browser browser_;
  json seen_;
};

TEST_F(DashboardPage, ShowsColourWordAndReasonAndSilenceAsStop) {
  RecordProperty("requirement", "SR-130");
  Dashboard dashboard(folder_);
  const json opened = browser_("open " + dashboard.url() + " 1366 768");
  ASSERT_EQ(opened.value("status", 0), 200) << opened;
  EXPECT_TRUE(sees("STOP: NO DATA", "no_data")) << seen_;
  PlayedRoom room(participant_);
  ASSERT_TRUE(sees("PERMITTED", "permitted")) << seen_;
  EXPECT_EQ(seen_["ground"], "rgb(11, 93, 30)");
  EXPECT_EQ(seen_["title"], "PERMITTED – Holdfast");
  room.cause = safety::Reason::frame_late;
  ASSERT_TRUE(sees("HOLD", "hold")) << seen_;
  EXPECT_EQ(seen_["ground"], "rgb(242, 185, 13)");
  EXPECT_NE(seen_["reason"].get<std::string>().find("overdue (frame_late)"), std::string::npos);
  room.cause = safety::Reason::drift_exceeded;
  ASSERT_TRUE(sees("STOP", "stop")) << seen_;
  EXPECT_EQ(seen_["ground"], "rgb(163, 8, 26)");
  room.cause = safety::Reason::none;
  ASSERT_TRUE(sees("PERMITTED", "permitted")) << seen_;
  EXPECT_TRUE(dds::eventually([&] {  // the history is asked for once a second
    const std::string stops = browser_("look").value("stops", "");
    return stops.find("drift_exceeded") != std::string::npos &&
           stops.find("frame_late") != std::string::npos;
  }));

  room.is_silent = true;  // the daemon ends ...
  ASSERT_TRUE(sees("STOP: NO DATA", "no_data")) << seen_;
  room.is_silent = false;  // ... and returns
  ASSERT_TRUE(sees("PERMITTED", "permitted")) << seen_;
  kill(dashboard.process().pid(), SIGSTOP);  // the dashboard hangs ...
  ASSERT_TRUE(sees("STOP: NO DATA", "permitted")) << seen_;
  EXPECT_EQ(seen_["is_covered"], true);
  EXPECT_TRUE(dds::eventually([&] {  // also for a screen reader
    seen_ = browser_("look");
    return seen_["heard"] == "STOP: NO DATA" && seen_["title"] == "STOP: NO DATA – Holdfast";
  })) << seen_;
  kill(dashboard.process().pid(), SIGCONT);
  ASSERT_TRUE(sees("PERMITTED", "permitted")) << seen_;
  dashboard.process().kill_now();  // ... and ends
  ASSERT_TRUE(sees("STOP: NO DATA", "no_data")) << seen_;
}

TEST_F(DashboardPage, CoversItselfWhileItsScriptHangs) {
  RecordProperty("requirement", "SR-130");
  const Dashboard dashboard(folder_);
  PlayedRoom room(participant_);
  ASSERT_EQ(browser_("open " + dashboard.url() + " 1366 768").value("status", 0), 200);
  ASSERT_TRUE(sees("PERMITTED", "permitted")) << seen_;
  const json hung = browser_("hang 6000");  // nothing of the page's script runs meanwhile
  ASSERT_TRUE(hung.contains("colours")) << hung;
  ASSERT_FALSE(hung["colours"].empty()) << "no picture was composed";
  const json last = hung["colours"].back();
  EXPECT_GT(last[0], 120) << hung;  // red
  EXPECT_LT(last[1], 60) << hung;
  EXPECT_TRUE(sees("PERMITTED", "permitted")) << seen_;
}

TEST_F(DashboardPage, FitsReadsWellAndKeepsToItsPolicy) {
  const Dashboard dashboard(folder_);
  PlayedRoom room(participant_);
  ASSERT_EQ(browser_("open " + dashboard.url() + " 1366 768").value("status", 0), 200);
  for (const auto cause :
       {safety::Reason::none, safety::Reason::frame_late, safety::Reason::drift_exceeded}) {
    room.cause = cause;
    const bool is_permitted = cause == safety::Reason::none;
    const bool is_hold = cause == safety::Reason::frame_late;
    ASSERT_TRUE(sees(is_permitted ? "PERMITTED"
                     : is_hold    ? "HOLD"
                                  : "STOP",
                     is_permitted ? "permitted"
                     : is_hold    ? "hold"
                                  : "stop"))
        << seen_;
    const json fit = browser_("overflow");
    EXPECT_EQ(fit["right"], 0) << fit;
    EXPECT_EQ(fit["below"], 0) << fit;
    EXPECT_TRUE(fit["cut"].empty()) << fit;
    const json axe = browser_("axe");
    EXPECT_EQ(axe["violations"], json::array()) << safety::name(cause);
    const auto passes = axe["passes"].get<std::vector<std::string>>();
    EXPECT_NE(std::find(passes.begin(), passes.end(), "color-contrast"), passes.end()) << axe;
  }
  if (const char* file = std::getenv("HOLDFAST_PICTURE")) browser_(std::string("picture ") + file);
  EXPECT_EQ(browser_("problems")["problems"], json::array());
  ASSERT_EQ(browser_("open " + dashboard.url() + " 640 900").value("status", 0), 200);
  EXPECT_EQ(browser_("overflow")["right"], 0) << "a narrow window scrolls down only";
}

TEST_F(DashboardPage, ShowsTheLivePictureAndNeverAnOldOne) {
  RecordProperty("requirement", "SR-146");
  const fs::path file = folder_ / "live_view";
  Dashboard dashboard(folder_, "", {"--live-view", file});
  ASSERT_EQ(browser_("open " + dashboard.url() + " 1366 768").value("status", 0), 200);
  // Two canvas pixels a pixel: dark, light, masked, inlier, on the motion's line.
  const auto sees_live = [&](bool is_there, const std::string& note) {
    return dds::eventually([&] {
      seen_ = browser_("live 100,300 600,300 20,20 481,181 321,221");
      if (!seen_.contains("colours")) return false;
      const auto is_red = [&](std::size_t place, int low, int high) {
        const int red = seen_["colours"][place][0];
        return red >= low && red <= high && seen_["colours"][place][3] == 255;
      };
      const bool is_drawn = is_red(0, 35, 45) && is_red(1, 195, 205);
      const bool is_blank = seen_["colours"][0][3] == 0 && seen_["colours"][1][3] == 0;
      return seen_["is_covered"] == !is_there && (is_there ? is_drawn : is_blank) &&
             seen_["note"].get<std::string>().find(note) != std::string::npos;
    });
  };
  EXPECT_TRUE(sees_live(false, "no live picture: the daemon writes none")) << seen_;
  {
    PlayedCamera camera(file);
    ASSERT_TRUE(sees_live(true, "ms old; tracking")) << seen_;
    EXPECT_EQ(seen_["width"], 640);
    const auto colours = seen_["colours"].get<std::vector<std::vector<int>>>();
    EXPECT_GT(colours[2][0], colours[2][1] + 60) << "masked is pink";
    EXPECT_EQ(colours[3], (std::vector<int>{124, 227, 139, 255})) << "an inlier";
    EXPECT_EQ(colours[4], (std::vector<int>{255, 209, 102, 255})) << "the motion";
    browser_("click live-overlay");
    EXPECT_TRUE(dds::eventually([&] {
      seen_ = browser_("live 20,20 481,181");
      return seen_["colours"][0][0] < 45 && seen_["colours"][1][0] == seen_["colours"][1][1];
    })) << seen_;
    camera.is_stuck = true;  // its process lives, and its file is there
    ASSERT_TRUE(sees_live(false, "no live picture since")) << seen_;
    EXPECT_NE(seen_["note"].get<std::string>().find("no new frame comes"), std::string::npos);
    camera.is_stuck = false;
    ASSERT_TRUE(sees_live(true, "ms old")) << seen_;
    kill(dashboard.process().pid(), SIGSTOP);
    ASSERT_TRUE(sees_live(false, "no live picture")) << seen_;
    kill(dashboard.process().pid(), SIGCONT);
    ASSERT_TRUE(sees_live(true, "ms old")) << seen_;
    if (const char* picture = std::getenv("HOLDFAST_PICTURE")) {
      browser_("click live-overlay");
      browser_(std::string("picture ") + picture + ".live.png");
    }
  }  // the daemon ends
  EXPECT_TRUE(sees_live(false, "no live picture since")) << seen_;
  EXPECT_EQ(browser_("problems")["problems"], json::array());
}

TEST_F(DashboardPage, LivePictureEndsWhileThePagesScriptHangs) {
  RecordProperty("requirement", "SR-146");
  const Dashboard dashboard(folder_, "", {"--live-view", folder_ / "live_view"});
  const PlayedCamera camera(folder_ / "live_view");
  ASSERT_EQ(browser_("open " + dashboard.url() + " 1366 768").value("status", 0), 200);
  ASSERT_TRUE(dds::eventually([&] {
    seen_ = browser_("live");
    return seen_["is_covered"] == false;
  })) << seen_;
  const json hung = browser_("hang 6000 0.5 0.25");  // nothing of the page's script runs meanwhile
  ASSERT_TRUE(hung.contains("colours") && !hung["colours"].empty()) << hung;
  const json last = hung["colours"].back();
  EXPECT_LT(last[0], 30) << "the cover's ground, not a picture's grey: " << hung;
}

TEST_F(DashboardPage, DrawsSurfacesAndTheirDistance) {
  registration::TriangleMesh mire;
  for (int i = 0; i < 400; ++i)
    mire.vertices_mm.push_back(
        Eigen::Vector3d(i % 20, i / 20, 200 + 0.1 * (i * 7 % 5)).cast<float>());
  for (std::uint32_t i = 0; i < 379; ++i)
    if (i % 20 != 19) mire.triangles.push_back({i, i + 1, i + 20});
  const fs::path file = folder_ / "mire.ply";
  std::ofstream(file, std::ios::binary) << registration::ply_bytes(mire);
  const Dashboard dashboard(folder_, "", {"--reconstruction", file});
  ASSERT_EQ(browser_("open " + dashboard.url() + " 1366 768").value("status", 0), 200)
      << dashboard.log();
  EXPECT_TRUE(dds::eventually([&] {
    seen_ = browser_("look");
    return seen_["drawn"] == 1;
  })) << seen_;
  EXPECT_NE(seen_["surfaces_note"].get<std::string>().find("reconstruction"), std::string::npos);
  EXPECT_EQ(seen_["is_plotted"], 3);
  if (const char* picture = std::getenv("HOLDFAST_PICTURE"))
    browser_(std::string("picture ") + picture + ".surfaces.png");
  EXPECT_EQ(browser_("problems")["problems"], json::array());
}

TEST_F(DashboardPage, OpensWithATokenAndNotWithoutOne) {
  RecordProperty("requirement", "SR-132");
  const std::string secret = "0123456789abcdef01234567";
  std::ofstream(folder_ / "token") << secret << "\n";
  fs::permissions(folder_ / "token", fs::perms::owner_read | fs::perms::owner_write);
  const Dashboard dashboard(folder_, "http.token_file = \"token\"");
  EXPECT_EQ(browser_("open " + dashboard.url() + " 1366 768").value("status", 0), 401);
  const json opened = browser_("open " + dashboard.url() + "?token=" + secret + " 1366 768");
  EXPECT_EQ(opened.value("status", 0), 200) << opened;
  EXPECT_EQ(opened["url"], dashboard.url()) << "the token does not stay in the address";
  PlayedRoom room(participant_);
  EXPECT_TRUE(sees("PERMITTED", "permitted")) << seen_;
}

}  // namespace
}  // namespace holdfast::dashboard::testing
