// Quasi-affine frames and the metric upgrade, against synthetic truth.
#include "server/vision/reconstruction/self_calibration.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/reconstruction/calibration_starts.h"
#include "server/vision/reconstruction/chirality.h"
#include "tests/server/vision/reconstruction/metric_checks.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

TracksResult Reconstruct(const SyntheticTracks& truth,
                         const std::vector<ViewPrior>& priors = {},
                         const SelfCalibrationOptions& options = {}) {
  const auto r = ReconstructTracks(truth.tracks, priors, {}, options);
  EXPECT_TRUE(r.ok()) << r.status();
  return r.ok() ? *r : TracksResult();
}

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

// Similarity to the truth (metres) by Umeyama; rms distance of the points.
double SimilarityRms(const SyntheticTracks& truth, const MetricResult& r) {
  std::vector<Eigen::Vector3d> a, b;
  for (size_t j = 0; j < truth.points.size(); ++j) {
    if (!r.scene.points[j]) continue;
    a.push_back(*r.scene.points[j]);
    b.push_back(truth.points[j]);
  }
  Eigen::Matrix3Xd A(3, a.size()), B(3, b.size());
  for (size_t k = 0; k < a.size(); ++k) {
    A.col(static_cast<Eigen::Index>(k)) = a[k];
    B.col(static_cast<Eigen::Index>(k)) = b[k];
  }
  const Eigen::Matrix4d T = Eigen::umeyama(A, B, true);
  const Eigen::Matrix3Xd D =
      ((T.topLeftCorner<3, 3>() * A).colwise() + T.topRightCorner<3, 1>()) - B;
  return std::sqrt(D.squaredNorm() / static_cast<double>(a.size()));
}

TEST(QuasiAffine, NoSceneIsCutByThePlaneAtInfinity) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.2});
    const auto projective = ReconstructProjective(truth.tracks, {});
    ASSERT_TRUE(projective.ok());
    const auto frame = FindQuasiAffineFrame(truth.tracks, projective->scene);
    ASSERT_TRUE(frame);
    EXPECT_GT(frame->margin, 0.0);
    const ProjectiveScene scene = MapScene(frame->H, projective->scene);
    for (size_t k = 0; k < truth.tracks.point_observations.size(); ++k) {
      const PointObservation& o = truth.tracks.point_observations[k];
      if (!scene.point_inlier[k] || !scene.cameras[o.view] || !scene.points[o.point]) continue;
      ASSERT_TRUE(frame->camera_consistent[o.view]);
      ASSERT_TRUE(frame->point_consistent[o.point]);
      EXPECT_GT(SignedDepth(*scene.cameras[o.view], *scene.points[o.point]), 0.0);
    }
    // The true scene and this one are joined by an affinity-like map: between stays between.
    const CollineationFit fit = CompareWithTruth(truth, scene);
    int positive = 0, all = 0;
    for (const auto& X : scene.points) {
      if (!X) continue;
      positive += (fit.metric_from_scene.row(3).dot(*X) > 0.0) == (X->w() > 0.0);
      ++all;
    }
    EXPECT_TRUE(positive == 0 || positive == all) << positive << " of " << all;
  }
}

TEST(PlaneAtInfinity, IsExactForTwoKnownCameras) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed, .views = 2}, {});
    const Eigen::Matrix3d Ka = truth.cameras[0].K(), Kb = truth.cameras[1].K();
    // An arbitrary projective frame in which the first camera is [I | 0].
    Eigen::Matrix4d G = CanonicalFrame(truth.TrueCamera(0));
    const auto v = PlaneAtInfinity(truth.TrueCamera(1) * G, Ka, Kb);
    ASSERT_TRUE(v);
    Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
    H.topLeftCorner<3, 3>() = Ka;
    H.bottomLeftCorner<1, 3>() = v->transpose();
    const Eigen::Matrix3d M = Kb.inverse() * (truth.TrueCamera(1) * G * H).leftCols<3>();
    const Eigen::Matrix3d R = M / std::cbrt(M.determinant());
    EXPECT_LT((R * R.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-6);
  }
}

TEST(SelfCalibration, FindsFocalLengthsAndShapeFromThreeParts) {
  std::vector<double> focal, shape;
  double squared = 0.0;
  int n = 0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.2});
    const TracksResult r = Reconstruct(truth);
    ExpectSane(r.metric);
    ASSERT_EQ(r.metric.outcome, MetricOutcome::kMetric) << r.metric.reason;
    const std::vector<double> errors = FocalErrors(truth, r.metric);
    for (size_t v = 0; v < errors.size(); ++v) {
      focal.push_back(std::abs(errors[v]));
      squared += std::pow(errors[v] / r.metric.scene.views[v]->focal_log_sigma, 2.0);
      ++n;
    }
    shape.push_back(SimilarityRms(truth, r.metric));
  }
  EXPECT_LT(Median(focal), 0.025);
  EXPECT_LT(Median(shape), 3e-3);
  // Stated deviations are those of the errors.
  EXPECT_LT(std::sqrt(squared / n), 1.6);
  EXPECT_GT(std::sqrt(squared / n), 0.6);
}

TEST(SelfCalibration, TwoViewsRotationsAndLongLensesAreRefusedAndKeepTheProjectiveScene) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks two = MakeSyntheticTracks({.seed = seed, .views = 2}, {seed, 0.5, 0.0});
    TracksResult r = Reconstruct(two);
    ExpectSane(r.metric);
    ASSERT_EQ(r.projective.outcome, ProjectiveOutcome::kReconstructed) << r.projective.reason;
    EXPECT_NE(r.metric.outcome, MetricOutcome::kMetric);
    SyntheticTracksOptions tele{.seed = seed, .parts = 1};
    tele.min_focal_px = 2200.0;
    tele.max_focal_px = 3000.0;
    tele.distance_m = 2.0;
    r = Reconstruct(MakeSyntheticTracks(tele, {seed, 0.5, 0.2}));
    ExpectSane(r.metric);
    EXPECT_NE(r.metric.outcome, MetricOutcome::kMetric);
    EXPECT_FALSE(r.metric.reason.empty());
    SyntheticTracksOptions rotation{.seed = seed};
    rotation.pure_rotation = true;
    r = Reconstruct(MakeSyntheticTracks(rotation, {seed, 0.5, 0.2}));
    ExpectSane(r.metric);
    EXPECT_NE(r.metric.outcome, MetricOutcome::kMetric);
  }
}

TEST(SelfCalibration, AMirroredImageIsLeftOutAndNamed) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.1});
    for (auto& o : truth.tracks.point_observations) {
      if (o.view == 3) o.pixel.x() = 639.0 - o.pixel.x();
    }
    for (auto& o : truth.tracks.line_observations) {
      if (o.view != 3) continue;
      o.start.x() = 639.0 - o.start.x();
      o.end.x() = 639.0 - o.end.x();
    }
    const TracksResult r = Reconstruct(truth);
    ExpectSane(r.metric);
    ASSERT_EQ(r.projective.outcome, ProjectiveOutcome::kReconstructed) << r.projective.reason;
    for (int v = 0; v < 6; ++v) EXPECT_EQ(r.metric.mirrored[v], v == 3);
    EXPECT_FALSE(r.metric.scene.views[3]);
    if (r.metric.outcome == MetricOutcome::kMetric) {
      truth.cameras[3] = CenteredCamera(640, 480, 1000.0);  // not in the result
      EXPECT_LT(SimilarityRms(truth, r.metric), 0.01);
    }
  }
}

TEST(SelfCalibration, HintsEnterAsPriors) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    // Two views: hopeless without a hint, metric with one.
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed, .views = 2}, {seed, 0.3, 0.0});
    std::vector<ViewPrior> priors(2);
    for (int v = 0; v < 2; ++v) {
      priors[v].focal_px = truth.cameras[v].focal_px;
      priors[v].focal_log_sigma = 0.01;
      priors[v].principal_point_px = Eigen::Vector2d(truth.cameras[v].cx, truth.cameras[v].cy);
    }
    TracksResult r = Reconstruct(truth, priors);
    ExpectSane(r.metric);
    ASSERT_EQ(r.metric.outcome, MetricOutcome::kMetric) << r.metric.reason;
    for (const double e : FocalErrors(truth, r.metric)) EXPECT_LT(std::abs(e), 0.03);
    // Poses fix the world and its scale.
    const SyntheticTracks posed = MakeSyntheticTracks({.seed = seed}, {seed, 0.3, 0.2});
    std::vector<ViewPrior> poses(6);
    for (int v = 0; v < 6; ++v) poses[v].camera_from_world = posed.camera_from_world[v];
    r = Reconstruct(posed, poses);
    ASSERT_EQ(r.metric.outcome, MetricOutcome::kMetric) << r.metric.reason;
    double squared = 0.0;
    int n = 0;
    for (size_t j = 0; j < posed.points.size(); ++j) {
      if (!r.metric.scene.points[j]) continue;
      squared += (*r.metric.scene.points[j] - posed.points[j]).squaredNorm();
      ++n;
    }
    EXPECT_LT(std::sqrt(squared / n), 8e-3);
  }
}

TEST(SelfCalibration, RadialDistortionIsAnOptionalUnknown) {
  std::vector<double> errors;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SyntheticTracksOptions options{.seed = seed, .views = 8};
    options.k1 = -0.15;
    const SyntheticTracks truth = MakeSyntheticTracks(options, {seed, 0.2, 0.1});
    SelfCalibrationOptions calibration;
    calibration.bundle.estimate_k1 = true;
    calibration.bundle.k1_sigma = 0.2;
    const TracksResult r = Reconstruct(truth, {}, calibration);
    ExpectSane(r.metric);
    for (const auto& view : r.metric.scene.views) {
      if (view) errors.push_back(std::abs(view->camera.k1 + 0.15));
    }
  }
  ASSERT_FALSE(errors.empty());
  EXPECT_LT(Median(errors), 0.08);
}

TEST(SelfCalibration, BadArgumentsAreNamed) {
  const SyntheticTracks truth = MakeSyntheticTracks({}, {});
  const auto code = [&](std::vector<ViewPrior> priors, SelfCalibrationOptions options) {
    return ReconstructTracks(truth.tracks, priors, {}, options).status().code();
  };
  EXPECT_EQ(code(std::vector<ViewPrior>(2), {}), absl::StatusCode::kInvalidArgument);
  std::vector<ViewPrior> priors(6);
  priors[1].focal_px = -3.0;
  EXPECT_EQ(code(priors, {}), absl::StatusCode::kInvalidArgument);
  SelfCalibrationOptions options;
  options.min_focal_widths = 9.0;
  EXPECT_EQ(code({}, options), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(SelfCalibrate(truth.tracks, {}, {}, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
