#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>

#include "server/vision/reconstruction/reconstruction.h"
#include "tests/support/synthetic_scene.h"

namespace horopter {
namespace {

Reconstruction Reconstruct(const SyntheticScene& scene,
                           const SyntheticMatches& matches,
                           const std::vector<ViewPrior>& priors = {}) {
  const auto r = ReconstructViews(
      matches.matching, matches.features, scene.Sizes(), priors, ReconstructionOptions());
  EXPECT_TRUE(r.ok()) << r.status();
  return r.ok() ? *r : Reconstruction();
}

int Registered(const Reconstruction& r) {
  int n = 0;
  for (const auto& v : r.views) n += v.has_value();
  return n;
}

void ExpectFinite(const Reconstruction& r) {
  for (const auto& v : r.views) {
    if (!v) continue;
    EXPECT_TRUE(std::isfinite(v->camera.focal_px) && v->camera.focal_px > 0.0);
    EXPECT_TRUE(std::isfinite(v->camera.k1));
    EXPECT_TRUE(std::isfinite(v->focal_log_sigma));
    EXPECT_TRUE(v->camera_from_scene.R.allFinite() && v->camera_from_scene.t.allFinite());
    EXPECT_NEAR(
        (v->camera_from_scene.R * v->camera_from_scene.R.transpose() - Eigen::Matrix3d::Identity())
            .norm(),
        0.0,
        1e-6);
  }
  for (const ReconstructedPoint& p : r.points) EXPECT_TRUE(p.point_in_world.allFinite());
  EXPECT_TRUE(std::isfinite(r.rms_px));
  EXPECT_EQ(r.trusted, r.refusal.empty());
}

double WorstFocalError(const SyntheticScene& scene, const Reconstruction& r) {
  double worst = 0.0;
  for (size_t i = 0; i < r.views.size(); ++i) {
    if (!r.views[i]) return 1e9;
    worst = std::max(worst,
                     std::abs(std::log(r.views[i]->camera.focal_px / scene.cameras[i].focal_px)));
  }
  return worst;
}

// Largest rotation error (radians) of the relative poses to the first view.
double WorstRotationError(const SyntheticScene& scene, const Reconstruction& r) {
  double worst = 0.0;
  for (size_t i = 1; i < r.views.size(); ++i) {
    const Eigen::Matrix3d found =
        r.views[i]->camera_from_scene.R * r.views[0]->camera_from_scene.R.transpose();
    const Eigen::Matrix3d truth =
        scene.camera_from_world[i].R * scene.camera_from_world[0].R.transpose();
    worst = std::max(worst, Eigen::AngleAxisd(found * truth.transpose()).angle());
  }
  return worst;
}

class NoiseTest : public testing::TestWithParam<double> {};

TEST_P(NoiseTest, ErrorGrowsNoFasterThanNoise) {
  const double sigma = GetParam();
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    SyntheticSceneOptions options;
    options.seed = seed;
    const SyntheticScene scene = MakeSyntheticScene(options);
    const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {seed, sigma, 0.0}));
    ExpectFinite(r);
    ASSERT_EQ(Registered(r), 5);
    // Shape: 1 % of focal length and half a degree at 0.1 px, in proportion above; k1 is free and
    // costs some of it.
    EXPECT_LT(WorstFocalError(scene, r), 0.02 + 0.15 * sigma);
    EXPECT_LT(WorstRotationError(scene, r), 0.01 + 0.05 * sigma);
    EXPECT_LT(r.rms_px, 0.1 + 1.5 * sigma);
    EXPECT_TRUE(r.trusted) << r.refusal;
    // The world's plane is z = 0, cameras and points above it.
    for (const auto& v : r.views) EXPECT_GT(v->camera_from_scene.Inverse().t.z(), 0.0);
    for (const ReconstructedPoint& p : r.points) {
      EXPECT_TRUE(p.on_plane ? std::abs(p.point_in_world.z()) < 0.02 : p.point_in_world.z() > 0.0);
    }
  }
}
INSTANTIATE_TEST_SUITE_P(Sweep, NoiseTest, testing::Values(0.02, 0.1, 0.3, 0.6));

TEST(ReconstructViews, SaysHowManyMatchesEachCameraRestsOn) {
  SyntheticSceneOptions options;
  options.seed = 3;
  const SyntheticScene scene = MakeSyntheticScene(options);
  const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {3, 0.3, 0.0}));
  ASSERT_EQ(r.view_matches.size(), 5u);
  for (int v = 0; v < 5; ++v) {
    int seen = 0;
    for (const ReconstructedPoint& p : r.points) {
      for (const auto& [view, junction] : p.observations) seen += view == v ? 1 : 0;
    }
    EXPECT_EQ(r.view_matches[v].matches, seen);
    EXPECT_GT(seen, 50);
    EXPECT_EQ(r.view_matches[v].source, MatchSource::kTexture);  // most are of the plane
    EXPECT_GT(r.view_matches[v].rms_px, 0.1);
    EXPECT_LT(r.view_matches[v].rms_px, 0.7);
  }
}

TEST(CountViewMatches, CountsCornersOfAViewAndTheirResiduals) {
  std::vector<std::optional<CalibratedView>> views(2);
  CalibratedView view;
  view.camera = CenteredCamera(640, 480, 800.0);
  view.camera_from_scene.t = {0.0, 0.0, 1.0};
  views[0] = view;
  std::vector<ImageFeatures> features(2);
  const Eigen::Vector2d middle(319.5, 239.5);
  features[0].junctions.resize(2);
  features[0].junctions[0].point = middle + Eigen::Vector2d(3.0, 0.0);
  features[0].junctions[1].point = middle + Eigen::Vector2d(0.0, 4.0);
  features[1].junctions.resize(1);
  std::vector<ReconstructedPoint> points(2);  // both at the origin
  points[0].observations = {{0, 0}, {1, 0}};
  points[1].observations = {{0, 1}};
  const auto found = CountViewMatches(points, views, features, 9.0);
  EXPECT_EQ(found[0].source, MatchSource::kFeatures);
  EXPECT_EQ(found[0].matches, 2);
  EXPECT_NEAR(found[0].rms_px, std::sqrt(0.5 * (9.0 + 16.0)), 1e-9);
  EXPECT_EQ(found[1].source, MatchSource::kNone);  // without a camera nothing agrees
  EXPECT_EQ(found[1].matches, 0);
}

TEST(ReconstructViews, FocalErrorsStayWithinTheirPredictedDeviations) {
  double squared = 0.0;
  int n = 0;
  for (unsigned seed = 11; seed <= 20; ++seed) {
    SyntheticSceneOptions options;
    options.seed = seed;
    const SyntheticScene scene = MakeSyntheticScene(options);
    const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {seed, 0.4, 0.0}));
    ASSERT_EQ(Registered(r), 5) << "seed " << seed;
    for (size_t i = 0; i < r.views.size(); ++i) {
      const double e = std::log(r.views[i]->camera.focal_px / scene.cameras[i].focal_px);
      squared += e * e / (r.views[i]->focal_log_sigma * r.views[i]->focal_log_sigma);
      ++n;
    }
  }
  EXPECT_LT(std::sqrt(squared / n), 1.5);
}

// Principal points uniform within 2 % of the width, each view its own.
SyntheticScene WithPrincipalPointsOff(unsigned seed) {
  SyntheticSceneOptions options;
  options.seed = seed;
  SyntheticScene scene = MakeSyntheticScene(options);
  std::mt19937 rng(seed);
  const auto off = [&](double share) {
    return share * scene.cameras[0].width * (static_cast<double>(rng()) / 2147483648.0 - 1.0);
  };
  for (PinholeCamera& camera : scene.cameras) {
    camera.cx += off(0.02);
    camera.cy += off(0.015);
  }
  return scene;
}

TEST(ReconstructViews, DeviationsHoldWithUnknownPrincipalPoints) {
  double squared = 0.0;
  int n = 0;
  for (unsigned seed = 31; seed <= 42; ++seed) {
    const SyntheticScene scene = WithPrincipalPointsOff(seed);
    const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {seed, 0.1, 0.0}));
    ASSERT_EQ(Registered(r), 5) << "seed " << seed;
    for (size_t i = 0; i < r.views.size(); ++i) {
      const double e = std::log(r.views[i]->camera.focal_px / scene.cameras[i].focal_px) /
                       r.views[i]->focal_log_sigma;
      squared += e * e;
      ++n;
    }
  }
  const double ratio = std::sqrt(squared / n);
  RecordProperty("error_per_sigma", std::to_string(ratio));
  EXPECT_LT(ratio, 1.4);
  EXPECT_GT(ratio, 0.4);  // nor are they stated so wide that they say nothing
}

TEST(ReconstructViews, HintsEnterAsPriors) {
  double without = 0.0, with = 0.0;
  for (unsigned seed = 31; seed <= 34; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const SyntheticScene scene = WithPrincipalPointsOff(seed);
    const SyntheticMatches matches = MatchSyntheticScene(scene, {seed, 0.1, 0.0});
    std::vector<ViewPrior> priors(5);
    for (size_t v = 0; v < 5; ++v) {
      priors[v].principal_point_px = Eigen::Vector2d(scene.cameras[v].cx, scene.cameras[v].cy);
    }
    priors[2].focal_px = scene.cameras[2].focal_px;
    priors[2].focal_log_sigma = 0.001;
    const Reconstruction blind = Reconstruct(scene, matches);
    const Reconstruction told = Reconstruct(scene, matches, priors);
    ExpectFinite(told);
    ASSERT_EQ(Registered(told), 5);
    without += WorstFocalError(scene, blind);
    with += WorstFocalError(scene, told);
    EXPECT_NEAR(std::log(told.views[2]->camera.focal_px / scene.cameras[2].focal_px), 0.0, 0.005);
    EXPECT_EQ(told.views[1]->camera.cx, scene.cameras[1].cx);
    // The frame is common: what is known of one camera narrows the others.
    EXPECT_LT(told.views[1]->focal_log_sigma, blind.views[1]->focal_log_sigma);
  }
  EXPECT_LT(with, 0.5 * without);
}

TEST(ReconstructViews, AWrongHintIsContradictedByItsDeviation) {
  // A hint of 30 % too much with 30 % deviation gives way, one with 0.1 % does not.
  const SyntheticScene scene = MakeSyntheticScene({});
  const SyntheticMatches matches = MatchSyntheticScene(scene, {1, 0.1, 0.0});
  std::vector<ViewPrior> priors(5);
  priors[0].focal_px = 1.3 * scene.cameras[0].focal_px;
  priors[0].focal_log_sigma = 0.3;
  const Reconstruction loose = Reconstruct(scene, matches, priors);
  ASSERT_EQ(Registered(loose), 5);
  EXPECT_LT(WorstFocalError(scene, loose), 0.05);
  priors[0].focal_log_sigma = 0.001;
  const Reconstruction tight = Reconstruct(scene, matches, priors);
  ExpectFinite(tight);
}

TEST(ReconstructViews, SurvivesFortyPercentWrongJunctionMatches) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    SyntheticSceneOptions options;
    options.seed = seed;
    options.off_plane_points = 60;
    const SyntheticScene scene = MakeSyntheticScene(options);
    const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {seed, 0.3, 0.4}));
    ExpectFinite(r);
    ASSERT_EQ(Registered(r), 5);
    EXPECT_LT(WorstFocalError(scene, r), 0.12);
    EXPECT_LT(r.rms_px, 1.0);
  }
}

// The plane's matches of one view are rubbish; few of its observations agree with the rest.
TEST(ReconstructViews, AViewWithWrongPlaneMatchesStaysWithinItsDeviation) {
  constexpr int kBad = 2;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    SyntheticSceneOptions options;
    options.seed = seed;
    const SyntheticScene scene = MakeSyntheticScene(options);
    SyntheticMatches matches = MatchSyntheticScene(scene, {seed, 0.3, 0.0});
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> off(-40.0, 40.0);
    for (PlaneHomography& plane : matches.matching.planes) {
      for (auto [view, points] :
           {std::pair(plane.view_a, &plane.inliers_a), std::pair(plane.view_b, &plane.inliers_b)}) {
        if (view != kBad) continue;
        for (Eigen::Vector2d& p : *points) p += Eigen::Vector2d(off(rng), off(rng));
      }
    }
    const Reconstruction r = Reconstruct(scene, matches);
    ExpectFinite(r);
    ASSERT_TRUE(r.views[kBad].has_value());
    const double error = std::log(r.views[kBad]->camera.focal_px / scene.cameras[kBad].focal_px);
    EXPECT_LT(std::abs(error), 3.0 * r.views[kBad]->focal_log_sigma);
  }
}

TEST(ReconstructViews, PlanarSceneIsNotTrusted) {
  SyntheticSceneOptions options;
  options.off_plane_points = 0;
  const SyntheticScene scene = MakeSyntheticScene(options);
  const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {1, 0.3, 0.0}));
  ExpectFinite(r);
  EXPECT_FALSE(r.trusted);
  EXPECT_THAT(r.refusal, testing::HasSubstr("0 points off the plane"));
}

TEST(ReconstructViews, TwoViewsGiveCamerasButNoTrustWithoutEvidence) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SyntheticSceneOptions options;
    options.seed = seed;
    options.views = 2;
    options.arc_rad = 0.25;
    options.off_plane_points = 10;
    const SyntheticScene scene = MakeSyntheticScene(options);
    const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {seed, 0.5, 0.0}));
    ExpectFinite(r);
    // Either it knows, and then it is right, or it says that it does not.
    if (r.trusted) {
      EXPECT_LT(WorstFocalError(scene, r), 0.25) << "seed " << seed;
    }
  }
}

TEST(ReconstructViews, PureRotationIsRefusedWithNumbers) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SyntheticSceneOptions options;
    options.seed = seed;
    options.pure_rotation = true;
    const SyntheticScene scene = MakeSyntheticScene(options);
    const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {seed, 0.2, 0.0}));
    ExpectFinite(r);
    EXPECT_FALSE(r.trusted) << "seed " << seed;
    EXPECT_THAT(r.refusal, testing::ContainsRegex("[0-9]"));
  }
}

TEST(ReconstructViews, DuplicatedViewAddsNothingAndBreaksNothing) {
  SyntheticSceneOptions options;
  SyntheticScene scene = MakeSyntheticScene(options);
  scene.cameras[1] = scene.cameras[0];
  scene.camera_from_world[1] = scene.camera_from_world[0];
  const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {1, 0.3, 0.0}));
  ExpectFinite(r);
  ASSERT_EQ(Registered(r), 5);
  EXPECT_LT((r.views[0]->camera_from_scene.Inverse().t - r.views[1]->camera_from_scene.Inverse().t)
                .norm(),
            0.02);
}

TEST(ReconstructViews, AllViewsIdenticalHaveNoParallax) {
  SyntheticScene scene = MakeSyntheticScene({});
  for (size_t i = 1; i < scene.cameras.size(); ++i) {
    scene.cameras[i] = scene.cameras[0];
    scene.camera_from_world[i] = scene.camera_from_world[0];
  }
  const Reconstruction r = Reconstruct(scene, MatchSyntheticScene(scene, {1, 0.2, 0.0}));
  ExpectFinite(r);
  EXPECT_FALSE(r.trusted);
  EXPECT_EQ(Registered(r), 0);
  EXPECT_THAT(r.refusal, testing::HasSubstr("no parallax"));
}

TEST(ReconstructViews, SameInputGivesTheSameBytes) {
  const SyntheticScene scene = MakeSyntheticScene({});
  const SyntheticMatches matches = MatchSyntheticScene(scene, {3, 0.4, 0.2});
  const Reconstruction a = Reconstruct(scene, matches), b = Reconstruct(scene, matches);
  ASSERT_EQ(a.points.size(), b.points.size());
  for (size_t i = 0; i < a.views.size(); ++i)
    EXPECT_EQ(a.views[i]->camera.focal_px, b.views[i]->camera.focal_px);
}

TEST(ReconstructViews, UnlinkedViewsAreARefusalNotAnError) {
  MatchingResult matching;
  matching.component = {-1, -1};
  matching.view_from_plane.assign(2, Eigen::Matrix3d::Identity());
  const std::vector<ImageFeatures> features(2);
  const std::vector<ImageSize> sizes(2, {640, 480});
  const auto r = ReconstructViews(matching, features, sizes, {}, ReconstructionOptions());
  ASSERT_TRUE(r.ok());
  EXPECT_FALSE(r->trusted);
  EXPECT_THAT(r->refusal, testing::HasSubstr("0 views"));
}

TEST(ReconstructViews, SingularHomographiesAreARefusal) {
  const SyntheticScene scene = MakeSyntheticScene({});
  SyntheticMatches matches = MatchSyntheticScene(scene, {1, 0.3, 0.0});
  for (Eigen::Matrix3d& H : matches.matching.view_from_plane) H.setZero();
  ExpectFinite(Reconstruct(scene, matches));
  for (Eigen::Matrix3d& H : matches.matching.view_from_plane)
    H.setConstant(std::numeric_limits<double>::quiet_NaN());
  ExpectFinite(Reconstruct(scene, matches));
}

TEST(ReconstructViews, BadInputNamesTheOffender) {
  const SyntheticScene scene = MakeSyntheticScene({});
  const SyntheticMatches matches = MatchSyntheticScene(scene, {1, 0.3, 0.0});
  std::vector<ImageSize> sizes = scene.Sizes();
  sizes.pop_back();
  const auto few =
      ReconstructViews(matches.matching, matches.features, sizes, {}, ReconstructionOptions());
  EXPECT_EQ(few.status().code(), absl::StatusCode::kInvalidArgument);
  sizes = scene.Sizes();
  sizes[2].width = 0;
  const auto empty =
      ReconstructViews(matches.matching, matches.features, sizes, {}, ReconstructionOptions());
  EXPECT_EQ(empty.status().code(), absl::StatusCode::kInvalidArgument);
  const auto with_priors = [&](const std::vector<ViewPrior>& priors) {
    return ReconstructViews(
        matches.matching, matches.features, scene.Sizes(), priors, ReconstructionOptions());
  };
  EXPECT_EQ(with_priors(std::vector<ViewPrior>(3)).status().code(),
            absl::StatusCode::kInvalidArgument);
  for (int fault = 0; fault < 6; ++fault) {
    std::vector<ViewPrior> priors(5);
    if (fault == 0) priors[3].focal_px = -800.0;
    if (fault == 1) priors[3].focal_log_sigma = 0.0;
    if (fault == 2) priors[3].k1 = std::numeric_limits<double>::quiet_NaN();
    if (fault == 3) priors[3].principal_point_px = Eigen::Vector2d(320.0, INFINITY);
    if (fault == 4) priors[3].principal_point_sigma_px = -1.0;
    if (fault == 5) {  // a reflection
      priors[3].camera_from_world.emplace();
      priors[3].camera_from_world->R.col(0) *= -1.0;
    }
    const auto refused = with_priors(priors);
    EXPECT_EQ(refused.status().code(), absl::StatusCode::kInvalidArgument) << fault;
    EXPECT_NE(std::string(refused.status().message()).find("priors[3]"), std::string::npos);
  }
  const auto cancelled = ReconstructViews(
      matches.matching, matches.features, scene.Sizes(), {}, ReconstructionOptions(), [] {
        return true;
      });
  EXPECT_EQ(cancelled.status().code(), absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
