// SPDX-License-Identifier: Apache-2.0
#include "bridge/depth_file.hpp"

#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/image_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {

cv::Mat read_depth_file(const std::string& path, int width_px, int height_px) {
  cv::Mat depth = read_image_file(path);
  if (depth.type() != CV_32FC1)
    throw InputError(path + ": must hold one channel of 32-bit float depths in mm");
  if (depth.cols != width_px || depth.rows != height_px)
    throw InputError(path + ": is " + std::to_string(depth.cols) + "x" +
                     std::to_string(depth.rows) + " px, must be " + std::to_string(width_px) + "x" +
                     std::to_string(height_px) + " px as the camera");
  return depth;
}

void write_depth_file(const std::string& path, const cv::Mat& depth_mm) {
  if (depth_mm.type() != CV_32FC1 || depth_mm.empty())
    throw InputError(path + ": only a 32-bit float depth map can be written");
  std::vector<uchar> bytes;
  if (!cv::imencode(".tiff", depth_mm, bytes)) throw InputError(path + ": cannot be encoded");
  write_file_atomically(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace holdfast::bridge
