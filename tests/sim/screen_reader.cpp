// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/screen_reader.hpp"

#include <X11/Xlib.h>
#include <X11/Xutil.h>
#include <fmt/core.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {

struct ScreenReader::Impl {
  std::string name;
  ::Display* display = nullptr;
};

ScreenReader::ScreenReader(const std::string& display) : impl_(std::make_unique<Impl>()) {
  impl_->name = display;
  impl_->display = XOpenDisplay(display.c_str());
  if (impl_->display == nullptr)
    throw UnavailableError(fmt::format("screen {}: cannot be opened", display));
}

ScreenReader::~ScreenReader() {
  XCloseDisplay(impl_->display);
}

cv::Mat ScreenReader::read() {
  ::Display* display = impl_->display;
  XWindowAttributes root{};
  XGetWindowAttributes(display, XDefaultRootWindow(display), &root);
  XImage* image =
      XGetImage(display, XDefaultRootWindow(display), 0, 0, static_cast<unsigned>(root.width),
                static_cast<unsigned>(root.height), AllPlanes, ZPixmap);
  if (image == nullptr || image->bits_per_pixel != 32 || image->byte_order != LSBFirst) {
    if (image != nullptr) XDestroyImage(image);
    throw UnavailableError(fmt::format("screen {}: needs 24-bit colour", impl_->name));
  }
  const cv::Mat view(image->height, image->width, CV_8UC4, image->data,
                     static_cast<std::size_t>(image->bytes_per_line));
  cv::Mat bgr(view.size(), CV_8UC3);
  const int from_to[] = {0, 0, 1, 1, 2, 2};
  cv::mixChannels(&view, 1, &bgr, 1, from_to, 3);
  XDestroyImage(image);
  return bgr;
}

}  // namespace holdfast::sim
