// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/hand_eye/drawn_spot_images.hpp"

#include <cmath>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration::test {
namespace {

constexpr double kRobotSigmaMm = 0.05;

/// A site with a texture, lit, and on it the spot: blurred, with noise and whole grey values.
cv::Mat1b draw(const HandEyeInput& input, const ImageSpot* spot, cv::RNG& random) {
  cv::Mat1b image(input.image_height_px, input.image_width_px);
  cv::Mat1f noise(image.size());
  random.fill(noise, cv::RNG::NORMAL, 0, 1.5);
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      double grey = 60 + 25 * ((u / 23 + v / 17) % 2) + static_cast<double>(noise(v, u));
      if (spot != nullptr) {
        const double dx = u - spot->centre_px.x(), dy = v - spot->centre_px.y();
        if (const double d = dx * dx + dy * dy; d < 1600) grey += 110 * std::exp(-d / (2 * 36));
      }
      image(v, u) = cv::saturate_cast<uchar>(grey);
    }
  return image;
}

void write_image(const std::filesystem::path& file, const cv::Mat1b& image) {
  if (!cv::imwrite(file.string(), image))
    throw InputError(fmt::format("{}: cannot be written", file.string()));
}

}  // namespace

void write_spot_images(const DrawnHandEye& drawn, const std::filesystem::path& folder,
                       std::uint64_t seed) {
  const HandEyeInput& input = drawn.input;
  cv::RNG random(seed);
  for (const char* side : {"left", "right"})
    write_image(folder / fmt::format("{}_off.png", side), draw(input, nullptr, random));
  nlohmann::json file{{"sigma_mm", kRobotSigmaMm}};
  for (const HandEyeSpot& spot : input.spots) {
    const Eigen::Vector3d& p = spot.robot.point_mm;
    nlohmann::json one{{"name", spot.name}, {"point_mm", {p.x(), p.y(), p.z()}}};
    for (const std::string side : {"left", "right"}) {
      one[side] = fmt::format("{}_{}.png", spot.name, side);
      one[side + "_off"] = side + "_off.png";
      write_image(folder / one[side].get<std::string>(),
                  draw(input, side == "left" ? &spot.left : &spot.right, random));
    }
    file["spots"].push_back(one);
  }
  bridge::write_file_atomically((folder / "spots.json").string(), file.dump(1) + "\n");
  bridge::write_file_atomically(
      (folder / "stereo.yaml").string(),
      stereo_calibration_text({input.image_width_px, input.image_height_px, {input.calibration}}));
}

}  // namespace holdfast::registration::test
