// SPDX-License-Identifier: Apache-2.0
#include "registration/sealed_json.hpp"

#include <array>
#include <fstream>

#include <openssl/evp.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {

using nlohmann::json;

namespace {
constexpr std::uintmax_t kMaxJsonBytes = 16U << 20U;
constexpr double kRotationTolerance = 1e-6;
constexpr int kDepthMax = 32;

struct TooDeep {};
}  // namespace

std::string read_whole_file(const std::filesystem::path& file, std::uintmax_t max_bytes) {
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  if (error) throw InputError(fmt::format("{}: {}", file.string(), error.message()));
  if (size > max_bytes)
    throw InputError(
        fmt::format("{}: {} bytes, at most {} are read", file.string(), size, max_bytes));
  std::ifstream stream{file, std::ios::binary};
  std::string content(size, '\0');
  if (!stream.read(content.data(), static_cast<std::streamsize>(size)))
    throw InputError(fmt::format("{}: cannot be read", file.string()));
  return content;
}

std::string sha256(std::string_view bytes) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned length = 0;
  if (EVP_Digest(bytes.data(), bytes.size(), digest.data(), &length, EVP_sha256(), nullptr) != 1)
    throw UnavailableError("SHA-256 is not available in this OpenSSL");
  std::string text = "sha256:";
  for (unsigned i = 0; i < length; ++i) text += fmt::format("{:02x}", digest.at(i));
  return text;
}

json parse_json(std::string_view text) {
  const auto bounded = [](int depth, json::parse_event_t, json&) {
    if (depth > kDepthMax) throw TooDeep{};
    return true;
  };
  try {
    return json::parse(text, bounded, false);
  } catch (const TooDeep&) {
    return json(json::value_t::discarded);  // braces would make it an array
  }
}

/// nlohmann::json keeps members sorted and prints doubles so that they read back exactly, so this
/// text depends on the values alone.
std::string seal_of(json content) {
  content.erase("checksum");
  return sha256(content.dump());
}

json read_sealed(const std::filesystem::path& file) {
  json content = parse_json(read_whole_file(file, kMaxJsonBytes));
  const JsonReader reader{content, file.string()};
  if (content.is_discarded()) reader.fail("is not JSON, or nested too deep");
  if (!content.is_object()) reader.fail("is not a JSON object");
  const std::string stated = reader.text("checksum");
  const std::string computed = seal_of(content);
  if (stated != computed)
    reader.fail(
        fmt::format("wrong checksum: the file says {}, its content is {}", stated, computed));
  return content;
}

void JsonReader::fail(const std::string& what) const {
  throw InputError(fmt::format("{}: {}", file_, what));
}

const json& JsonReader::member(const char* key) const {
  if (!object_.is_object() || !object_.contains(key)) fail(fmt::format("{} is missing", key));
  return object_.at(key);
}

bool JsonReader::has(const char* key) const {
  return object_.is_object() && object_.contains(key);
}

std::string JsonReader::text(const char* key) const {
  const json& value = member(key);
  if (!value.is_string()) fail(fmt::format("{} is not a text", key));
  return value.get<std::string>();
}

double JsonReader::finite(const json& value, const char* key) const {
  if (!value.is_number() || !std::isfinite(value.get<double>()))
    fail(fmt::format("{} is not a finite number", key));
  return value.get<double>();
}

Eigen::Isometry3d require_pose(const Eigen::Matrix4d& matrix, const char* key,
                               const JsonReader& reader) {
  const Eigen::Matrix3d rotation = matrix.topLeftCorner<3, 3>();
  const double error =
      (rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (error > kRotationTolerance || rotation.determinant() < 0)
    reader.fail(fmt::format("the rotation of {} is off by {}, at most {}", key,
                            rotation.determinant() < 0 ? 2.0 : error, kRotationTolerance));
  if (matrix.row(3) != Eigen::RowVector4d(0, 0, 0, 1))
    reader.fail(fmt::format("the last row of {} is not 0 0 0 1", key));
  Eigen::Isometry3d pose;
  pose.matrix() = matrix;
  return pose;
}

}  // namespace holdfast::registration
