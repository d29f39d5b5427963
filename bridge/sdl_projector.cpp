// SPDX-License-Identifier: Apache-2.0
#include "bridge/sdl_projector.hpp"

#include <algorithm>
#include <cstring>

#include <SDL2/SDL.h>
#include <fmt/core.h>

#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

/// SDL's video part, for as long as this lives.
class Video {
 public:
  Video() {
    SDL_SetHint(SDL_HINT_VIDEO_ALLOW_SCREENSAVER, "0");
    SDL_SetHint(SDL_HINT_VIDEO_MINIMIZE_ON_FOCUS_LOSS, "0");
    SDL_SetHint(SDL_HINT_NO_SIGNAL_HANDLERS, "1");  // signals are the command line's
    if (SDL_InitSubSystem(SDL_INIT_VIDEO) != 0)
      throw UnavailableError(fmt::format("projector: no graphical session: {}", SDL_GetError()));
  }
  ~Video() { SDL_QuitSubSystem(SDL_INIT_VIDEO); }
  Video(const Video&) = delete;
  Video& operator=(const Video&) = delete;

  [[nodiscard]] std::vector<Display> displays() const {
    std::vector<Display> found;
    for (int i = 0; i < SDL_GetNumVideoDisplays(); ++i) {
      SDL_Rect area{};
      const char* name = SDL_GetDisplayName(i);
      if (SDL_GetDisplayBounds(i, &area) == 0)
        found.push_back({i, name != nullptr ? name : "", {area.x, area.y, area.w, area.h}});
    }
    return found;
  }
};

Display chosen(const std::vector<Display>& displays, int index) {
  std::string there;
  for (const Display& display : displays) {
    if (display.index == index) return display;
    there += fmt::format("{}{} ({}, {}x{} px)", there.empty() ? "" : ", ", display.index,
                         display.name, display.area_px.width, display.area_px.height);
  }
  throw UnavailableError(fmt::format("projector: no display {}; there: {}", index, there));
}

struct DestroyWindow {
  void operator()(SDL_Window* window) const noexcept { SDL_DestroyWindow(window); }
};

}  // namespace

std::vector<Display> list_displays() {
  const Video video;
  return video.displays();
}

struct SdlProjector::Impl {
  explicit Impl(const SdlProjectorParameters& given)
      : parameters(given), display(chosen(video.displays(), given.display)) {
    const cv::Rect& area = display.area_px;
    // Not SDL's full screen: without a window manager it would wait for one, with one it may scale.
    window.reset(SDL_CreateWindow(
        "Holdfast pattern", area.x, area.y, area.width, area.height,
        SDL_WINDOW_BORDERLESS | SDL_WINDOW_ALWAYS_ON_TOP | SDL_WINDOW_SKIP_TASKBAR));
    if (!window)
      throw UnavailableError(
          fmt::format("projector: no window on display {}: {}", display.index, SDL_GetError()));
    SDL_ShowCursor(SDL_DISABLE);
    image = cv::Mat::zeros(area.size(), CV_8UC1);
    state.is_on = true;  // what the display showed before, until it is covered
    change(false);
  }

  void draw() {
    const std::uint32_t flags = SDL_GetWindowFlags(window.get());
    const bool is_seen = (flags & SDL_WINDOW_SHOWN) != 0 && (flags & SDL_WINDOW_MINIMIZED) == 0;
    SDL_Surface* surface = is_seen ? SDL_GetWindowSurface(window.get()) : nullptr;
    const bool is_drawable = surface != nullptr && surface->w == image.cols &&
                             surface->h == image.rows && surface->format->BytesPerPixel == 4;
    if (!is_drawable)
      throw UnavailableError(
          fmt::format("projector: display {} cannot be drawn on, or has changed", display.index));
    SDL_LockSurface(surface);
    for (int y = 0; y < image.rows; ++y) {
      const std::uint8_t* from = image.ptr(y);
      auto* to = static_cast<std::uint8_t*>(surface->pixels) +
                 static_cast<std::ptrdiff_t>(y) * surface->pitch;
      for (int x = 0; x < image.cols; ++x, to += 4) {
        const std::uint32_t pixel = SDL_MapRGB(surface->format, from[x], from[x], from[x]);
        std::memcpy(to, &pixel, sizeof pixel);
      }
    }
    SDL_UnlockSurface(surface);
    if (SDL_UpdateWindowSurface(window.get()) != 0)
      throw UnavailableError(fmt::format("projector: {}", SDL_GetError()));
  }

  /// It may be lit from now on.
  void light() {
    state.is_on = true;
    state.t_dark_until = std::min(state.t_dark_until, rt::monotonic_now());
  }

  /// Shows `image`; whatever fails, it may be lit.
  void change(bool on) {
    const ProjectorState before = state;
    light();
    draw();
    if (on) return;
    if (before.is_on)
      state = {false, rt::monotonic_now() + parameters.settling, std::chrono::nanoseconds::max()};
    else
      state = before;  // black over black
  }

  /// Draws what the window system has lost.
  void redraw() {
    const ProjectorState before = state;
    light();
    draw();
    state = before;
  }

  const SdlProjectorParameters parameters;
  Video video;
  const Display display;
  std::unique_ptr<SDL_Window, DestroyWindow> window;
  cv::Mat image;  // what is shown
  ProjectorState state;
};

SdlProjector::SdlProjector(const SdlProjectorParameters& parameters)
    : impl_(std::make_unique<Impl>(parameters)) {
  service();
}
SdlProjector::~SdlProjector() = default;

void SdlProjector::show(const cv::Mat& pattern) {
  const cv::Size size = size_px();
  if (pattern.type() != CV_8UC1 || pattern.size() != size)
    throw InputError(
        fmt::format("projector: the pattern is {}x{} px{}, display {} needs {}x{} px of 8-bit grey",
                    pattern.cols, pattern.rows, pattern.type() == CV_8UC1 ? "" : " not 8-bit grey",
                    impl_->display.index, size.width, size.height));
  pattern.copyTo(impl_->image);
  impl_->change(true);
}

void SdlProjector::off() {
  impl_->image.setTo(0);
  impl_->change(false);
}

ProjectorState SdlProjector::state() const noexcept {
  return impl_->state;
}
cv::Size SdlProjector::size_px() const noexcept {
  return impl_->display.area_px.size();
}

void SdlProjector::service() {
  SDL_Event event;
  bool is_touched = false;
  while (SDL_PollEvent(&event) != 0) is_touched = is_touched || event.type == SDL_WINDOWEVENT;
  if (is_touched) impl_->redraw();
}

}  // namespace holdfast::bridge
