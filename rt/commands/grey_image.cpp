// SPDX-License-Identifier: Apache-2.0
#include "rt/commands/grey_image.hpp"

#include <algorithm>

#include <opencv2/imgproc.hpp>

#include "bridge/image_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {

cv::Mat read_grey_image(const std::string& path) {
  cv::Mat image = bridge::read_image_file(path);
  if (image.channels() == 3) cv::cvtColor(image, image, cv::COLOR_BGR2GRAY);
  if (image.channels() != 1 || (image.depth() != CV_8U && image.depth() != CV_16U))
    throw InputError(path + ": must be grey or colour, 8 or 16 bit");
  if (image.depth() == CV_8U) return image;
  double brightest = 0;
  cv::minMaxLoc(image, nullptr, &brightest);
  cv::Mat grey;
  image.convertTo(grey, CV_8U, 255 / std::max(brightest, 1.0));
  return grey;
}

}  // namespace holdfast::rt
