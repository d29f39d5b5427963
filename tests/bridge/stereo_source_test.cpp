// SPDX-License-Identifier: Apache-2.0
// StereoSource against two virtual cameras on one trigger line, over the network stack.
#include "bridge/stereo_source.hpp"

#include <memory>
#include <optional>
#include <string>

#include <gtest/gtest.h>

#include "tests/bridge/camera_reports.hpp"
#include "tests/sim/wire_pixels.hpp"

namespace holdfast::bridge {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr int kWidth = 320, kHeight = 200;
constexpr double kTriggerHz = 4;

/// Even grey: the number of the trigger, plus 100 in the right camera.
class Numbered : public sim::FrameSource {
 public:
  Numbered(const sim::TriggerLine& line, int offset) : line_(line), offset_(offset) {}
  [[nodiscard]] cv::Size sensor_px() const noexcept override { return {kWidth, kHeight}; }
  void render(nanoseconds t_mid, const sim::View&, PixelFormat format, const cv::Rect& region,
              std::uint8_t* pixels) override {
    const auto number = static_cast<double>(line_.number_at(t_mid));
    sim::write_wire_pixels(cv::Mat(region.size(), CV_8UC1, cv::Scalar(number + offset_)), format,
                           region.tl(), pixels);
  }

 private:
  const sim::TriggerLine& line_;
  const int offset_;
};

sim::VirtualCameraParameters device_parameters(const char* address, const char* serial,
                                               sim::TriggerLine& line) {
  sim::VirtualCameraParameters parameters;
  parameters.interface = address;
  parameters.serial = serial;
  parameters.line1 = &line;
  return parameters;
}

StereoParameters stereo_parameters() {
  StereoParameters parameters;
  const auto fill = [](CameraParameters& camera, const char* id, const char* serial) {
    camera.id = id;
    camera.serial = serial;
    camera.width_px = kWidth;
    camera.height_px = kHeight;
    camera.packet_size_bytes = 8192;
    camera.frame_rate_hz = kTriggerHz;
    camera.trigger_source = "Line1";
    camera.readout_delay = sim::VirtualCameraParameters{}.readout;
  };
  fill(parameters.left, "127.0.0.1", "LEFT");
  fill(parameters.right, "127.0.0.2", "RIGHT");
  // This machine may be starved: what is judged here is which frames meet, not how fast.
  parameters.skew_max = milliseconds(120);
  parameters.partner_timeout = milliseconds(2000);
  return parameters;
}

struct Seen {
  StereoReport report;
  bool has_images = false;
  int left_grey = -1, right_grey = -1;
  bool is_even = false;  // every pixel of both images alike
};

class StereoSourceTest : public ::testing::Test {
 protected:
  StereoSource::Callback callback() {
    return [this](const StereoReport& report) {
      Seen kept{.report = report};
      kept.report.left.image.release();
      kept.report.right.image.release();
      kept.has_images = !report.left.image.empty() && !report.right.image.empty();
      if (kept.has_images) {
        kept.left_grey = report.left.image.at<std::uint8_t>(0, 0);
        kept.right_grey = report.right.image.at<std::uint8_t>(0, 0);
        kept.is_even = cv::countNonZero(report.left.image != kept.left_grey) == 0 &&
                       cv::countNonZero(report.right.image != kept.right_grey) == 0 &&
                       report.left.image.size() == cv::Size(kWidth, kHeight);
      }
      seen.add(kept);
    };
  }
  std::optional<Seen> await(StereoEvent event, std::size_t begin = 0, int nth = 1) {
    return seen.await([event](const Seen& s) { return s.report.event == event; }, begin, nth);
  }
  std::string refusal(const StereoParameters& parameters) {
    try {
      const StereoSource source(parameters, [](const StereoReport&) {});
    } catch (const InputError& e) {
      return e.what();
    }
    return "accepted";
  }

  test::Collected<Seen> seen;
  sim::TriggerLine line;
  Numbered left_pixels{line, 0}, right_pixels{line, 100};
  sim::VirtualCamera left{device_parameters("127.0.0.1", "LEFT", line), left_pixels};
  sim::VirtualCamera right{device_parameters("127.0.0.2", "RIGHT", line), right_pixels};
};

TEST_F(StereoSourceTest, PairsAreOfOneTrigger) {
  const StereoSource source(stereo_parameters(), callback());
  const sim::TriggerGenerator generator(line, kTriggerHz);
  ASSERT_TRUE(await(StereoEvent::pair, 0, 8));
  for (const Seen& s : seen.all()) {
    ASSERT_EQ(s.has_images, s.report.event == StereoEvent::pair);
    if (!s.has_images) continue;
    EXPECT_TRUE(s.is_even);
    EXPECT_EQ(s.right_grey, s.left_grey + 100);
    EXPECT_LE(std::chrono::abs(s.report.skew), stereo_parameters().skew_max);
  }
  EXPECT_GE(source.counters().pairs, 8U);
}

TEST_F(StereoSourceTest, NothingComesWithoutATriggerAndSilenceIsNoFault) {
  StereoParameters parameters = stereo_parameters();
  for (CameraParameters* camera : {&parameters.left, &parameters.right}) {
    camera->frame_timeout = milliseconds(50);
    camera->disconnect_timeout = milliseconds(100);
  }
  const StereoSource source(parameters, callback());
  ASSERT_TRUE(await(StereoEvent::left_event));  // connected
  ASSERT_TRUE(await(StereoEvent::right_event));
  // A trigger fired longer after the disconnect time-out than it takes to be declared lost.
  sim::TriggerGenerator slow(line, 1.0);
  ASSERT_TRUE(await(StereoEvent::pair, 0, 2));
  EXPECT_EQ(source.left_counters().disconnects, 0U);
  EXPECT_EQ(source.right_counters().disconnects, 0U);
  for (const Seen& s : seen.all()) {
    EXPECT_NE(s.report.left.event, CameraEvent::silent);
    EXPECT_NE(s.report.right.event, CameraEvent::silent);
  }
}

TEST_F(StereoSourceTest, ReportsTheSideWhoseFrameIsMissing) {
  RecordProperty("requirement", "SR-60");
  const StereoSource source(stereo_parameters(), callback());
  const sim::TriggerGenerator generator(line, kTriggerHz);
  ASSERT_TRUE(await(StereoEvent::pair, 0, 2));
  left.drop_next(2);
  const auto missing = await(StereoEvent::left_missing, 0, 2);
  ASSERT_TRUE(missing);
  EXPECT_FALSE(missing->has_images);
  EXPECT_NE(missing->report.right.frame_id, 0U);
  const auto gap = seen.await([](const Seen& s) {
    return s.report.event == StereoEvent::left_event && s.report.left.event == CameraEvent::gap;
  });
  ASSERT_TRUE(gap);
  EXPECT_EQ(gap->report.left.frames_missing, 2U);
  const std::size_t before = seen.size();
  ASSERT_TRUE(await(StereoEvent::pair, before, 2));
  for (const Seen& s : seen.all()) {
    if (!s.has_images) continue;
    EXPECT_EQ(s.right_grey, s.left_grey + 100);
  }
}

TEST_F(StereoSourceTest, ReportsASideThatIsGone) {
  RecordProperty("requirement", "SR-60");
  const StereoSource source(stereo_parameters(), callback());
  const sim::TriggerGenerator generator(line, kTriggerHz);
  ASSERT_TRUE(await(StereoEvent::pair));
  right.disconnect();
  ASSERT_TRUE(await(StereoEvent::right_missing, seen.size(), 2));
  right.reconnect();
  const std::size_t before = seen.size();
  ASSERT_TRUE(await(StereoEvent::pair, before, 2));
}

TEST_F(StereoSourceTest, FramesOfOneTriggerTooFarApartAreNoPair) {
  StereoParameters parameters = stereo_parameters();
  parameters.skew_max = milliseconds(5);
  parameters.right.exposure_us = 100'000;  // its middle lies 47.5 ms after the left one's
  const StereoSource source(parameters, callback());
  const sim::TriggerGenerator generator(line, kTriggerHz);
  const auto skewed = await(StereoEvent::skewed, 0, 3);
  ASSERT_TRUE(skewed);
  EXPECT_LT(skewed->report.skew, -milliseconds(5));
  EXPECT_FALSE(skewed->has_images);
}

TEST_F(StereoSourceTest, RefusesSwappedCameras) {
  StereoParameters parameters = stereo_parameters();
  std::swap(parameters.left.serial, parameters.right.serial);
  const std::string line_of_error = refusal(parameters);
  EXPECT_NE(line_of_error.find("swapped"), std::string::npos) << line_of_error;
  parameters = stereo_parameters();
  parameters.left.serial = "OTHER";
  const std::string other = refusal(parameters);
  EXPECT_NE(other.find("left"), std::string::npos) << other;
  EXPECT_EQ(other.find("swapped"), std::string::npos) << other;
}

TEST_F(StereoSourceTest, RefusesParametersThatContradict) {
  const auto expect = [&](const char* part, const std::function<void(StereoParameters&)>& spoil) {
    StereoParameters parameters = stereo_parameters();
    spoil(parameters);
    const std::string line_of_error = refusal(parameters);
    EXPECT_NE(line_of_error.find(part), std::string::npos) << line_of_error;
  };
  expect("same id", [](auto& p) { p.right.id = p.left.id; });
  expect("same serial", [](auto& p) { p.right.serial = p.left.serial; });
  expect("id or a serial", [](auto& p) { p.left.id = p.left.serial = ""; });
  expect("size", [](auto& p) { p.right.width_px = 64; });
  expect("trigger_source", [](auto& p) { p.right.trigger_source.clear(); });
  expect("rate", [](auto& p) { p.right.frame_rate_hz = 5; });
  expect("skew_max", [](auto& p) { p.skew_max = milliseconds(125); });
  expect("pairs", [](auto& p) { p.pairs = 0; });
}

}  // namespace
}  // namespace holdfast::bridge
