// SPDX-License-Identifier: Apache-2.0
// The projector's window on a virtual X screen: what the screen shows is what the pattern says.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <random>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <unistd.h>

#include "bridge/sdl_projector.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/demo/child_process.hpp"
#include "tests/sim/screen_reader.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr std::chrono::seconds kPatience{60};  // reached only when the test fails
const cv::Size kScreen{800, 600};

template <typename Predicate>
bool eventually(Predicate is_so) {
  const auto deadline = std::chrono::steady_clock::now() + kPatience;
  while (!is_so()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(milliseconds(10));  // a poll, bounded by the deadline
  }
  return true;
}

cv::Mat random_pattern(int seed) {
  cv::Mat pattern(kScreen, CV_8UC1);
  cv::RNG random(static_cast<std::uint64_t>(seed));
  random.fill(pattern, cv::RNG::UNIFORM, 0, 256);
  return pattern;
}

/// All three channels of the screen are the pattern, every pixel.
bool is_shown(const cv::Mat& screen, const cv::Mat& pattern) {
  const cv::Mat channels[] = {pattern, pattern, pattern};
  cv::Mat expected;
  cv::merge(channels, 3, expected);
  return screen.size() == expected.size() && cv::norm(screen, expected, cv::NORM_INF) == 0;
}

class ProjectorWindow : public ::testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(folder);
    server.emplace("/usr/bin/Xvfb",
                   std::vector<std::string>{"-displayfd", "1", "-screen", "0", "800x600x24", "-wr",
                                            "-nolisten", "tcp"},
                   folder / "xvfb.log");
    ASSERT_TRUE(eventually([this] {
      std::ifstream log(folder / "xvfb.log");
      return static_cast<bool>(std::getline(log, number)) && !log.eof();
    }));
    setenv("DISPLAY", (":" + number).c_str(), 1);
    setenv("SDL_VIDEODRIVER", "x11", 1);
    screen.emplace(":" + number);
  }
  void TearDown() override {
    screen.reset();
    server.reset();
    fs::remove_all(folder);
  }

  const fs::path folder =
      fs::temp_directory_path() / ("holdfast-projector-" + std::to_string(::getpid()));
  std::optional<sim::ChildProcess> server;
  std::string number;
  std::optional<sim::ScreenReader> screen;
};

TEST_F(ProjectorWindow, ShowsThePatternPixelForPixelAndBlackWhenOff) {
  SdlProjector projector({.display = 0});
  EXPECT_EQ(projector.size_px(), kScreen);
  for (const int seed : {1, 2}) {
    const cv::Mat pattern = random_pattern(seed);
    projector.show(pattern);
    EXPECT_TRUE(projector.state().is_on);
    EXPECT_TRUE(eventually([&] {
      projector.service();
      return is_shown(screen->read(), pattern);
    }));
  }
  projector.off();
  EXPECT_FALSE(projector.state().is_on);
  EXPECT_TRUE(eventually([&] {
    projector.service();
    return cv::countNonZero(screen->read().reshape(1)) == 0;
  }));
}

TEST_F(ProjectorWindow, RefusesAPatternOfAnotherSizeAndKeepsTheOldOne) {
  SdlProjector projector({.display = 0});
  const cv::Mat pattern = random_pattern(6);
  projector.show(pattern);
  EXPECT_THROW(projector.show(cv::Mat::zeros(480, 640, CV_8UC1)), InputError);
  EXPECT_THROW(projector.show(cv::Mat::zeros(kScreen, CV_8UC3)), InputError);
  EXPECT_TRUE(projector.state().is_on);
  EXPECT_TRUE(eventually([&] {
    projector.service();
    return is_shown(screen->read(), pattern);
  }));
}

TEST_F(ProjectorWindow, NamesTheDisplaysWhenTheOneAskedForIsNotThere) {
  try {
    const SdlProjector projector({.display = 3});
    FAIL() << "accepted";
  } catch (const UnavailableError& e) {
    EXPECT_NE(std::string(e.what()).find("800x600"), std::string::npos) << e.what();
  }
}

TEST_F(ProjectorWindow, CommandShowsAnImageFileUntilInterrupted) {
  const cv::Mat pattern = random_pattern(3);
  const fs::path file = folder / "pattern.png";
  ASSERT_TRUE(cv::imwrite(file.string(), pattern));
  sim::ChildProcess command(sim::program_folder() / "holdfast",
                            {"project", "--pattern", file.string(), "--display", "0"},
                            folder / "command.log");
  EXPECT_TRUE(eventually([&] { return is_shown(screen->read(), pattern); }));
  EXPECT_EQ(command.end(kPatience), 0);
  EXPECT_FALSE(is_shown(screen->read(), pattern));
}

TEST_F(ProjectorWindow, KnowsWhenItWasSurelyDark) {
  SdlProjector projector({.display = 0, .settling = milliseconds(100)});
  const ProjectorState first = projector.state();
  EXPECT_FALSE(may_be_lit(first, first.t_dark_from, first.t_dark_from + milliseconds(1)));
  projector.off();  // black over black: as dark as before
  EXPECT_EQ(projector.state().t_dark_from, first.t_dark_from);

  const nanoseconds t_on = rt::monotonic_now();
  projector.show(random_pattern(4));
  projector.show(random_pattern(5));
  const ProjectorState on = projector.state();
  EXPECT_TRUE(may_be_lit(on, t_on, rt::monotonic_now()));  // the first pattern's light, too
  EXPECT_GE(on.t_dark_until, t_on);

  const nanoseconds t_off = rt::monotonic_now();
  projector.off();
  EXPECT_GE(projector.state().t_dark_from, t_off + milliseconds(100));
  EXPECT_TRUE(may_be_lit(projector.state(), t_off, t_off + milliseconds(99)));
}

TEST(ProjectorState, TellsWhichExposuresMayShowThePattern) {
  constexpr nanoseconds kFrom(100), kUntil(150);
  const ProjectorState state{true, kFrom, kUntil};
  EXPECT_TRUE(may_be_lit({}, nanoseconds(0), nanoseconds(1)));
  EXPECT_TRUE(may_be_lit(state, nanoseconds(99), nanoseconds(120)));
  EXPECT_FALSE(may_be_lit(state, kFrom, nanoseconds(149)));
  EXPECT_TRUE(may_be_lit(state, nanoseconds(120), kUntil));
  EXPECT_TRUE(may_be_lit(state, nanoseconds(90), nanoseconds(160)));
}

}  // namespace
}  // namespace holdfast::bridge
