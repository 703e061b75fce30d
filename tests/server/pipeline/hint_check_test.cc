#include "server/pipeline/hint_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace horopter {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

// Cameras that images know with these deviations, as they have adjusted them.
struct Images {
  double log_focal = 0.005;
  double center_px = 4.0;
  double k1 = 0.01;
};

CameraEvidence EvidenceOf(const std::vector<PinholeCamera>& cameras, const Images& images) {
  CameraEvidence evidence;
  const auto n = static_cast<Eigen::Index>(cameras.size());
  evidence.information = Eigen::MatrixXd::Zero(kGroupParameters * n, kGroupParameters * n);
  evidence.vector = Eigen::VectorXd::Zero(kGroupParameters * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    evidence.group.views.push_back(static_cast<int>(i));
    evidence.group.cameras.push_back(cameras[static_cast<size_t>(i)]);
    evidence.group.camera_from_anchor.emplace_back();
    Eigen::Vector4d sigmas(images.log_focal, images.center_px, images.center_px, images.k1);
    evidence.information.diagonal().segment<4>(kGroupParameters * i + 6) =
        sigmas.cwiseAbs2().cwiseInverse();
  }
  return evidence;
}

std::vector<PinholeCamera> Cameras(int n) {
  std::vector<PinholeCamera> cameras(static_cast<size_t>(n), CenteredCamera(640, 480, 980.0));
  return cameras;
}

CameraHint Focal(double focal_px) {
  CameraHint hint;
  hint.focal_px = focal_px;
  return hint;
}

TEST(HintTest, RightHintsAgreeWhateverTheNoise) {
  std::mt19937 rng(7);
  std::normal_distribution<double> normal;
  int alarms = 0;
  for (int k = 0; k < 300; ++k) {
    std::vector<PinholeCamera> cameras = Cameras(4);
    std::vector<CameraHint> hints;
    for (PinholeCamera& camera : cameras) {
      CameraHint hint = Focal(camera.focal_px * std::exp(0.02 * normal(rng)));
      hint.focal_log_sigma = 0.02;
      hint.principal_point = Eigen::Vector2d(camera.cx + normal(rng), camera.cy + normal(rng));
      hint.k1 = 0.002 * normal(rng);
      hints.push_back(hint);
      camera.focal_px *= std::exp(0.005 * normal(rng));
      camera.cx += 4.0 * normal(rng);
      camera.cy += 4.0 * normal(rng);
      camera.k1 += 0.01 * normal(rng);
    }
    alarms += !TestHints(hints, EvidenceOf(cameras, {})).agrees;
  }
  EXPECT_EQ(alarms, 0);
}

TEST(HintTest, TheImageWhoseHintIsWrongIsNamed) {
  std::vector<CameraHint> hints(3, Focal(980.0));
  EXPECT_TRUE(TestHints(hints, EvidenceOf(Cameras(3), {})).agrees);
  for (const double factor : {0.5, 0.8, 1.2, 2.0}) {
    hints[1] = Focal(factor * 980.0);
    const HintTest test = TestHints(hints, EvidenceOf(Cameras(3), {}));
    EXPECT_FALSE(test.agrees) << factor;
    EXPECT_THAT(test.images, ElementsAre(1)) << factor;
    EXPECT_GT(test.squared, test.limit);
  }
  hints[1] = Focal(980.0);
  hints[2].principal_point = Eigen::Vector2d(419.5, 239.5);
  EXPECT_THAT(TestHints(hints, EvidenceOf(Cameras(3), {})).images, ElementsAre(2));
  hints[2].principal_point.reset();
  hints[0].k1 = 0.5;
  EXPECT_THAT(TestHints(hints, EvidenceOf(Cameras(3), {})).images, ElementsAre(0));
}

// One file for all images: each image alone says too little.
TEST(HintTest, ManyImagesSayTogetherWhatNoneSaysAlone) {
  const Images images{0.022, 4.0, 0.01};
  EXPECT_TRUE(
      TestHints(std::vector<CameraHint>(1, Focal(1.1 * 980.0)), EvidenceOf(Cameras(1), images))
          .agrees);
  const HintTest together =
      TestHints(std::vector<CameraHint>(6, Focal(1.1 * 980.0)), EvidenceOf(Cameras(6), images));
  EXPECT_FALSE(together.agrees);
  EXPECT_THAT(together.images, IsEmpty());
}

// A calibration that does not say how good it is should be within one per cent or so.
TEST(HintTest, OneFileThatIsFivePerCentOffIsFoundWhereNothingElseIsStated) {
  const Images images{0.012, 4.0, 0.01};
  const CameraEvidence evidence = EvidenceOf(Cameras(4), images);
  for (const double factor : {1.0, 1.01, 0.98}) {
    const std::vector<CameraHint> hints(4, Focal(factor * 980.0));
    EXPECT_TRUE(TestHints(hints, evidence).agrees) << factor;
  }
  for (const double factor : {1.05, 0.95}) {
    std::vector<CameraHint> hints(4, Focal(factor * 980.0));
    EXPECT_FALSE(TestHints(hints, evidence).agrees) << factor;
    for (CameraHint& hint : hints) hint.focal_log_sigma = 0.03;
    EXPECT_TRUE(TestHints(hints, evidence).agrees) << factor;
    const auto common = CommonFocalFactor(hints, evidence);
    ASSERT_TRUE(common);
    EXPECT_NEAR(common->log, -std::log(factor), 1e-4);
    EXPECT_NEAR(common->sigma, 0.012, 1e-3);  // 0.012 / sqrt(4), twice as unsure as it says
  }
  EXPECT_FALSE(CommonFocalFactor(std::vector<CameraHint>(4), evidence));
  EXPECT_FALSE(CommonFocalFactor(std::vector<CameraHint>(4, Focal(980.0)), {}));
}

// Images that were cut without a word: none of them is sure of its centre, all of them are.
TEST(HintTest, ACentreThatIsOffInAllImagesIsFound) {
  const CameraEvidence evidence = EvidenceOf(Cameras(5), {0.03, 30.0, 0.05});
  for (const double shift_px : {0.0, 10.0, 100.0}) {
    CameraHint hint = Focal(980.0);
    hint.principal_point = Eigen::Vector2d(319.5 + shift_px, 239.5);
    const std::vector<CameraHint> hints(5, hint);
    EXPECT_EQ(TestHints(hints, evidence).agrees, shift_px < 50.0) << shift_px;
  }
}

TEST(HintTest, WhereImagesSayNothingEveryHintAgrees) {
  const std::vector<CameraHint> hints(2, Focal(5000.0));
  EXPECT_TRUE(TestHints(hints, {}).agrees);
  CameraEvidence silent = EvidenceOf(Cameras(2), {});
  silent.information.setZero();
  EXPECT_TRUE(TestHints(hints, silent).agrees);
  // Nothing is claimed, or by a file.
  std::vector<CameraHint> presumed = hints;
  for (CameraHint& hint : presumed) hint.presumed = true;
  EXPECT_TRUE(TestHints(presumed, EvidenceOf(Cameras(2), {})).agrees);
  EXPECT_TRUE(TestHints(std::vector<CameraHint>(2), EvidenceOf(Cameras(2), {})).agrees);
}

TEST(HintTest, AClaimIsWhatTheCallerSays) {
  SceneRequest request;
  request.hints = {Focal(900.0), Focal(900.0), {}};
  request.hints[1].presumed = true;
  request.hints[2].k1 = 0.1;
  request.hints[2].principal_point = Eigen::Vector2d(1.0, 2.0);
  EXPECT_TRUE(HasClaims(request.hints));
  const SceneRequest bare = WithoutClaims(request);
  EXPECT_FALSE(HasClaims(bare.hints));
  EXPECT_FALSE(bare.hints[0].focal_px);
  EXPECT_EQ(bare.hints[1].focal_px, 900.0);
  EXPECT_FALSE(bare.hints[2].k1 || bare.hints[2].principal_point);
}

TEST(HintTest, AContradictedAnswerStatesNoCertainty) {
  SceneAnswer answer;
  answer.objects.resize(2);
  answer.objects[0].score = 0.99;
  answer.objects[1].score = 0.2;
  std::vector<std::optional<PosedCamera>> cameras(2);
  cameras[0].emplace();
  cameras[0]->camera = CenteredCamera(640, 480, 980.0);
  HintTest test;
  test.agrees = false;
  test.images = {0, 1};  // the second was not recovered
  TellContradictedHints(std::vector<CameraHint>(2, Focal(500.0)), test, cameras, &answer);
  EXPECT_TRUE(HasReason(answer, ReasonKind::kHintContradicted));
  EXPECT_EQ(answer.objects[0].score, 0.5);
  EXPECT_EQ(answer.objects[1].score, 0.2);
  ASSERT_EQ(answer.contradicted_hints.size(), 1u);
  EXPECT_EQ(answer.contradicted_hints[0].image, 0);
  EXPECT_EQ(answer.contradicted_hints[0].focal_px, 980.0);
}

}  // namespace
}  // namespace horopter
