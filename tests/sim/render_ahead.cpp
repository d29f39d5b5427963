// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/render_ahead.hpp"

#include <utility>

#include "bridge/pixel_conversion.hpp"

namespace holdfast::sim {

bool Shot::is_nearly(const Shot& other) const noexcept {
  const auto apart = std::chrono::abs(t_mid_exposure - other.t_mid_exposure);
  return apart < std::chrono::microseconds(100) && view.is_occluded == other.view.is_occluded &&
         view.is_dark == other.view.is_dark && view.has_noise == other.view.has_noise &&
         format == other.format && region == other.region && source_version == other.source_version;
}

std::size_t Shot::bytes() const noexcept {
  return bridge::row_bytes(format, region.width) * static_cast<std::size_t>(region.height);
}

RenderAhead::RenderAhead(FrameSource& source) : source_(source), thread_([this] { run(); }) {}

RenderAhead::~RenderAhead() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void RenderAhead::prepare(const Shot& shot) {
  {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return state_ != State::rendering; });
    shot_ = shot;
    state_ = State::wanted;
  }
  changed_.notify_all();
}

const std::vector<std::uint8_t>& RenderAhead::take(Shot& shot) {
  std::unique_lock lock(mutex_);
  if (state_ == State::wanted) state_ = State::idle;  // not begun: quicker here
  changed_.wait(lock, [this] { return state_ != State::rendering; });
  if (state_ == State::ready && shot_.is_nearly(shot)) {
    shot.t_mid_exposure = shot_.t_mid_exposure;
  } else {
    render(shot, prepared_);
  }
  state_ = State::idle;
  std::swap(prepared_, taken_);
  return taken_;
}

void RenderAhead::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return stop_ || state_ == State::wanted; });
    if (stop_) return;
    state_ = State::rendering;
    const Shot shot = shot_;
    lock.unlock();
    render(shot, prepared_);  // take() and prepare() wait while the state is rendering
    lock.lock();
    state_ = State::ready;
    changed_.notify_all();
  }
}

void RenderAhead::render(const Shot& shot, std::vector<std::uint8_t>& pixels) {
  pixels.resize(shot.bytes());
  source_.render(shot.t_mid_exposure, shot.view, shot.format, shot.region, pixels.data());
}

}  // namespace holdfast::sim
