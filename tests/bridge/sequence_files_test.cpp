// SPDX-License-Identifier: Apache-2.0
// The files `holdfast track` reads and writes: good ones, and every kind of bad one.
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/camera_file.hpp"
#include "bridge/depth_file.hpp"
#include "bridge/image_file.hpp"
#include "bridge/image_sequence.hpp"
#include "bridge/surface_depth.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;

class SequenceFiles : public ::testing::Test {
 protected:
  const fs::path folder = fs::path(::testing::TempDir()) /
                          ("holdfast-" + std::to_string(getpid()) +
                           ::testing::UnitTest::GetInstance()->current_test_info()->name());
  void SetUp() override { fs::create_directories(folder); }
  void TearDown() override { fs::remove_all(folder); }

  std::string path(const std::string& name) const { return (folder / name).string(); }
  static void write(const std::string& file, const std::string& text) {
    std::ofstream(file) << text;
  }
  static void truncate(const std::string& file) { fs::resize_file(file, fs::file_size(file) / 2); }
  static cv::Mat picture(int seed, int type = CV_8UC1) {
    cv::Mat image(48, 64, type);
    cv::RNG random(static_cast<std::uint64_t>(seed));
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    return image;
  }
  /// The message of the InputError that `act` throws; empty when it throws none.
  static std::string refusal(const std::function<void()>& act) {
    try {
      act();
    } catch (const InputError& e) {
      return e.what();
    }
    return {};
  }
  std::string refusal_of_sequence(std::optional<double> fps = 30) const {
    return refusal([&] {
      ImageSequence sequence(folder.string(), fps);
      while (sequence.next()) {
      }
    });
  }
};

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

TEST_F(SequenceFiles, FolderComesInNameOrderWithTheGivenRate) {
  for (const int i : {2, 0, 1}) cv::imwrite(path("f" + std::to_string(i) + ".png"), picture(i));
  write(path("notes.txt"), "not a frame");
  ImageSequence sequence(folder.string(), 50);
  EXPECT_EQ(sequence.size(), 3);
  for (int i = 0; i < 3; ++i) {
    const auto frame = sequence.next();
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->index, i);
    EXPECT_EQ(frame->t, std::chrono::milliseconds(20 * i));
    EXPECT_EQ(cv::norm(frame->image, picture(i), cv::NORM_INF), 0);
  }
  EXPECT_FALSE(sequence.next());
}

TEST_F(SequenceFiles, TimestampsAreReadAndChecked) {
  for (const int i : {0, 1}) cv::imwrite(path("f" + std::to_string(i) + ".png"), picture(i));
  const auto with = [&](const std::string& text) {
    write(path("timestamps.csv"), text);
    return refusal_of_sequence(std::nullopt);
  };
  EXPECT_EQ(with("frame,t_ns\n0,1000\n1,3000\n"), "");
  ImageSequence sequence(folder.string(), std::nullopt);
  EXPECT_EQ(sequence.time_source(), TimeSource::timestamps_file);
  EXPECT_EQ(sequence.next()->t, std::chrono::nanoseconds(1000));
  EXPECT_EQ(with("frame,t_ns\n0,1000\n1,1000\n"), "") << "repeated: a frame's fault, the tracker's";
  EXPECT_TRUE(contains(with("frame,t_ns\n0,1000\n"), "must have 2"));
  EXPECT_TRUE(contains(with("frame,t_ns\n0,10x\n1,20\n"), "line 2"));
  EXPECT_TRUE(contains(with("frame,t_ns\n1,10\n0,20\n"), "must be 0"));
}

TEST_F(SequenceFiles, BrokenOrMixedImagesAreNamed) {
  cv::imwrite(path("a.png"), picture(0));
  cv::imwrite(path("b.png"), picture(1));
  truncate(path("b.png"));
  EXPECT_TRUE(contains(refusal_of_sequence(), "b.png"));
  cv::imwrite(path("b.png"), picture(1).rowRange(0, 40));
  EXPECT_TRUE(contains(refusal_of_sequence(), "must be 64x48"));
  cv::imwrite(path("b.png"), picture(1, CV_8UC3));
  EXPECT_TRUE(contains(refusal_of_sequence(), "another type"));
  fs::remove(path("b.png"));
  cv::imwrite(path("b.jpg"), picture(1));
  truncate(path("b.jpg"));
  EXPECT_TRUE(contains(refusal_of_sequence(), "truncated"));
  write(path("b.jpg"), "");
  EXPECT_TRUE(contains(refusal_of_sequence(), "b.jpg"));
}

TEST_F(SequenceFiles, SixteenBitGreyIsScaledByTheBitsInUse) {
  cv::Mat image(48, 64, CV_16UC1, cv::Scalar(0));
  image.at<ushort>(0, 0) = 4095;
  image.at<ushort>(0, 1) = 2048;
  cv::imwrite(path("a.png"), image);
  ImageSequence sequence(folder.string(), 30);
  const auto frame = sequence.next();
  ASSERT_EQ(frame->image.type(), CV_8UC1);
  EXPECT_EQ(frame->image.at<uchar>(0, 0), 255);
  EXPECT_EQ(frame->image.at<uchar>(0, 1), 128);
}

TEST_F(SequenceFiles, VideoIsReadAndATruncatedOneRefused) {
  const std::string file = path("v.avi");
  {
    cv::VideoWriter writer(file, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 25, {64, 48});
    ASSERT_TRUE(writer.isOpened());
    for (int i = 0; i < 40; ++i) writer.write(picture(i, CV_8UC3));
  }
  ImageSequence sequence(file, std::nullopt);
  EXPECT_EQ(sequence.time_source(), TimeSource::video_rate);
  int frames = 0;
  while (sequence.next()) ++frames;
  EXPECT_EQ(frames, 40);
  truncate(file);
  EXPECT_TRUE(contains(refusal([&] {
                         ImageSequence cut(file, std::nullopt);
                         while (cut.next()) {
                         }
                       }),
                       "v.avi"));
  write(path("w.avi"), "no video at all");
  EXPECT_NE(refusal([&] { ImageSequence none(path("w.avi"), std::nullopt); }), "");
}

TEST_F(SequenceFiles, NothingThereIsRefused) {
  EXPECT_TRUE(contains(refusal_of_sequence(), "holds no"));
  EXPECT_NE(refusal([&] { ImageSequence none(path("nowhere"), 30); }), "");
  cv::imwrite(path("a.png"), picture(0));
  for (const double fps : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()})
    EXPECT_TRUE(contains(refusal_of_sequence(fps), "fps"));
}

std::string camera_yaml(const std::string& f = "600.", const std::string& size = "384",
                        const std::string& k1 = "0.1") {
  return "%YAML:1.0\n---\nimage_width: " + size +
         "\nimage_height: 288\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
         "   data: [ " +
         f +
         ", 0., 192., 0., 600., 144., 0., 0., 1. ]\n"
         "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ " +
         k1 + ", 0., 0., 0., 0. ]\n";
}

TEST_F(SequenceFiles, CameraFileIsReadAndEveryValueChecked) {
  const std::string file = path("camera.yaml");
  const auto with = [&](const std::string& text) {
    write(file, text);
    return refusal([&] { (void)read_camera_file(file); });
  };
  EXPECT_EQ(with(camera_yaml()), "");
  const auto camera = read_camera_file(file);
  EXPECT_EQ(camera.width_px, 384);
  EXPECT_EQ(camera.fy_px, 600);
  EXPECT_EQ(camera.distortion.at<double>(0), 0.1);
  EXPECT_TRUE(contains(with(camera_yaml("-600.")), "focal length"));
  EXPECT_TRUE(contains(with(camera_yaml(".Nan")), "focal length"));
  EXPECT_TRUE(contains(with(camera_yaml("600.", "0")), "image_width"));
  EXPECT_TRUE(contains(with(camera_yaml("600.", "12.5")), "whole number"));
  EXPECT_TRUE(contains(with(camera_yaml("600.", "384", "-500.")), "distortion"));
  EXPECT_TRUE(contains(with("%YAML:1.0\n---\nimage_width: 384\n"), "image_height is missing"));
  EXPECT_NE(with("{{{{ nonsense"), "");
  EXPECT_NE(with(""), "");
  EXPECT_TRUE(contains(refusal([&] { (void)read_camera_file(path("none.yaml")); }), "none.yaml"));
}

TEST_F(SequenceFiles, DepthFileKeepsItsNaNsAndRefusesOtherTypesAndSizes) {
  cv::Mat depth(48, 64, CV_32FC1, cv::Scalar(200));
  depth.at<float>(3, 4) = std::numeric_limits<float>::quiet_NaN();
  write_depth_file(path("d.tiff"), depth);
  const cv::Mat back = read_depth_file(path("d.tiff"), 64, 48);
  EXPECT_TRUE(std::isnan(back.at<float>(3, 4)));
  EXPECT_EQ(back.at<float>(0, 0), 200.0F);
  EXPECT_TRUE(contains(refusal([&] { (void)read_depth_file(path("d.tiff"), 65, 48); }), "65x48"));
  cv::imwrite(path("grey.tiff"), picture(0));
  EXPECT_TRUE(
      contains(refusal([&] { (void)read_depth_file(path("grey.tiff"), 64, 48); }), "float"));
}

TEST_F(SequenceFiles, WhatIsNoPictureIsKeptFromOpenCvsOtherDecoders) {
  std::string dicom(128, '\0');  // its library asserts on this
  dicom += "DICM\x89PNGOWA";
  dicom += std::string("\0i", 2);
  write(path("slice.png"), dicom);
  EXPECT_NE(refusal([&] { (void)read_image_file(path("slice.png")); }).find("not an image"),
            std::string::npos);
  for (const char* name : {"a.png", "a.jpg", "a.tiff", "a.bmp", "a.pgm"}) {
    cv::imwrite(path(name), picture(1));
    EXPECT_EQ(refusal([&] { (void)read_image_file(path(name)); }), "") << name;
  }
}

TEST_F(SequenceFiles, SurfaceIsDrawnInTheCameraAndTheNearestCounts) {
  perception::CameraModel camera;
  camera.width_px = 64;
  camera.height_px = 48;
  camera.fx_px = camera.fy_px = 100;
  camera.cx_px = 32;
  camera.cy_px = 24;
  const std::string head = "ply\nformat ascii 1.0\n";
  const std::string body =
      "element vertex 6\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
      "property list uchar int vertex_indices\nend_header\n"
      "-99 -99 200\n199 -99 200\n-99 199 200\n-5 -5 100\n5 -5 100\n-5 5 100\n3 0 1 2\n3 3 4 5\n";
  write(path("s.ply"), head + body);
  const cv::Mat depth = depth_from_surface_file(path("s.ply"), camera);
  EXPECT_FLOAT_EQ(depth.at<float>(22, 30), 100);
  EXPECT_FLOAT_EQ(depth.at<float>(40, 50), 200);
  // Rectified frame turned by half a turn about z: seen from the camera it is point-mirrored.
  write(path("r.ply"), head + "comment R1 -1 0 0 0 -1 0 0 0 1\n" + body);
  const cv::Mat turned = depth_from_surface_file(path("r.ply"), camera);
  EXPECT_FLOAT_EQ(turned.at<float>(26, 34), 100);
  const auto with = [&](const std::string& text) {
    write(path("b.ply"), text);
    return refusal([&] { (void)depth_from_surface_file(path("b.ply"), camera); });
  };
  EXPECT_TRUE(contains(with((head + body).substr(0, 200)), "truncated"));
  EXPECT_NE(with("solid stl"), "");
  EXPECT_NE(with(head + "element vertex 99999999999\nproperty float x\nend_header\n"), "");
  EXPECT_TRUE(contains(with(head + "comment R1 2 0 0 0 1 0 0 0 1\n" + body), "rotation"));
}

TEST_F(SequenceFiles, AtomicFileAppearsWholeOrNotAtAll) {
  const std::string file = path("out.csv");
  write(file, "old");
  {
    AtomicFile abandoned(file);
    abandoned.write("half");
  }
  std::string text;
  std::ifstream(file) >> text;
  EXPECT_EQ(text, "old");
  write_file_atomically(file, "new");
  std::ifstream(file) >> text;
  EXPECT_EQ(text, "new");
  int files = 0;
  for ([[maybe_unused]] const auto& entry : fs::directory_iterator(folder)) ++files;
  EXPECT_EQ(files, 1) << "a temporary file was left behind";
  EXPECT_TRUE(contains(refusal([&] { AtomicFile none(path("no/such/folder/x")); }), "no/such"));
  EXPECT_NE(refusal([&] { AtomicFile none(folder.string()); }), "");
}

}  // namespace
}  // namespace holdfast::bridge
