// SPDX-License-Identifier: Apache-2.0
// CameraSource against the virtual camera, over the network stack.
#include "bridge/camera_source.hpp"

#include <array>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "bridge/frame_check.hpp"
#include "bridge/frame_ids.hpp"
#include "rt/core/error.hpp"
#include "tests/bridge/camera_reports.hpp"
#include "tests/sim/camera_control.hpp"
#include "tests/sim/moving_site.hpp"

namespace holdfast::bridge {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

class PrivateNetwork : public ::testing::Environment {
 public:
  void SetUp() override { sim::enter_private_network(); }
};
[[maybe_unused]] const auto* const kPrivateNetwork =
    ::testing::AddGlobalTestEnvironment(new PrivateNetwork);

using test::Sent;

// Every report, with a copy of its image if one is wanted.
class Reports : public test::Collected<CameraReport> {
 public:
  explicit Reports(bool keep_images = false) : keep_images_(keep_images) {}
  CameraSource::Callback callback() {
    return [this](const CameraReport& report) {
      CameraReport kept = report;
      kept.image = keep_images_ ? report.image.clone() : cv::Mat();
      add(std::move(kept));
    };
  }
  using Collected::await;
  std::optional<CameraReport> await(CameraEvent event, std::size_t begin = 0, int nth = 1) {
    return await([event](const CameraReport& report) { return report.event == event; }, begin, nth);
  }
  std::vector<CameraReport> frames() {
    std::vector<CameraReport> found;
    for (const CameraReport& report : all())
      if (report.event == CameraEvent::frame) found.push_back(report);
    return found;
  }

 private:
  const bool keep_images_;
};

sim::SceneParameters small_scene(int width_px = 640, int height_px = 480) {
  sim::SceneParameters scene;
  scene.width_px = width_px;
  scene.height_px = height_px;
  scene.margin_mm = 3;
  return scene;
}

CameraParameters matching(const sim::SceneParameters& scene) {
  CameraParameters parameters;
  parameters.id = "127.0.0.1";
  parameters.width_px = scene.width_px;
  parameters.height_px = scene.height_px;
  parameters.packet_size_bytes = 8192;
  parameters.frame_timeout = milliseconds(150);
  parameters.readout_delay = sim::VirtualCameraParameters{}.readout;
  return parameters;
}

class CameraSourceTest : public ::testing::Test {
 protected:
  void power_up(const sim::SceneParameters& scene = small_scene(),
                const std::string& motion = "linear:0.1") {
    site = std::make_unique<sim::MovingSite>(scene, motion, 1, true, nanoseconds(0));
    device = std::make_unique<sim::VirtualCamera>(sim::VirtualCameraParameters{}, *site,
                                                  sent.callback());
  }
  // The largest difference to the site rendered without noise at the true time, in DN.
  double largest_difference(const CameraReport& report, PixelFormat format) {
    const auto truth = sent.with_id(report.frame_id);
    if (!truth) return 1e9;
    sim::View clean;
    clean.has_noise = false;
    cv::Mat expected(report.image.size(), report.image.type());
    sim::Scene scene(site->scene().parameters());
    scene.render(site->pose_at(truth->t_mid_exposure), clean, format,
                 cv::Rect({0, 0}, report.image.size()), expected.data);
    return cv::norm(report.image, expected, cv::NORM_INF);
  }

  Sent sent;
  std::unique_ptr<sim::MovingSite> site;
  std::unique_ptr<sim::VirtualCamera> device;
};

TEST_F(CameraSourceTest, DeliversTheTruePixelsWithSuccessiveIds) {
  power_up();
  Reports reports(true);
  const CameraSource source(matching(site->scene().parameters()), reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 10));
  const auto frames = reports.frames();
  for (std::size_t i = 0; i < 10; ++i) {
    ASSERT_EQ(frames[i].image.type(), CV_8UC1);
    EXPECT_LT(largest_difference(frames[i], PixelFormat::mono8), 16);  // noise: sigma < 2.2 DN
    if (i > 0) {
      EXPECT_EQ(frames_between(frames[i - 1].frame_id, frames[i].frame_id, FrameIdWidth::bits16)
                    .has_value(),
                true);
    }
  }
  EXPECT_NE(source.description().find("HOLDFAST-SIM"), std::string::npos);
  EXPECT_GE(source.counters().frames, 10U);
}

TEST_F(CameraSourceTest, PutsMidExposureOnTheHostsClock) {
  RecordProperty("requirement", "SR-62");
  power_up();
  Reports reports;
  const CameraSource source(matching(site->scene().parameters()), reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 60));
  const auto frames = reports.frames();
  for (std::size_t i = 30; i < 60; ++i) {
    const auto truth = sent.with_id(frames[i].frame_id);
    ASSERT_TRUE(truth);
    // The offset cannot be better than the earliest arrival so far: late by that, never early.
    const nanoseconds error = frames[i].t_exposure - truth->t_mid_exposure;
    EXPECT_GT(error, -nanoseconds(100'000)) << i;
    EXPECT_LT(error, nanoseconds(8'000'000)) << i;
    EXPECT_EQ(frames[i].t_camera, truth->t_stamp);
    EXPECT_LT(frames[i].t_exposure, frames[i].t_received);
    EXPECT_GT(frames[i].t_exposure, frames[i - 1].t_exposure);
    EXPECT_GT(frames[i].clock_offset_sigma, nanoseconds(0));
  }
}

TEST_F(CameraSourceTest, ReportsLostPacketsAsIncomplete) {
  RecordProperty("requirement", "SR-60");
  power_up();
  Reports reports;
  const CameraSource source(matching(site->scene().parameters()), reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 3));
  const std::uint64_t before = source.counters().incomplete;
  device->corrupt_next(5);
  const auto incomplete = reports.await(CameraEvent::incomplete);
  ASSERT_TRUE(incomplete);
  EXPECT_TRUE(incomplete->image.empty());
  EXPECT_NE(incomplete->buffer_status, 0);
  ASSERT_TRUE(reports.await(CameraEvent::frame, reports.size(), 3));
  EXPECT_GE(source.counters().incomplete - before, 5U);
}

TEST_F(CameraSourceTest, ReportsDroppedFramesAsGapWithTheirNumber) {
  RecordProperty("requirement", "SR-60");
  power_up();
  Reports reports;
  const CameraSource source(matching(site->scene().parameters()), reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 3));
  device->drop_next(2);
  const auto gap = reports.await(CameraEvent::gap);
  ASSERT_TRUE(gap);
  EXPECT_EQ(gap->frames_missing, 2U);
  EXPECT_EQ(source.counters().missing, 2U);
}

TEST_F(CameraSourceTest, ReportsSilenceThenReturns) {
  RecordProperty("requirement", "SR-60");
  power_up();
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.disconnect_timeout = std::chrono::seconds(30);
  Reports reports;
  const CameraSource source(parameters, reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 3));
  device->drop(true);
  ASSERT_TRUE(reports.await(CameraEvent::silent, 0, 2));
  const std::size_t before = reports.size();
  device->drop(false);
  ASSERT_TRUE(reports.await(CameraEvent::gap, before));
  ASSERT_TRUE(reports.await(CameraEvent::frame, before));
  EXPECT_EQ(source.counters().disconnects, 0U);
}

TEST_F(CameraSourceTest, ReconnectsToACameraThatComesBack) {
  RecordProperty("requirement", "SR-60");
  power_up();
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.disconnect_timeout = milliseconds(300);
  Reports reports;
  const CameraSource source(parameters, reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 3));
  device->disconnect();
  ASSERT_TRUE(reports.await(CameraEvent::disconnected));
  const std::size_t before = reports.size();
  device->reconnect();
  ASSERT_TRUE(reports.await(CameraEvent::connected, before));
  ASSERT_TRUE(reports.await(CameraEvent::frame, before, 3));
  EXPECT_EQ(source.counters().disconnects, 1U);
  EXPECT_EQ(source.counters().reconnects, 1U);
}

TEST_F(CameraSourceTest, FrozenAndBlackImagesAreTold) {
  power_up();
  Reports reports(true);
  const CameraSource source(matching(site->scene().parameters()), reports.callback());
  ASSERT_TRUE(reports.await(CameraEvent::frame, 0, 3));
  const std::size_t before = reports.size();
  device->freeze(true);
  ASSERT_TRUE(reports.await(
      [this](const CameraReport& report) {
        const auto truth = sent.with_id(report.frame_id);
        return report.event == CameraEvent::frame && truth && truth->is_frozen;
      },
      before));
  FrameCheck check;
  const auto frames = reports.frames();
  safety::ReasonSet last;
  for (const CameraReport& frame : frames) {
    last = check.check(frame.image);
    const auto truth = sent.with_id(frame.frame_id);
    ASSERT_TRUE(truth);
    EXPECT_EQ(last.contains(safety::Reason::frame_frozen), truth->is_frozen);
  }
  device->freeze(false);
  device->black(true);
  const auto black = reports.await(
      [this](const CameraReport& report) {
        const auto truth = sent.with_id(report.frame_id);
        return report.event == CameraEvent::frame && truth && truth->view.is_dark &&
               !truth->is_frozen;
      },
      before);
  ASSERT_TRUE(black);
  EXPECT_TRUE(check.check(black->image).contains(safety::Reason::frame_dark));
}

/// The refusal's line names all `parts`.
void expect_refused(const CameraParameters& parameters, const std::vector<std::string>& parts) {
  try {
    const CameraSource source(parameters, [](const CameraReport&) {});
    ADD_FAILURE() << "accepted, though " << parts.front();
  } catch (const InputError& e) {
    for (const std::string& part : parts)
      EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
  }
}

TEST_F(CameraSourceTest, RefusesAWidthTheCameraDoesNotOffer) {
  power_up();
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.width_px = 3000;
  expect_refused(parameters, {"Width", "3000", "16..640"});
}

TEST_F(CameraSourceTest, RefusesExposureGainAndRateOutOfRange) {
  power_up();
  const CameraParameters good = matching(site->scene().parameters());
  CameraParameters parameters = good;
  parameters.exposure_us = 1e6;
  expect_refused(parameters, {"ExposureTime", "10..100000"});
  parameters = good;
  parameters.gain_db = 60;
  expect_refused(parameters, {"Gain", "0..24"});
  parameters = good;
  parameters.frame_rate_hz = 1000;
  expect_refused(parameters, {"AcquisitionFrameRate", "1..200"});
}

TEST_F(CameraSourceTest, RefusesACameraWithAnotherSerialNumber) {
  power_up();
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.serial = "ANOTHER";
  try {
    const CameraSource source(parameters, [](const CameraReport&) {});
    FAIL() << "accepted";
  } catch (const WrongCameraError& e) {
    EXPECT_EQ(e.found_serial, "HOLDFAST-SIM");
    EXPECT_NE(std::string(e.what()).find("ANOTHER"), std::string::npos) << e.what();
  }
}

TEST_F(CameraSourceTest, RefusesATriggerTheCameraDoesNotOffer) {
  power_up();
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.trigger_source = "Line7";
  expect_refused(parameters, {"Line7"});
}

TEST_F(CameraSourceTest, SaysWhenTheCameraIsNotThere) {
  CameraParameters parameters;
  parameters.id = "127.0.0.1";
  EXPECT_THROW(CameraSource(parameters, [](const CameraReport&) {}), UnavailableError);
  parameters.id.clear();
  parameters.serial = "NOBODY";
  EXPECT_THROW(CameraSource(parameters, [](const CameraReport&) {}), UnavailableError);
}

TEST_F(CameraSourceTest, FindsACameraBySerialNumberAndDeliversFiveMegapixels) {
  power_up(small_scene(2456, 2054), "still:1");
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.id.clear();
  parameters.serial = "HOLDFAST-SIM";
  parameters.frame_rate_hz = 5;
  parameters.frame_timeout = milliseconds(1000);
  parameters.disconnect_timeout = milliseconds(5000);
  Reports reports(true);
  const CameraSource source(parameters, reports.callback());
  const auto frame = reports.await(CameraEvent::frame);
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->image.size(), cv::Size(2456, 2054));
  EXPECT_LT(largest_difference(*frame, PixelFormat::mono8), 16);
}

class CameraSourceFormat : public CameraSourceTest,
                           public ::testing::WithParamInterface<PixelFormat> {};

TEST_P(CameraSourceFormat, ArrivesAsTheSiteLooks) {
  power_up();
  CameraParameters parameters = matching(site->scene().parameters());
  parameters.pixel_format = GetParam();
  Reports reports(true);
  const CameraSource source(parameters, reports.callback());
  const auto frame = reports.await(CameraEvent::frame, 0, 2);
  ASSERT_TRUE(frame);
  if (GetParam() == PixelFormat::mono12) {
    ASSERT_EQ(frame->image.type(), CV_16UC1);
    EXPECT_LT(largest_difference(*frame, PixelFormat::mono12), 16 * 16);
    return;
  }
  ASSERT_EQ(frame->image.type(), CV_8UC3);
  const bool is_mosaic = GetParam() != PixelFormat::rgb8 && GetParam() != PixelFormat::bgr8;
  if (!is_mosaic) {
    EXPECT_LT(largest_difference(*frame, PixelFormat::bgr8), 16);
  }
  // A wrong mosaic phase or channel order would turn bone's warm white blue.
  const cv::Scalar mean = cv::mean(frame->image);
  EXPECT_NEAR(mean[0] / mean[2], 0.74, 0.02);
  EXPECT_NEAR(mean[1] / mean[2], 0.88, 0.02);
}

INSTANTIATE_TEST_SUITE_P(Formats, CameraSourceFormat,
                         ::testing::Values(PixelFormat::mono12, PixelFormat::bayer_rg8,
                                           PixelFormat::bayer_gb8, PixelFormat::bayer_gr8,
                                           PixelFormat::bayer_bg8, PixelFormat::rgb8,
                                           PixelFormat::bgr8));

// The tools every GigE Vision user has.
std::string output_of(const std::string& command) {
  std::string output;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  if (pipe == nullptr) return output;
  std::array<char, 256> part{};
  while (fgets(part.data(), static_cast<int>(part.size()), pipe) != nullptr) output += part.data();
  pclose(pipe);
  return output;
}

TEST_F(CameraSourceTest, VirtualCameraIsSeenAndStreamedByAravisTools) {
  power_up();
  const std::string list = output_of("arv-tool-0.8");
  EXPECT_NE(list.find("Holdfast-VirtualCamera-HOLDFAST-SIM (127.0.0.1)"), std::string::npos)
      << list;
  const std::string width = output_of("arv-tool-0.8 -a 127.0.0.1 control Width");
  EXPECT_NE(width.find("Width = 640 min:16 max:640"), std::string::npos) << width;
  const std::string stream = output_of("arv-camera-test-0.8 -n 127.0.0.1 -f 30 --duration 2");
  EXPECT_NE(stream.find("n_completed_buffers"), std::string::npos) << stream;
  EXPECT_EQ(stream.find("n_completed_buffers    = 0\n"), std::string::npos) << stream;
  EXPECT_GT(device->frames(), 10U);
}

}  // namespace
}  // namespace holdfast::bridge
