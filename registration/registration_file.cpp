// SPDX-License-Identifier: Apache-2.0
#include "registration/registration_file.hpp"

#include <charconv>

#include "registration/sealed_json.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

constexpr std::uintmax_t kMaxImageBytes = 1U << 30U;

/// The file `name` refers to, verified against its seal.
std::filesystem::path require_file(const JsonReader& reader, const JsonReader& seals,
                                   const char* key, const std::filesystem::path& folder) {
  const std::filesystem::path name = reader.text(key);
  if (name.empty()) return {};
  std::filesystem::path file = name.is_absolute() ? name : folder / name;
  if (sha256(read_whole_file(file, kMaxImageBytes)) != seals.text(key))
    reader.fail(fmt::format("the {} file {} is not the one that was registered (checksum)", key,
                            file.string()));
  return file;
}

Registration parse(const json& content, const JsonReader& reader,
                   const std::filesystem::path& folder) {
  Registration registration;
  registration.T_camera_ct =
      require_pose(reader.matrix<4, 4>("T_camera_ct"), "T_camera_ct", reader);
  registration.covariance = reader.matrix<6, 6>("covariance");
  require_covariance<6>(registration.covariance, "covariance", reader);
  registration.fre_mm = reader.number("fre_mm");
  registration.zoom = reader.number("zoom");
  registration.focus_mm = reader.number("focus_mm");
  registration.ct_identity = reader.text("ct");
  const json& targets = reader.member("tre");
  if (!targets.is_array()) reader.fail("tre is not a list");
  for (const json& item : targets) {
    const JsonReader target_reader{item, fmt::format("tre[{}]", registration.tre.size())};
    TargetError target;
    target.p_target_ct_mm = target_reader.matrix<3, 1>("target");
    target.rms_mm = target_reader.number("rms_mm");
    target.covariance_mm2 = target_reader.matrix<3, 3>("covariance_mm2");
    require_covariance<3>(target.covariance_mm2, "covariance_mm2", target_reader);
    registration.tre.push_back(target);
  }
  if (reader.has("closest_point")) {
    const JsonReader agreement{reader.member("closest_point"), "closest_point"};
    registration.closest_point = SurfaceAgreement{
        agreement.number("mean_mm"), agreement.number("rmse_mm"), agreement.number("overlap")};
  }
  const JsonReader seals{reader.member("files_sha256"), "files_sha256"};
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
  const json content = read_sealed(file);
  const JsonReader reader{content, file.string()};
  return parse(content, reader, file.parent_path());
}

std::string sealed_registration(const Registration& registration,
                                const std::filesystem::path& folder) {
  json content;
  content["T_camera_ct"] = matrix_json(registration.T_camera_ct.matrix());
  content["covariance"] = matrix_json(registration.covariance);
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
         {"covariance_mm2", matrix_json(target.covariance_mm2)}});
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
    content["files_sha256"][key] = sha256(read_whole_file(file, kMaxImageBytes));
  };
  add_file("keyframe", registration.keyframe);
  add_file("depth", registration.depth);
  // What is written must be what can be read: NaN becomes null in JSON and is refused here.
  content["checksum"] = seal_of(content);
  const json written = json::parse(content.dump());
  (void)parse(written, JsonReader{written, (folder / "registration").string()}, folder);
  return content.dump(1) + "\n";
}

}  // namespace holdfast::registration
