// SPDX-License-Identifier: Apache-2.0
// What a YAML file must be before OpenCV's FileStorage may read it: one document, a map at its top.
// With what follows a first document OpenCV 4.6 can go round for ever, and none of our files has
// more. Not for the real-time path.
#pragma once

#include <string>

namespace holdfast::registration {

/// Throws InputError naming `path`, line and fault. Says nothing of what the document holds.
void require_one_document(const std::string& path);

}  // namespace holdfast::registration
