// SPDX-License-Identifier: Apache-2.0
// `/live`: the daemon's live view as the page reads it, all little-endian: "HFL1", then as uint32
// the lengths of the JSON and of the mask; the JSON; the mask (a byte for each 4x4 pixels); a JPEG.
// Without a live picture the last two are empty, and the JSON says why.
//
// A picture is encoded once, whoever asks for it how often, and not at all when nobody does.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "bridge/live_view/live_file.hpp"

namespace holdfast::dashboard {

class LiveAnswer {
 public:
  /// `file` empty: there is no live view in this set-up, and the answer says so.
  explicit LiveAnswer(const std::filesystem::path& file);

  /// One thread; allocates.
  [[nodiscard]] std::string compose(bridge::dds::Clocks now);
  /// Pictures encoded since the start.
  [[nodiscard]] int encoded() const noexcept { return encoded_; }

 private:
  void encode(const bridge::LivePicture& picture);

  std::optional<bridge::LiveReader> reader_;
  std::vector<unsigned char> jpeg_;
  std::uint64_t frame_ = 0;  // of jpeg_
  std::chrono::nanoseconds t_exposure_{};
  int encoded_ = 0;
};

}  // namespace holdfast::dashboard
