// SPDX-License-Identifier: Apache-2.0
#include "registration/registration_file.hpp"

#include <array>
#include <charconv>
#include <cmath>
#include <fstream>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

constexpr std::uintmax_t kMaxJsonBytes = 16U << 20U;
constexpr std::uintmax_t kMaxImageBytes = 1U << 30U;
constexpr double kRotationTolerance = 1e-6;

std::string read_file(const std::filesystem::path& file, std::uintmax_t max_bytes) {
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

/// nlohmann::json keeps members sorted and prints doubles so that they read back exactly, so this
/// text depends on the values alone.
std::string seal_of(json content) {
  content.erase("checksum");
  return sha256(content.dump());
}

template <class Matrix>
json to_json(const Matrix& matrix) {
  json rows = json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    json row = json::array();
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) row.push_back(matrix(r, c));
    rows.push_back(row);
  }
  return rows;
}

/// Reads members of one JSON object; every failure names the file and the member.
class Reader {
 public:
  Reader(const json& object, std::string file) : object_(object), file_(std::move(file)) {}

  [[noreturn]] void fail(const std::string& what) const {
    throw InputError(fmt::format("{}: {}", file_, what));
  }
  [[nodiscard]] const json& member(const char* key) const {
    if (!object_.is_object() || !object_.contains(key)) fail(fmt::format("{} is missing", key));
    return object_.at(key);
  }
  [[nodiscard]] bool has(const char* key) const {
    return object_.is_object() && object_.contains(key);
  }
  [[nodiscard]] double number(const char* key) const { return finite(member(key), key); }
  [[nodiscard]] std::string text(const char* key) const {
    const json& value = member(key);
    if (!value.is_string()) fail(fmt::format("{} is not a text", key));
    return value.get<std::string>();
  }
  /// Nested rows or one flat row-major list.
  template <int kRows, int kCols>
  [[nodiscard]] Eigen::Matrix<double, kRows, kCols> matrix(const char* key) const {
    const json& value = member(key);
    json flat = json::array();
    if (!value.is_array()) fail(fmt::format("{} is not a list", key));
    for (const json& item : value) {
      if (!item.is_array()) {
        flat.push_back(item);
        continue;
      }
      if (item.size() != kCols) fail(fmt::format("{} has a row without {} numbers", key, kCols));
      for (const json& number : item) flat.push_back(number);
    }
    if (flat.size() != kRows * kCols)
      fail(fmt::format("{} has {} numbers, not {}", key, flat.size(), kRows * kCols));
    Eigen::Matrix<double, kRows, kCols> matrix;
    std::size_t i = 0;
    for (int r = 0; r < kRows; ++r)
      for (int c = 0; c < kCols; ++c) matrix(r, c) = finite(flat.at(i++), key);
    return matrix;
  }

 private:
  double finite(const json& value, const char* key) const {
    if (!value.is_number() || !std::isfinite(value.get<double>()))
      fail(fmt::format("{} is not a finite number", key));
    return value.get<double>();
  }
  const json& object_;
  std::string file_;
};

template <int kSize>
void require_covariance(const Eigen::Matrix<double, kSize, kSize>& covariance, const char* key,
                        const Reader& reader) {
  const double scale = covariance.cwiseAbs().maxCoeff();
  if ((covariance - covariance.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale)
    reader.fail(fmt::format("{} is not symmetric", key));
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, kSize, kSize>> solver(
      covariance, Eigen::EigenvaluesOnly);
  if (solver.eigenvalues().minCoeff() < -1e-9 * scale)
    reader.fail(fmt::format("{} is not positive semi-definite, smallest eigenvalue {}", key,
                            solver.eigenvalues().minCoeff()));
}

Eigen::Isometry3d require_pose(const Eigen::Matrix4d& matrix, const Reader& reader) {
  const Eigen::Matrix3d rotation = matrix.topLeftCorner<3, 3>();
  const double error =
      (rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (error > kRotationTolerance || rotation.determinant() < 0)
    reader.fail(fmt::format("the rotation of T_camera_ct is off by {}, at most {}",
                            rotation.determinant() < 0 ? 2.0 : error, kRotationTolerance));
  if (matrix.row(3) != Eigen::RowVector4d(0, 0, 0, 1))
    reader.fail("the last row of T_camera_ct is not 0 0 0 1");
  Eigen::Isometry3d pose;
  pose.matrix() = matrix;
  return pose;
}

/// The file `name` refers to, verified against its seal.
std::filesystem::path require_file(const Reader& reader, const Reader& seals, const char* key,
                                   const std::filesystem::path& folder) {
  const std::filesystem::path name = reader.text(key);
  if (name.empty()) return {};
  std::filesystem::path file = name.is_absolute() ? name : folder / name;
  if (sha256(read_file(file, kMaxImageBytes)) != seals.text(key))
    reader.fail(fmt::format("the {} file {} is not the one that was registered (checksum)", key,
                            file.string()));
  return file;
}

Registration parse(const json& content, const Reader& reader, const std::filesystem::path& folder) {
  Registration registration;
  registration.T_camera_ct = require_pose(reader.matrix<4, 4>("T_camera_ct"), reader);
  registration.covariance = reader.matrix<6, 6>("covariance");
  require_covariance<6>(registration.covariance, "covariance", reader);
  registration.fre_mm = reader.number("fre_mm");
  registration.zoom = reader.number("zoom");
  registration.focus_mm = reader.number("focus_mm");
  registration.ct_identity = reader.text("ct");
  const json& targets = reader.member("tre");
  if (!targets.is_array()) reader.fail("tre is not a list");
  for (const json& item : targets) {
    const Reader target_reader{item, fmt::format("tre[{}]", registration.tre.size())};
    TargetError target;
    target.p_target_ct_mm = target_reader.matrix<3, 1>("target");
    target.rms_mm = target_reader.number("rms_mm");
    target.covariance_mm2 = target_reader.matrix<3, 3>("covariance_mm2");
    require_covariance<3>(target.covariance_mm2, "covariance_mm2", target_reader);
    registration.tre.push_back(target);
  }
  if (reader.has("closest_point")) {
    const Reader agreement{reader.member("closest_point"), "closest_point"};
    registration.closest_point = SurfaceAgreement{
        agreement.number("mean_mm"), agreement.number("rmse_mm"), agreement.number("overlap")};
  }
  const Reader seals{reader.member("files_sha256"), "files_sha256"};
  registration.keyframe = require_file(reader, seals, "keyframe", folder);
  registration.depth = require_file(reader, seals, "depth", folder);
  registration.checksum = seal_of(content);
  return registration;
}

}  // namespace

std::uint64_t Registration::id() const {
  constexpr std::string_view kPrefix = "sha256:";
  std::uint64_t value = 0;
  if (checksum.size() < kPrefix.size() + 16) return 0;
  const char* begin = checksum.data() + kPrefix.size();
  std::from_chars(begin, begin + 16, value, 16);
  return value;
}

Registration load_registration(const std::filesystem::path& file) {
  const std::string text = read_file(file, kMaxJsonBytes);
  const json content = json::parse(text, nullptr, false);
  const Reader reader{content, file.string()};
  if (content.is_discarded()) reader.fail("is not JSON");
  if (!content.is_object()) reader.fail("is not a JSON object");
  const std::string stated = reader.text("checksum");
  const std::string computed = seal_of(content);
  if (stated != computed)
    reader.fail(
        fmt::format("wrong checksum: the file says {}, its content is {}", stated, computed));
  return parse(content, reader, file.parent_path());
}

std::string sealed_registration(const Registration& registration,
                                const std::filesystem::path& folder) {
  json content;
  content["T_camera_ct"] = to_json(registration.T_camera_ct.matrix());
  content["covariance"] = to_json(registration.covariance);
  content["fre_mm"] = registration.fre_mm;
  content["zoom"] = registration.zoom;
  content["focus_mm"] = registration.focus_mm;
  content["ct"] = registration.ct_identity;
  content["tre"] = json::array();
  for (const TargetError& target : registration.tre)
    content["tre"].push_back(
        {{"target",
          {target.p_target_ct_mm.x(), target.p_target_ct_mm.y(), target.p_target_ct_mm.z()}},
         {"rms_mm", target.rms_mm},
         {"covariance_mm2", to_json(target.covariance_mm2)}});
  if (registration.closest_point)
    content["closest_point"] = {{"mean_mm", registration.closest_point->mean_mm},
                                {"rmse_mm", registration.closest_point->rmse_mm},
                                {"overlap", registration.closest_point->overlap}};
  content["files_sha256"] = json::object();
  const auto add_file = [&](const char* key, const std::filesystem::path& path) {
    content[key] = "";
    if (path.empty()) return;
    const std::filesystem::path file = path.is_absolute() ? path : folder / path;
    content[key] = file.lexically_proximate(folder).string();
    content["files_sha256"][key] = sha256(read_file(file, kMaxImageBytes));
  };
  add_file("keyframe", registration.keyframe);
  add_file("depth", registration.depth);
  // What is written must be what can be read: NaN becomes null in JSON and is refused here.
  content["checksum"] = seal_of(content);
  const json written = json::parse(content.dump());
  (void)parse(written, Reader{written, (folder / "registration").string()}, folder);
  return content.dump(1) + "\n";
}

}  // namespace holdfast::registration
