// SPDX-License-Identifier: Apache-2.0
// Part of mesh_file: PLY as bytes in memory, to a mesh; and words and numbers of a text.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "registration/mesh_file.hpp"

namespace holdfast::registration {

/// White-space separated words of a text, whatever the locale.
class TextScanner {
 public:
  explicit TextScanner(std::string_view text) : rest_(text) {}
  [[nodiscard]] std::string_view word();         ///< empty at the end
  [[nodiscard]] std::optional<double> number();  ///< nothing: no word, or not only a number

 private:
  std::string_view rest_;
};

/// `path` is for messages only. Throws InputError as read_mesh does.
[[nodiscard]] TriangleMesh read_ply(const std::string& path, std::string_view bytes);

}  // namespace holdfast::registration
