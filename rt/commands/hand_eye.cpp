// SPDX-License-Identifier: Apache-2.0
// `holdfast hand-eye`: where the camera stands in the robot's frame, from spots of its aiming beam.
#include "registration/hand_eye.hpp"

#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core/utils/logger.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "registration/hand_eye_file.hpp"
#include "registration/sealed_json.hpp"
#include "registration/spot_detection.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using registration::HandEye;
using registration::HandEyeInput;
using registration::HandEyeSpot;
using registration::JsonReader;

constexpr std::uintmax_t kMaxBytes = 16U << 20U;
constexpr std::size_t kSpotsMax = 200;

constexpr const char* kExample =
    "Example: twelve spots, each once with the beam and once without\n"
    "  holdfast hand-eye --spots spots.json --calibration stereo.yaml --zoom 1.3 \\\n"
    "    --out hand_eye.json --snippet hand_eye.toml\n"
    "spots.json, image files relative to it, everything else in the robot's frame, mm:\n"
    "  {\"sigma_mm\": 0.05,\n"
    "   \"spots\": [\n"
    "    {\"name\": \"s01\", \"left\": \"s01_left.png\", \"right\": \"s01_right.png\",\n"
    "     \"left_off\": \"s01_left_off.png\", \"right_off\": \"s01_right_off.png\",\n"
    "     \"point_mm\": [412.30, -80.11, 95.42]}, ...]}\n"
    "sigma_mm: how exactly the robot knows its points (1 sigma, each axis). Of a beam whose spot "
    "is\n"
    "not known, \"origin_mm\" and \"direction\" stand for point_mm, and \"sigma_rad\" (of the "
    "beam)\n"
    "beside sigma_mm. left_off and right_off may be left out where nothing else is bright.\n"
    "Raise or tilt the surface between the spots; six are needed, twelve are good.\n"
    "hand_eye.toml is what holdfastd.toml and guard.toml take in [robot].\n"
    "Exit code 1: a spot or the whole is refused; the reason is on stderr, nothing is written.";

struct Options {
  std::string spots, calibration, out, snippet;
  double zoom = 0;
  bool may_extrapolate = false, is_json = false;
  registration::HandEyeLimits limits;
};

/// The brightest of the colours: a red beam saturates red, not grey.
cv::Mat1b read_image(const std::string& path, const HandEyeInput& input) {
  cv::Mat image = bridge::read_image_file(path);
  if (image.depth() != CV_8U || (image.channels() != 1 && image.channels() != 3))
    throw InputError(path +
                     ": must be grey or colour, 8 bit: at what value it saturates must be known");
  if (image.cols != input.image_width_px || image.rows != input.image_height_px)
    throw InputError(fmt::format("{}: is {}x{} px, must be {}x{} px as the calibration", path,
                                 image.cols, image.rows, input.image_width_px,
                                 input.image_height_px));
  if (image.channels() == 1) return image;
  cv::Mat brightest, channel;
  cv::extractChannel(image, brightest, 0);
  for (int i = 1; i < image.channels(); ++i) {
    cv::extractChannel(image, channel, i);
    cv::max(brightest, channel, brightest);
  }
  return brightest;
}

class SpotsFile {
 public:
  SpotsFile(std::string path, const HandEyeInput& input)
      : path_(std::move(path)), folder_(fs::path(path_).parent_path()), input_(input) {}

  std::vector<HandEyeSpot> read() {
    const json content = registration::parse_json(registration::read_whole_file(path_, kMaxBytes));
    const JsonReader whole{content, path_};
    if (!content.is_object()) whole.fail("is not a JSON object");
    const json& list = whole.member("spots");
    if (!list.is_array() || list.empty() || list.size() > kSpotsMax)
      whole.fail(fmt::format("spots is not a list of 1 to {}", kSpotsMax));
    sigma_mm_ = in_range(whole, "sigma_mm", 1e-6, 10);
    sigma_rad_ =
        whole.has("sigma_rad") ? in_range(whole, "sigma_rad", 0, 0.1) : std::optional<double>{};
    std::vector<HandEyeSpot> spots;
    for (const json& item : list) {
      const JsonReader one{item, fmt::format("{}: spots[{}]", path_, spots.size())};
      spots.push_back(read_spot(one));
      if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    }
    return spots;
  }

 private:
  static double in_range(const JsonReader& reader, const char* key, double least, double most) {
    const double value = reader.number(key);
    if (!(value >= least && value <= most))
      reader.fail(fmt::format("{} = {:g} is out of range {:g} to {:g}", key, value, least, most));
    return value;
  }

  HandEyeSpot read_spot(const JsonReader& reader) const {
    HandEyeSpot spot;
    spot.name = reader.text("name");
    if (reader.has("point_mm") == reader.has("origin_mm") ||
        reader.has("origin_mm") != reader.has("direction"))
      reader.fail("either point_mm or origin_mm with direction is needed");
    spot.robot.sigma_mm = sigma_mm_;
    if (reader.has("point_mm")) {
      spot.robot.point_mm = reader.matrix<3, 1>("point_mm");
    } else {
      spot.robot.point_mm = reader.matrix<3, 1>("origin_mm");
      const Eigen::Vector3d direction = reader.matrix<3, 1>("direction");
      if (!(direction.norm() > 0)) reader.fail("direction has no length");
      spot.robot.direction = direction.normalized();
      if (!sigma_rad_) reader.fail("a beam needs sigma_rad, of the whole file");
      spot.robot.sigma_rad = *sigma_rad_;
    }
    spot.left = find(reader, spot.name, "left");
    spot.right = find(reader, spot.name, "right");
    return spot;
  }

  [[nodiscard]] registration::ImageSpot find(const JsonReader& reader, const std::string& name,
                                             const std::string& side) const {
    const std::string off = side + "_off";
    const cv::Mat1b on_image = read_image((folder_ / reader.text(side.c_str())).string(), input_);
    const cv::Mat1b off_image =
        reader.has(off.c_str()) ? read_image((folder_ / reader.text(off.c_str())).string(), input_)
                                : cv::Mat1b();
    return registration::find_spot(on_image, off_image, fmt::format("{} ({})", name, side));
  }

  std::string path_;
  fs::path folder_;
  const HandEyeInput& input_;
  double sigma_mm_ = 0;
  std::optional<double> sigma_rad_;
};

std::string snippet_of(const HandEye& found, const std::string& file) {
  const Eigen::Vector3d t = found.T_robot_camera.translation();
  const Eigen::Quaterniond q(found.T_robot_camera.linear());
  return fmt::format(
      "# holdfastd.toml: the file itself, with its uncertainty; its path is relative to "
      "holdfastd.toml\n[robot]\nhand_eye = \"{}\"\n\n"
      "# guard.toml: the same transform a second time\n#[robot]\n"
      "#translation_mm = [{:.6f}, {:.6f}, {:.6f}]\n"
      "#rotation_xyzw = [{:.12f}, {:.12f}, {:.12f}, {:.12f}]\n",
      file, t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
}

void report(const HandEye& found) {
  fmt::print("{} spots, {:.4f} mm rms, chi squared {:.1f} where {} are expected (p {:.3f})\n",
             found.spots.size(), found.rms_mm, found.chi_squared, found.degrees_of_freedom,
             found.p_value);
  for (const registration::LocatedSpot& spot : found.spots)
    fmt::print("  {:<12} residual {:.4f} mm  left out {:.4f} mm (p {:.3f})  images {:.2f} px\n",
               spot.name, spot.residual_mm, spot.left_out.displacement_mm, spot.left_out.p_value,
               spot.epipolar_px);
  fmt::print("scale {:.5f} +- {:.5f}\n", found.scale.value, found.scale.sigma);
  fmt::print("predicted error in the middle of the working volume: {:.4f} mm rms\n",
             std::sqrt(found.covariance_middle_mm2.trace()));
}

void run(const Options& options) {
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  cv::setNumThreads(2);
  bridge::catch_interrupts();
  const auto calibration = registration::read_stereo_calibration(options.calibration);
  HandEyeInput input;
  input.calibration =
      registration::calibration_at_zoom(calibration, options.zoom, options.may_extrapolate);
  input.image_width_px = calibration.image_width_px;
  input.image_height_px = calibration.image_height_px;
  input.limits = options.limits;
  input.spots = SpotsFile(options.spots, input).read();
  const HandEye found = registration::find_hand_eye(input);
  if (found.status == registration::HandEyeStatus::invalid_numbers) throw InputError(found.reason);
  if (found.status != registration::HandEyeStatus::found) throw RefusedError(found.reason);
  const std::string sealed = registration::sealed_hand_eye(
      found, input,
      registration::sha256(registration::read_whole_file(options.calibration, kMaxBytes)));
  bridge::write_file_atomically(options.out, sealed);
  if (!options.snippet.empty())
    bridge::write_file_atomically(options.snippet, snippet_of(found, options.out));
  if (options.is_json)
    fmt::print("{}\n", json::parse(sealed).dump());
  else
    report(found);
}

}  // namespace

void add_hand_eye(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("hand-eye", "Where the camera stands in the robot's frame.");
  command->add_option("--spots", options->spots, "What the robot says of each spot (JSON)")
      ->required();
  command->add_option("--calibration", options->calibration, "stereo.yaml of `holdfast calibrate`")
      ->required();
  command->add_option("--zoom", options->zoom, "Zoom of the images")->required();
  command->add_flag("--extrapolate", options->may_extrapolate, "Also outside the calibrated zooms");
  command
      ->add_option("--sigma-max-mm", options->limits.largest_sigma_mm,
                   "Largest predicted error in the middle of the working volume (1 sigma), mm")
      ->check(CLI::Range(0.001, 10.0))
      ->capture_default_str();
  command->add_option("--out", options->out, "Sealed hand-eye file (hand_eye.json)")->required();
  command->add_option("--snippet", options->snippet, "Also what the configurations take (TOML)");
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
