// SPDX-License-Identifier: Apache-2.0
#include "registration/ct_registration.hpp"

#include <cmath>
#include <fstream>
#include <random>

#include <gtest/gtest.h>

#include "registration/reconstruction.hpp"
#include "registration/transform_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using Status = RegistrationStatus;

const Eigen::Isometry3d kTruth =
    Eigen::Translation3d{12, -30, 200} *
    Eigen::AngleAxisd{2.3, Eigen::Vector3d{0.2, -0.7, 0.4}.normalized()};
const Eigen::Vector3d kTarget{8, -4, -15};

Markups points(const std::vector<Eigen::Vector3d>& positions, const std::string& label,
               double sigma_mm) {
  Markups markups;
  for (const Eigen::Vector3d& p : positions) {
    MarkupPoint point;
    point.label = label + std::to_string(markups.points.size() + 1);
    point.position_mm = p;
    point.covariance_mm2 = sigma_mm * sigma_mm * Eigen::Matrix3d::Identity();
    markups.points.push_back(point);
  }
  return markups;
}

/// Four holders, seen with 0.04 mm of noise in the camera and 0.02 mm in the CT, other labels.
RegistrationInput good_input(std::uint64_t seed = 1) {
  std::mt19937_64 random{seed};
  std::normal_distribution<double> normal;
  const auto noisy = [&](const Eigen::Vector3d& p, double sigma_mm) -> Eigen::Vector3d {
    return p + sigma_mm * Eigen::Vector3d{normal(random), normal(random), normal(random)};
  };
  std::vector<Eigen::Vector3d> ct, camera;
  for (const Eigen::Vector3d& p : {Eigen::Vector3d{-45, -25, 6}, Eigen::Vector3d{44, -22, 14},
                                   Eigen::Vector3d{40, 26, 3}, Eigen::Vector3d{-38, 24, 10}}) {
    ct.push_back(noisy(p, 0.02));
    camera.push_back(noisy(kTruth * p, 0.04));
  }
  RegistrationInput input;
  input.fixed = points(ct, "bead-", 0.02);
  input.moving = points(camera, "aruco-", 0.04);
  input.fixed.properties = {{kCtSeriesUid, "1.2.3"}, {kCtFrameOfReferenceUid, "1.2.9"}};
  input.targets_ct_mm = {kTarget};
  return input;
}

TEST(CtRegistration, FindsTheCorrespondenceAndPredictsItsError) {
  RegistrationInput input = good_input();
  std::swap(input.fixed.points[0], input.fixed.points[2]);
  input.fixed.points.push_back({"filling", {3, 2, -30}, Eigen::Matrix3d::Identity() * 1e-4, ""});
  const CtRegistration result = register_ct(input);
  ASSERT_EQ(result.status, Status::registered) << result.reason;
  const Registration& registration = result.registration;
  const double error_mm = (registration.T_camera_ct * kTarget - kTruth * kTarget).norm();
  ASSERT_EQ(registration.tre.size(), 1U);
  EXPECT_LT(error_mm, 4 * registration.tre[0].rms_mm);
  EXPECT_LT(registration.tre[0].rms_mm, 0.1);
  EXPECT_EQ(registration.ct_identity, "1.2.3");
  EXPECT_EQ(result.labels[0], "aruco-1 = bead-1");
}

TEST(CtRegistration, EqualLabelsDecideEvenWhereTheyAreWrong) {
  RegistrationInput input = good_input();
  for (MarkupPoint& point : input.fixed.points) point.label.replace(0, 5, "aruco-");
  ASSERT_EQ(register_ct(input).status, Status::registered);
  std::swap(input.fixed.points[0].label, input.fixed.points[1].label);
  EXPECT_NE(register_ct(input).status, Status::registered);
}

/// Nearly a rectangle: half a turn is within the FRE's limit.
RegistrationInput near_rectangle(double skew_mm) {
  RegistrationInput input = good_input();
  const Eigen::Vector3d corners[] = {
      {-30, -30, 0}, {30 + skew_mm, -30, 0}, {30, 30, 0}, {-30, 30, 0}};
  for (std::size_t k = 0; k < 4; ++k) {
    input.fixed.points[k].position_mm = corners[k];
    input.moving.points[k].position_mm = kTruth * corners[k];
  }
  return input;
}

TEST(CtRegistration, TellsAssignmentsApartOnlyByStatedCovariances) {
  RecordProperty("requirement", "SR-86");
  RegistrationInput input = near_rectangle(0.7);
  const CtRegistration told_apart = register_ct(input);
  ASSERT_EQ(told_apart.status, Status::registered) << told_apart.reason;
  EXPECT_EQ(told_apart.labels[1], "aruco-2 = bead-2");
  // Less exactly known points leave both possible, and so do points of which nothing is stated.
  RegistrationInput vague = input;
  for (MarkupPoint& p : vague.moving.points) *p.covariance_mm2 *= 4;
  EXPECT_EQ(register_ct(vague).status, Status::ambiguous_correspondence);
  RegistrationInput silent = input;
  silent.moving.points[0].covariance_mm2.reset();
  EXPECT_EQ(register_ct(silent).status, Status::ambiguous_correspondence);
  EXPECT_EQ(register_ct(near_rectangle(0.1)).status, Status::ambiguous_correspondence);
}

/// A relief in the CT, and its points in the camera.
void add_surfaces(RegistrationInput& input) {
  constexpr std::uint32_t kSide = 61;
  input.fixed_surface.emplace();
  input.moving_surface.emplace();
  for (std::uint32_t j = 0; j < kSide; ++j)
    for (std::uint32_t i = 0; i < kSide; ++i) {
      const double x = -30.0 + i, y = -30.0 + j;
      const Eigen::Vector3d p{x, y, 6 * std::sin(x / 9) * std::cos(y / 7) + 2 * std::sin(x / 4)};
      input.fixed_surface->vertices_mm.emplace_back(p.cast<float>());
      input.moving_surface->vertices_mm.emplace_back((kTruth * p).cast<float>());
      if (i + 1 == kSide || j + 1 == kSide) continue;
      const std::uint32_t a = j * kSide + i;
      input.fixed_surface->triangles.push_back({a, a + 1, a + kSide + 1});
      input.fixed_surface->triangles.push_back({a, a + kSide + 1, a + kSide});
    }
  input.is_refined = true;
}

TEST(CtRegistration, FusesASurfaceOnlyWhereItGains) {
  RecordProperty("requirement", "SR-134");
  RegistrationInput good = good_input();
  for (std::size_t k = 0; k < 4; ++k) {
    good.moving.points[k].position_mm = kTruth * good.fixed.points[k].position_mm;
    good.fixed.points[k].covariance_mm2 = good.moving.points[k].covariance_mm2 =
        1e-5 * Eigen::Matrix3d::Identity();
  }
  add_surfaces(good);
  const CtRegistration kept = register_ct(good);
  ASSERT_EQ(kept.status, Status::registered) << kept.reason;
  EXPECT_FALSE(kept.is_fused);
  EXPECT_EQ(kept.registration.T_camera_ct.matrix(), kept.fiducial_fit.T_camera_ct.matrix());
  ASSERT_EQ(kept.notes.size(), 1U);
  EXPECT_NE(kept.notes.front().find("stays"), std::string::npos) << kept.notes.front();

  RegistrationInput poor = good;  // of the same points less is claimed
  for (MarkupPoint& p : poor.moving.points) *p.covariance_mm2 *= 4000;
  const CtRegistration fused = register_ct(poor);
  ASSERT_EQ(fused.status, Status::registered) << fused.reason;
  EXPECT_TRUE(fused.is_fused);
  poor.is_refined = false;
  EXPECT_LT(fused.registration.tre[0].rms_mm, 0.9 * register_ct(poor).registration.tre[0].rms_mm);
}

struct Case {
  const char* name;
  Status status;
  const char* word;  // of the reason
  void (*spoil)(RegistrationInput&);
};

class CtRegistrationRefuses : public testing::TestWithParam<Case> {};

TEST_P(CtRegistrationRefuses, ByName) {
  RecordProperty("requirement", "SR-86");
  RegistrationInput input = good_input();
  GetParam().spoil(input);
  const CtRegistration result = register_ct(input);
  EXPECT_EQ(result.status, GetParam().status) << result.reason;
  EXPECT_NE(result.reason.find(GetParam().word), std::string::npos) << result.reason;
  EXPECT_EQ(result.reason.find('\n'), std::string::npos);
  EXPECT_TRUE(result.registration.tre.empty());
  EXPECT_EQ(result.registration.T_camera_ct.matrix(), Eigen::Matrix4d::Identity());
}

INSTANTIATE_TEST_SUITE_P(
    BadInput, CtRegistrationRefuses,
    testing::Values(Case{"OneMarkerDisplacedByOneMillimetre", Status::fiducial_displaced, "aruco-3",
                         [](RegistrationInput& i) { i.moving.points[2].position_mm.x() += 1; }},
                    Case{"MirroredCt", Status::mirrored_ct, "mirrored",
                         [](RegistrationInput& i) {
                           for (MarkupPoint& p : i.fixed.points)
                             p.position_mm.x() = -p.position_mm.x();
                         }},
                    Case{"MirroredCtWithLabels", Status::mirrored_ct, "mirrored",
                         [](RegistrationInput& i) {
                           for (std::size_t k = 0; k < 4; ++k) {
                             i.fixed.points[k].position_mm.y() = -i.fixed.points[k].position_mm.y();
                             i.fixed.points[k].label = i.moving.points[k].label;
                           }
                         }},
                    Case{"AnotherPatientsCt", Status::no_correspondence, "another patient",
                         [](RegistrationInput& i) {
                           for (MarkupPoint& p : i.fixed.points) p.position_mm.x() *= 1.1;
                         }},
                    Case{"NotThePlannedCt", Status::other_ct, "5.5",
                         [](RegistrationInput& i) { i.expected_ct = "5.5"; }},
                    Case{"PlannedCtButUnknownFiles", Status::other_ct, "do not say",
                         [](RegistrationInput& i) {
                           i.expected_ct = "1.2.3";
                           i.fixed.properties.clear();
                         }},
                    Case{"SurfaceOfAnotherCt", Status::other_ct, "9.9",
                         [](RegistrationInput& i) {
                           i.fixed_surface.emplace();
                           i.fixed_surface->comments = {"ct_frame_of_reference 9.9"};
                         }},
                    Case{"SurfaceMadeUnderALattice", Status::comparison_surface, "lattice",
                         [](RegistrationInput& i) {
                           i.moving_surface.emplace();
                           i.moving_surface->comments = {std::string(kForComparison) + ": lattice"};
                         }},
                    Case{"MarkersInALine", Status::collinear, "line",
                         [](RegistrationInput& i) {
                           for (std::size_t k = 0; k < 4; ++k) {
                             const double x = 17.0 * static_cast<double>(k * k);
                             i.fixed.points[k].position_mm = {x, 0, 0};
                             i.moving.points[k].position_mm = kTruth * Eigen::Vector3d{x, 0, 0};
                             i.moving.points[k].label = i.fixed.points[k].label;
                           }
                         }},
                    Case{"TwoMarkersOnly", Status::too_few_fiducials, "at least 3",
                         [](RegistrationInput& i) { i.moving.points.resize(2); }},
                    Case{"TwoMarkersOfOneName", Status::duplicate_label, "aruco-1",
                         [](RegistrationInput& i) { i.moving.points[1].label = "aruco-1"; }},
                    Case{"SymmetricMarkers", Status::ambiguous_correspondence, "two assignments",
                         [](RegistrationInput& i) {
                           const Eigen::Vector3d square[] = {
                               {-30, -30, 0}, {30, -30, 0}, {30, 30, 0}, {-30, 30, 0}};
                           for (std::size_t k = 0; k < 4; ++k) {
                             i.fixed.points[k].position_mm = square[k];
                             i.moving.points[k].position_mm = kTruth * square[k];
                           }
                         }},
                    Case{"TargetFarAway", Status::target_uncertain, "predicted TRE",
                         [](RegistrationInput& i) { i.targets_ct_mm.emplace_back(0, 0, 2000); }},
                    Case{"OverconfidentCovariances", Status::poor_fit, "probability",
                         [](RegistrationInput& i) {
                           for (MarkupPoint& p : i.moving.points) *p.covariance_mm2 *= 0.01;
                           for (MarkupPoint& p : i.fixed.points) *p.covariance_mm2 *= 0.01;
                           i.limits.left_out_p_min = 0;
                         }}),
    [](const testing::TestParamInfo<Case>& tested) { return std::string{tested.param.name}; });

TEST(CtRegistration, RefusesASurfaceMadeUnderALatticeEvenOnlyToLookAt) {
  RecordProperty("requirement", "SR-96");
  RegistrationInput input = good_input();
  add_surfaces(input);
  for (MarkupPoint& p : input.moving.points) *p.covariance_mm2 *= 4000;
  ASSERT_EQ(register_ct(input).status, Status::registered);
  input.moving_surface->comments = {std::string(kForComparison) + ": under a lattice"};
  for (const bool is_refined : {true, false}) {
    input.is_refined = is_refined;
    EXPECT_EQ(register_ct(input).status, Status::comparison_surface);
  }
}

TEST(CtRegistration, RefusesADisplacedMarkerAlsoWithoutCovariances) {
  RecordProperty("requirement", "SR-86");
  RegistrationInput input = good_input();
  for (std::size_t k = 0; k < 4; ++k) {
    input.fixed.points[k].covariance_mm2.reset();
    input.moving.points[k].covariance_mm2.reset();
    input.fixed.points[k].label = input.moving.points[k].label;
  }
  ASSERT_EQ(register_ct(input).status, Status::registered);
  input.moving.points[1].position_mm += kTruth.linear() * Eigen::Vector3d{0, 1, 0};
  EXPECT_EQ(register_ct(input).status, Status::fiducial_displaced);
}

TEST(CtRegistration, SeldomRefusesAGoodOne) {
  int refused = 0;
  for (std::uint64_t seed = 0; seed < 500; ++seed)
    refused += register_ct(good_input(seed)).status == Status::registered ? 0 : 1;
  EXPECT_LE(refused, 2);
}

TEST(TransformFile, ReadsBackWhatItWrote) {
  const std::string path = testing::TempDir() + "transform_file_test.tfm";
  std::ofstream{path} << transform_text(kTruth);
  EXPECT_EQ(read_transform(path).matrix(), kTruth.matrix());
}

TEST(TransformFile, AppliesTheCentreAndRefusesWhatIsNoRigidTransform) {
  const std::string path = testing::TempDir() + "transform_file_test.tfm";
  const auto read = [&path](const std::string& parameters, const std::string& fixed) {
    std::ofstream{path}
        << "#Insight Transform File V1.0\r\nTransform: AffineTransform_double_3_3\r\n"
        << "Parameters: " << parameters << "\r\nFixedParameters: " << fixed << "\r\n";
    return read_transform(path);
  };
  const Eigen::Vector3d p{1, 0, 0};
  // A half turn about z at (1, 0, 0) leaves that point where it is.
  EXPECT_LT((read("-1 0 0 0 -1 0 0 0 1 0 0 0", "1 0 0") * p - p).norm(), 1e-12);
  EXPECT_THROW((void)read("1 0 0 0 1 0 0 0 1 0 0", "0 0 0"), InputError);
  EXPECT_THROW((void)read("1 0 0 0 1 0 0 0 1.01 0 0 0", "0 0 0"), InputError);
  EXPECT_THROW((void)read("-1 0 0 0 1 0 0 0 1 0 0 0", "0 0 0"), InputError);
  EXPECT_THROW((void)read("1 0 0 0 1 0 0 0 1 0 nan 0", "0 0 0"), InputError);
  std::ofstream{path} << "nothing\n";
  EXPECT_THROW((void)read_transform(path), InputError);
  EXPECT_THROW((void)read_transform(path + ".missing"), InputError);
}

}  // namespace
}  // namespace holdfast::registration
