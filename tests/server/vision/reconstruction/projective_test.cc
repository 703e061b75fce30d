// Projective reconstruction end to end, its covariance and its refusals.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/reconstruction/grow_projective.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

ProjectiveResult Reconstruct(const MultiviewTracks& tracks, const GrowOptions& options = {}) {
  const auto result = ReconstructProjective(tracks, options);
  EXPECT_TRUE(result.ok()) << result.status();
  return result.ok() ? *result : ProjectiveResult();
}

// What holds of every result: numbers are finite, a refusal says why.
void ExpectSane(const ProjectiveResult& r) {
  EXPECT_EQ(r.outcome == ProjectiveOutcome::kReconstructed, r.reason.empty()) << r.reason;
  for (const auto& P : r.scene.cameras) EXPECT_TRUE(!P || P->allFinite());
  for (const auto& X : r.scene.points) EXPECT_TRUE(!X || X->allFinite());
  for (const auto& L : r.scene.lines) {
    if (!L) continue;
    EXPECT_TRUE(L->allFinite());
    EXPECT_NEAR(L->head<3>().dot(L->tail<3>()), 0.0, 1e-9);
  }
  EXPECT_TRUE(std::isfinite(r.summary.rms_px));
}

int Registered(const ProjectiveResult& r) {
  return static_cast<int>(std::count_if(
      r.scene.cameras.begin(), r.scene.cameras.end(), [](const auto& P) { return P.has_value(); }));
}

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

class NoiseTest : public testing::TestWithParam<double> {};

TEST_P(NoiseTest, ErrorGrowsInProportionToTheNoise) {
  const double sigma = GetParam();
  std::vector<double> errors, rms;
  for (unsigned seed = 1; seed <= 8; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, sigma, 0.2});
    const ProjectiveResult r = Reconstruct(truth.tracks);
    ExpectSane(r);
    ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed) << r.reason;
    EXPECT_EQ(Registered(r), 6);
    errors.push_back(CompareWithTruth(truth, r.scene).rms_m);
    rms.push_back(r.summary.rms_px);
  }
  EXPECT_LT(Median(errors), 1.6e-3 * sigma);  // 0.8 mm at 0.5 px
  EXPECT_LT(Median(rms), 0.85 * sigma);
}
INSTANTIATE_TEST_SUITE_P(Sweep, NoiseTest, testing::Values(0.05, 0.3, 0.5, 1.0));

TEST(Projective, GrossOutliersAreFoundAndCostLittle) {
  std::vector<double> errors, clean;
  int missed = 0, outliers = 0, lost = 0, inliers = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.2, 0.05});
    const ProjectiveResult r = Reconstruct(truth.tracks);
    ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed) << r.reason;
    errors.push_back(CompareWithTruth(truth, r.scene).rms_m);
    // The same noise without the outliers.
    const SyntheticTracks same = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.2, 0.0});
    clean.push_back(CompareWithTruth(same, Reconstruct(same.tracks).scene).rms_m);
    for (size_t k = 0; k < truth.point_outlier.size(); ++k) {
      outliers += truth.point_outlier[k];
      inliers += !truth.point_outlier[k];
      missed += truth.point_outlier[k] && r.scene.point_inlier[k];
      lost += !truth.point_outlier[k] && !r.scene.point_inlier[k];
    }
  }
  EXPECT_LT(Median(errors), 1.2 * Median(clean));
  EXPECT_LT(missed, 0.02 * outliers);
  EXPECT_LT(lost, 0.02 * inliers);
}

TEST(Projective, EveryStartReachesTheSameOptimum) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth =
        MakeSyntheticTracks({.seed = seed, .points = 40, .lines = 20}, {seed, 0.5, 0.1});
    std::vector<double> rms;
    for (const ProjectiveStart start : {ProjectiveStart::kFundamental,
                                        ProjectiveStart::kTrifocal,
                                        ProjectiveStart::kFactorisation}) {
      GrowOptions options;
      options.start = start;
      const ProjectiveResult r = Reconstruct(truth.tracks, options);
      ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed)
          << static_cast<int>(start) << ": " << r.reason;
      rms.push_back(r.summary.rms_px);
    }
    EXPECT_NEAR(rms[0], rms[1], 0.02);
    EXPECT_NEAR(rms[0], rms[2], 0.02);
  }
}

TEST(Projective, LinesCarryScenesThatPointsCannot) {
  std::vector<double> with_lines, without;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth =
        MakeSyntheticTracks({.seed = seed, .points = 6, .lines = 20}, {seed, 0.3, 0.0});
    const ProjectiveResult r = Reconstruct(truth.tracks);
    ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed) << r.reason;
    with_lines.push_back(CameraCollineationRms(truth, r.scene));
    // The points alone, from the best start they could have.
    MultiviewTracks points = NormalizeTracks(truth.tracks);
    points.line_observations.clear();
    ProjectiveScene scene = r.scene;
    for (size_t v = 0; v < scene.cameras.size(); ++v) {
      scene.cameras[v] =
          CameraMatrix(NormalizedFromPixels(truth.tracks.sizes[v]) * *scene.cameras[v]);
    }
    BalanceGauge(&scene);
    scene.line_inlier.clear();
    scene.point_inlier.assign(points.point_observations.size(), true);
    ASSERT_TRUE(AdjustProjective(points, {.loss = RobustLoss::kNone}, &scene).usable);
    CamerasToPixels(truth.tracks.sizes, &scene);
    without.push_back(CameraCollineationRms(truth, scene));
  }
  EXPECT_GT(Median(without), 3.0 * Median(with_lines));
}

TEST(Projective, ResultDoesNotDependOnTheOrderOfViewsOrTheRun) {
  const SyntheticTracks truth = MakeSyntheticTracks({.seed = 3}, {3, 0.5, 0.2});
  const ProjectiveResult a = Reconstruct(truth.tracks), b = Reconstruct(truth.tracks);
  // Ceres orders the eliminated blocks by address, so the last bits may differ.
  EXPECT_NEAR(a.summary.rms_px, b.summary.rms_px, 1e-9);
  MultiviewTracks reversed = truth.tracks;
  for (auto& o : reversed.point_observations) o.view = 5 - o.view;
  for (auto& o : reversed.line_observations) o.view = 5 - o.view;
  EXPECT_NEAR(Reconstruct(reversed).summary.rms_px, a.summary.rms_px, 0.01);
}

TEST(Projective, OneBadImageDoesNotSinkTheSet) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.2});
    std::vector<PointObservation>& list = truth.tracks.point_observations;
    for (size_t k = 0; k + 1 < list.size(); ++k) {
      if (list[k].view == 2 && list[k + 1].view == 2) std::swap(list[k].pixel, list[k + 1].pixel);
    }
    std::erase_if(truth.tracks.line_observations, [](const auto& o) { return o.view == 2; });
    const ProjectiveResult r = Reconstruct(truth.tracks);
    ExpectSane(r);
    ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed) << r.reason;
    EXPECT_FALSE(r.scene.cameras[2]);
    EXPECT_EQ(Registered(r), 5);
    EXPECT_LT(CompareWithTruth(truth, r.scene).rms_m, 2.5e-3);
  }
}

TEST(ProjectiveCovariance, EllipsoidsHoldTheStatedShareOfPoints) {
  int inside = 0, all = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const SyntheticTracks truth =
        MakeSyntheticTracks({.seed = seed, .points = 60, .lines = 20}, {seed, 0.3, 0.1});
    const MultiviewTracks normalized = NormalizeTracks(truth.tracks);
    ProjectiveResult r = Reconstruct(truth.tracks);
    ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed);
    const CollineationFit fit = CompareWithTruth(truth, r.scene);
    for (size_t v = 0; v < r.scene.cameras.size(); ++v) {
      r.scene.cameras[v] =
          CameraMatrix(NormalizedFromPixels(truth.tracks.sizes[v]) * *r.scene.cameras[v]);
    }
    const auto covariance = ProjectiveCovariance(normalized, r.scene);
    ASSERT_TRUE(covariance);
    EXPECT_NEAR(covariance->variance_factor, 1.0, 0.25);
    const auto ellipsoids = AlignedPointCovariances(*covariance, r.scene, fit.metric_from_scene);
    for (size_t j = 0; j < truth.points.size(); ++j) {
      if (!r.scene.points[j] || !(ellipsoids[j].trace() > 0.0)) continue;
      const Eigen::Vector4d y = fit.metric_from_scene * *r.scene.points[j];
      const Eigen::Vector3d e = y.hnormalized() - truth.points[j];
      inside += e.dot(ellipsoids[j].ldlt().solve(e)) < 7.815;
      ++all;
    }
  }
  EXPECT_GT(inside, 0.91 * all);
  EXPECT_LT(inside, 0.985 * all);
}

TEST(ProjectiveCovariance, IsTheSameInEveryGauge) {
  const SyntheticTracks truth = MakeSyntheticTracks({.seed = 5, .points = 40}, {5, 0.3, 0.1});
  ProjectiveResult r = Reconstruct(truth.tracks);
  ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed);
  const auto sizes = [&](const Eigen::Matrix4d& H) {
    ProjectiveScene moved = r.scene;
    for (auto& X : moved.points) {
      if (X) X = Eigen::Vector4d((H * *X).normalized());
    }
    for (size_t v = 0; v < moved.cameras.size(); ++v) {
      const CameraMatrix P = NormalizedFromPixels(truth.tracks.sizes[v]) * *r.scene.cameras[v] *
                             Eigen::Matrix4d(H.inverse());
      moved.cameras[v] = CameraMatrix(P / P.norm());
    }
    const auto covariance = ProjectiveCovariance(NormalizeTracks(truth.tracks), moved);
    EXPECT_TRUE(covariance);
    return AlignedPointCovariances(
        *covariance, moved, CompareWithTruth(truth, moved).metric_from_scene);
  };
  Eigen::Matrix4d H;
  H << 1, 0.2, 0, 0.1, -0.1, 0.8, 0.2, 0, 0.3, 0, 1.1, -0.2, 0.1, -0.3, 0.2, 0.9;
  const auto here = sizes(Eigen::Matrix4d::Identity()), there = sizes(H);
  for (size_t j = 0; j < here.size(); ++j) {
    EXPECT_LT((here[j] - there[j]).norm(), 0.01 * here[j].norm() + 1e-18);
  }
}

// Refusals -----------------------------------------------------------------------------------

TEST(ProjectiveRefusals, TooFewViewsOrFeatures) {
  EXPECT_EQ(Reconstruct({}).outcome, ProjectiveOutcome::kTooFewViews);
  const SyntheticTracks one = MakeSyntheticTracks({.views = 1}, {});
  EXPECT_EQ(Reconstruct(one.tracks).outcome, ProjectiveOutcome::kTooFewViews);
  const SyntheticTracks few = MakeSyntheticTracks({.points = 5, .lines = 2}, {});
  const ProjectiveResult r = Reconstruct(few.tracks);
  ExpectSane(r);
  EXPECT_EQ(r.outcome, ProjectiveOutcome::kTooFewFeatures) << r.reason;
}

TEST(ProjectiveRefusals, PlanesRotationsAndDuplicatesHaveNoParallax) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(seed);
    SyntheticTracksOptions options{.seed = seed, .points = 60, .lines = 20};
    options.planar = true;
    ProjectiveResult r = Reconstruct(MakeSyntheticTracks(options, {seed, 0.5, 0.1}).tracks);
    ExpectSane(r);
    EXPECT_EQ(r.outcome, ProjectiveOutcome::kNoParallax) << r.reason;
    options.planar = false;
    options.pure_rotation = true;
    r = Reconstruct(MakeSyntheticTracks(options, {seed, 0.5, 0.1}).tracks);
    ExpectSane(r);
    EXPECT_EQ(r.outcome, ProjectiveOutcome::kNoParallax) << r.reason;
  }
  SyntheticTracks same = MakeSyntheticTracks({.points = 60}, {1, 0.0, 0.0});
  for (auto& o : same.tracks.point_observations) {
    o.pixel = same.tracks.point_observations[o.point].pixel;
  }
  const ProjectiveResult r = Reconstruct(same.tracks);
  EXPECT_EQ(r.outcome, ProjectiveOutcome::kNoParallax);
  EXPECT_NE(r.reason.find("same"), std::string::npos) << r.reason;
}

TEST(Projective, ADuplicatedImageAddsNothingAndBreaksNothing) {
  SyntheticTracks truth = MakeSyntheticTracks({.points = 60, .lines = 20}, {1, 0.5, 0.1});
  const double error = CompareWithTruth(truth, Reconstruct(truth.tracks).scene).rms_m;
  // The third view once more, as a seventh.
  MultiviewTracks twice = truth.tracks;
  twice.sizes.push_back(twice.sizes[2]);
  for (const PointObservation& o : truth.tracks.point_observations) {
    if (o.view == 2) twice.point_observations.push_back({6, o.point, o.pixel, o.sigma_px});
  }
  for (const LineObservation& o : truth.tracks.line_observations) {
    if (o.view == 2) twice.line_observations.push_back({6, o.line, o.start, o.end, o.sigma_px});
  }
  ProjectiveResult r = Reconstruct(twice);
  ExpectSane(r);
  ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed) << r.reason;
  ASSERT_TRUE(r.scene.cameras[2] && r.scene.cameras[6]);
  const CameraMatrix& P = *r.scene.cameras[2];
  const CameraMatrix& Q = *r.scene.cameras[6];
  EXPECT_NEAR(std::abs((P.array() * Q.array()).sum()), P.norm() * Q.norm(), 1e-6);
  r.scene.cameras.pop_back();
  r.scene.point_inlier.resize(truth.tracks.point_observations.size());
  EXPECT_LT(CompareWithTruth(truth, r.scene).rms_m, 1.5 * error);
}

TEST(ProjectiveRefusals, ParallelLinesAloneDetermineNothing) {
  SyntheticTracksOptions options{.points = 0, .lines = 30};
  options.parallel_lines = true;
  for (unsigned seed = 1; seed <= 5; ++seed) {
    options.seed = seed;
    const ProjectiveResult r = Reconstruct(MakeSyntheticTracks(options, {seed, 0.5, 0.0}).tracks);
    ExpectSane(r);
    EXPECT_NE(r.outcome, ProjectiveOutcome::kReconstructed);
  }
}

TEST(ProjectiveRefusals, TracksOfOnePairGiveThatPairOnly) {
  SyntheticTracks truth = MakeSyntheticTracks({.points = 80}, {1, 0.3, 0.0});
  // Every point is seen in two views only, and no two pairs share a point.
  std::erase_if(truth.tracks.point_observations, [](const PointObservation& o) {
    const int pair = o.point % 3;
    return o.view != 2 * pair && o.view != 2 * pair + 1;
  });
  const ProjectiveResult r = Reconstruct(truth.tracks);
  ExpectSane(r);
  ASSERT_EQ(r.outcome, ProjectiveOutcome::kReconstructed) << r.reason;
  EXPECT_EQ(Registered(r), 2);
}

TEST(ProjectiveRefusals, FortyPercentWrongMatchesAreSurvivedOrRefused) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    SyntheticTrackNoise noise{seed, 0.5, 0.1, 0.4};
    noise.max_outlier_px = 200.0;
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed, .points = 80}, noise);
    const ProjectiveResult r = Reconstruct(truth.tracks);
    ExpectSane(r);
    if (r.outcome == ProjectiveOutcome::kReconstructed) {
      EXPECT_LT(CameraCollineationRms(truth, r.scene), 8e-3);
    }
  }
}

TEST(ProjectiveRefusals, RandomPixelsAreNoScene) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SyntheticTrackNoise noise{seed, 0.5, 0.0, 1.0};
    noise.max_outlier_px = 300.0;
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed, .points = 40}, noise);
    const ProjectiveResult r = Reconstruct(truth.tracks);
    ExpectSane(r);
    EXPECT_NE(r.outcome, ProjectiveOutcome::kReconstructed);
  }
}

TEST(ProjectiveErrors, BadOptionsTracksAndCancellation) {
  const SyntheticTracks truth = MakeSyntheticTracks({}, {});
  GrowOptions options;
  options.min_views = 1;
  EXPECT_EQ(ReconstructProjective(truth.tracks, options).status().code(),
            absl::StatusCode::kInvalidArgument);
  options = {};
  options.pairs.min_inliers = 3;
  EXPECT_EQ(ReconstructProjective(truth.tracks, options).status().code(),
            absl::StatusCode::kInvalidArgument);
  MultiviewTracks broken = truth.tracks;
  broken.point_observations[0].pixel.x() = std::nan("");
  EXPECT_EQ(ReconstructProjective(broken, {}).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ReconstructProjective(truth.tracks, {}, [] { return true; }).status().code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
