// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim camera --sequence` and `stereo`: files in, the same pixels out of the camera
// source.
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <unistd.h>

#include "bridge/image_sequence.hpp"
#include "bridge/stereo_source.hpp"
#include "rt/core/error.hpp"
#include "tests/bridge/camera_reports.hpp"
#include "tests/sim/demo/child_process.hpp"

namespace holdfast::sim {
namespace {

namespace fs = std::filesystem;
using bridge::CameraEvent;
using bridge::CameraReport;
using std::chrono::milliseconds;

constexpr int kWidth = 160, kHeight = 120, kImages = 5;

/// No two images alike, no two pixels of a row.
cv::Mat numbered(int number) {
  cv::Mat image(kHeight, kWidth, CV_8UC1);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      image.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(x + 3 * y + 31 * number);
  return image;
}

class SequenceCommand : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder); }
  void TearDown() override { fs::remove_all(folder); }

  fs::path write_images(const std::string& name, const std::string& ending, int first) const {
    fs::create_directories(folder / name);
    for (int i = 0; i < kImages; ++i)
      cv::imwrite((folder / name / (std::to_string(i) + ending)).string(), numbered(first + i));
    return folder / name;
  }
  /// Tries until the simulator's cameras are there.
  template <typename Open>
  void open(ChildProcess& simulator, Open open_source) {
    const auto deadline = std::chrono::steady_clock::now() + bridge::test::kPatience;
    while (true) {
      try {
        open_source();
        return;
      } catch (const UnavailableError&) {
        ASSERT_TRUE(simulator.is_running()) << "see " << folder;
        ASSERT_LT(std::chrono::steady_clock::now(), deadline);
      }
    }
  }
  static std::vector<cv::Mat> images_of(const fs::path& path) {
    std::vector<cv::Mat> images;
    bridge::ImageSequence sequence(path.string(), 1.0);
    while (const auto frame = sequence.next()) images.push_back(frame->image);
    return images;
  }
  static std::optional<std::size_t> find(const cv::Mat& image, const std::vector<cv::Mat>& images) {
    for (std::size_t i = 0; i < images.size(); ++i)
      if (image.size() == images[i].size() && image.type() == images[i].type() &&
          cv::norm(image, images[i], cv::NORM_INF) == 0)
        return i;
    return std::nullopt;
  }
  /// Serves `path`, reads it through the camera source, and holds both together.
  void expect_served(const fs::path& path, const std::string& format,
                     bridge::PixelFormat pixel_format) {
    ChildProcess simulator(
        program_folder() / "holdfast-sim",
        {"camera", "--sequence", path.string(), "--format", format, "--fps", "20"},
        folder / "simulator.log");
    const std::vector<cv::Mat> images = images_of(path);
    ASSERT_EQ(images.size(), static_cast<std::size_t>(kImages));
    bridge::CameraParameters parameters;
    parameters.id = "127.0.0.1";
    parameters.pixel_format = pixel_format;
    parameters.width_px = kWidth;
    parameters.height_px = kHeight;
    parameters.frame_rate_hz = 20;
    bridge::test::Collected<CameraReport> seen;
    std::unique_ptr<bridge::CameraSource> source;
    open(simulator, [&] {
      source = std::make_unique<bridge::CameraSource>(parameters, [&](const CameraReport& report) {
        CameraReport kept = report;
        kept.image = report.image.clone();
        seen.add(kept);
      });
    });
    const auto is_frame = [](const CameraReport& r) { return r.event == CameraEvent::frame; };
    ASSERT_TRUE(seen.await(is_frame, 0, 3 * kImages));
    source.reset();
    std::vector<bool> was_seen(images.size(), false);
    for (const CameraReport& report : seen.all()) {
      if (!is_frame(report)) continue;
      const auto index = find(report.image, images);
      ASSERT_TRUE(index) << "frame " << report.frame_id << " is none of the images";
      was_seen[*index] = true;
    }
    EXPECT_EQ(was_seen, std::vector<bool>(images.size(), true));
    EXPECT_EQ(simulator.end(milliseconds(10'000)), 0);
  }

  const fs::path folder =
      fs::temp_directory_path() / ("holdfast-sequence-" + std::to_string(::getpid()));
};

TEST_F(SequenceCommand, ServesAFolderOfPgm) {
  expect_served(write_images("pgm", ".pgm", 0), "Mono8", bridge::PixelFormat::mono8);
}

TEST_F(SequenceCommand, ServesAFolderOfPng) {
  expect_served(write_images("png", ".png", 0), "Mono8", bridge::PixelFormat::mono8);
}

TEST_F(SequenceCommand, ServesAVideoInColour) {
  const fs::path video = folder / "video.avi";
  cv::VideoWriter writer(video.string(), cv::CAP_FFMPEG,
                         cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 25, {kWidth, kHeight}, true);
  ASSERT_TRUE(writer.isOpened());
  for (int i = 0; i < kImages; ++i)
    writer.write(cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(20 + 40 * i, 200 - 30 * i, 90)));
  writer.release();
  expect_served(video, "BGR8", bridge::PixelFormat::bgr8);
}

TEST_F(SequenceCommand, RefusesAFolderWithoutImagesInOneLine) {
  ChildProcess simulator(program_folder() / "holdfast-sim",
                         {"camera", "--sequence", folder.string()}, folder / "simulator.log");
  EXPECT_EQ(simulator.wait(milliseconds(60'000)), 2);
}

TEST_F(SequenceCommand, StereoServesPairs) {
  const std::vector<cv::Mat> left = images_of(write_images("left", ".png", 0));
  const std::vector<cv::Mat> right = images_of(write_images("right", ".png", 100));
  ChildProcess simulator(program_folder() / "holdfast-sim",
                         {"stereo", "--left", (folder / "left").string(), "--right",
                          (folder / "right").string(), "--rate", "4"},
                         folder / "simulator.log");
  bridge::StereoParameters parameters;
  for (auto* camera : {&parameters.left, &parameters.right}) {
    camera->width_px = kWidth;
    camera->height_px = kHeight;
    camera->frame_rate_hz = 4;
    camera->trigger_source = "Line1";
  }
  parameters.left.id = "127.0.0.1";
  parameters.left.serial = "LEFT";
  parameters.right.id = "127.0.0.2";
  parameters.right.serial = "RIGHT";
  parameters.skew_max = milliseconds(120);  // which images meet, not how fast
  parameters.partner_timeout = milliseconds(2000);
  struct Pair {
    cv::Mat left, right;
  };
  bridge::test::Collected<Pair> pairs;
  std::unique_ptr<bridge::StereoSource> source;
  open(simulator, [&] {
    source =
        std::make_unique<bridge::StereoSource>(parameters, [&](const bridge::StereoReport& report) {
          if (report.event == bridge::StereoEvent::pair)
            pairs.add({report.left.image.clone(), report.right.image.clone()});
        });
  });
  ASSERT_TRUE(pairs.await([](const Pair&) { return true; }, 0, kImages + 2));
  source.reset();
  for (const Pair& pair : pairs.all()) {
    const auto index = find(pair.left, left);
    ASSERT_TRUE(index);
    EXPECT_EQ(find(pair.right, right), index);
  }
  EXPECT_EQ(simulator.end(milliseconds(10'000)), 0);
}

}  // namespace
}  // namespace holdfast::sim
