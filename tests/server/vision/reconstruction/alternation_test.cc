// Robust losses, intersection and resection, the thesis's alternation and depth decomposition.
#include "server/vision/reconstruction/alternation.h"

#include <ceres/loss_function.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <utility>

#include "server/vision/reconstruction/intersection_resection.h"
#include "server/vision/reconstruction/robust_curvature.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

constexpr RobustLoss kLosses[] = {
    RobustLoss::kNone, RobustLoss::kTukey, RobustLoss::kCauchy, RobustLoss::kHuber};

TEST(RobustLoss, WeightIsTheDerivativeOfTheCostOverTheResidual) {
  for (const RobustLoss loss : kLosses) {
    const double c = TuningConstant(loss);
    for (double r = 0.05; r < 12.0; r += 0.1) {
      if (std::abs(r - c) < 0.02) continue;  // the kink
      const double slope = (RobustCost(loss, r + 1e-6, c) - RobustCost(loss, r - 1e-6, c)) / 2e-6;
      EXPECT_NEAR(slope, RobustWeight(loss, r, c) * r, 1e-6) << static_cast<int>(loss) << " " << r;
    }
    EXPECT_EQ(RobustWeight(loss, 0.0, c), 1.0);
    EXPECT_EQ(RobustWeight(loss, std::nan(""), c), 0.0);
  }
}

TEST(RobustLoss, CurvatureIsTheSecondDerivativeOfTheCostOverTheWeight) {
  for (const RobustLoss loss : kLosses) {
    const double c = TuningConstant(loss);
    const auto slope = [&](double r) { return RobustWeight(loss, r, c) * r; };
    for (double r = 0.05; r < 12.0; r += 0.1) {
      if (std::abs(r - c) < 0.02) continue;  // the kink
      const double weight = RobustWeight(loss, r, c);
      const double bend = (slope(r + 1e-6) - slope(r - 1e-6)) / 2e-6;
      const double expected = weight > 0.0 ? bend / weight : kLeastCurvature;
      EXPECT_NEAR(std::max(kLeastCurvature, expected), RobustCurvature(loss, r, c), 1e-6)
          << static_cast<int>(loss) << " " << r;
    }
    EXPECT_EQ(RobustCurvature(loss, 0.0, c), 1.0);
  }
}

TEST(RobustLoss, CeresHasTheSameCosts) {
  const ceres::TukeyLoss tukey(TuningConstant(RobustLoss::kTukey));
  const ceres::CauchyLoss cauchy(TuningConstant(RobustLoss::kCauchy));
  const ceres::HuberLoss huber(TuningConstant(RobustLoss::kHuber));
  const std::pair<RobustLoss, const ceres::LossFunction*> pairs[] = {
      {RobustLoss::kTukey, &tukey}, {RobustLoss::kCauchy, &cauchy}, {RobustLoss::kHuber, &huber}};
  for (const auto& [loss, theirs] : pairs) {
    for (double r = 0.0; r < 12.0; r += 0.25) {
      double rho[3];
      theirs->Evaluate(r * r, rho);
      EXPECT_NEAR(0.5 * rho[0], RobustCost(loss, r, TuningConstant(loss)), 1e-9);
    }
  }
}

ProjectiveScene TrueScene(const SyntheticTracks& truth) {
  ProjectiveScene scene = EmptyScene(truth.tracks);
  for (size_t v = 0; v < truth.cameras.size(); ++v) {
    const CameraMatrix P = truth.TrueCamera(static_cast<int>(v));
    scene.cameras[v] = P / P.norm();
  }
  for (size_t j = 0; j < truth.points.size(); ++j) {
    scene.points[j] = Eigen::Vector4d(truth.points[j].homogeneous().normalized());
  }
  for (size_t j = 0; j < truth.lines.size(); ++j) {
    scene.lines[j] = JoinPoints(Eigen::Vector4d(truth.lines[j].first.homogeneous()),
                                Eigen::Vector4d(truth.lines[j].second.homogeneous()))
                         .normalized();
  }
  return scene;
}

TEST(IntersectionResection, RecoversExactScenesFromPointsAndLines) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(seed);
    SyntheticTrackNoise noise{seed, 0.0, 0.2};
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, noise);
    const ProjectiveScene scene = TrueScene(truth);
    EXPECT_LT(Summarize(truth.tracks, scene).rms_px, 1e-7);
    const TrackIndex index = IndexTracks(truth.tracks);
    for (int j = 0; j < truth.tracks.points; ++j) {
      const auto X = TriangulatePoint(truth.tracks, index.of_point[j], scene, 2);
      if (index.of_point[j].size() < 2) {
        EXPECT_FALSE(X);
        continue;
      }
      ASSERT_TRUE(X);
      EXPECT_LT((X->hnormalized() - truth.points[j]).norm(), 1e-6);
    }
    for (int j = 0; j < truth.tracks.lines; ++j) {
      const auto L = TriangulateLine(truth.tracks, index.of_line[j], scene, 3);
      if (!L) continue;
      EXPECT_LT(PointLineDistance(truth.lines[j].first.homogeneous(), *L), 1e-5);
      EXPECT_LT(PointLineDistance(truth.lines[j].second.homogeneous(), *L), 1e-5);
    }
    // Cameras from points, from lines, and from both.
    for (int v = 0; v < 6; ++v) {
      std::vector<WeightedPoint> points;
      std::vector<WeightedLine> lines;
      for (const int k : index.points_in_view[v]) {
        const PointObservation& o = truth.tracks.point_observations[k];
        points.push_back({&o, CameraMatrix::Zero(), *scene.points[o.point], 1.0});
      }
      for (const int k : index.lines_in_view[v]) {
        const LineObservation& o = truth.tracks.line_observations[k];
        lines.push_back({&o, CameraMatrix::Zero(), *scene.lines[o.line], 1.0});
      }
      for (const auto& P : {ResectCamera(points, {}),
                            ResectCamera({}, lines),
                            ResectCamera(points, lines),
                            ResectCamera(points, lines, scene.cameras[v])}) {
        ASSERT_TRUE(P);
        EXPECT_LT(std::min((*P - *scene.cameras[v]).norm(), (*P + *scene.cameras[v]).norm()), 1e-5);
      }
      EXPECT_FALSE(ResectCamera(std::span(points).first(5), {}));
    }
  }
}

TEST(DepthDecomposition, InitialisesWithAndWithoutMissingObservations) {
  for (unsigned seed = 1; seed <= 8; ++seed) {
    for (const double missing : {0.0, 0.2}) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << ", missing " << missing);
      const SyntheticTracks truth =
          MakeSyntheticTracks({.seed = seed, .points = 60}, {seed, 0.3, missing});
      const MultiviewTracks normalized = NormalizeTracks(truth.tracks);
      const auto scene = DecomposeDepths(normalized);
      ASSERT_TRUE(scene);
      ProjectiveScene refined = *scene;
      EXPECT_LT(Summarize(normalized, refined).rms_sigma, 60.0);
      BalanceGauge(&refined);
      Alternate(normalized, IndexTracks(normalized), {.max_sweeps = 60}, &refined);
      EXPECT_LT(Summarize(normalized, refined).rms_sigma, 1.2);
      EXPECT_LT(CompareWithTruth(truth, refined).rms_m, 0.0025);
    }
  }
}

TEST(Alternation, GeometricDistancesBeatAlgebraicOnes) {
  double geometric = 0.0, algebraic = 0.0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const SyntheticTracks truth = MakeSyntheticTracks({.seed = seed}, {seed, 0.5, 0.2});
    const MultiviewTracks normalized = NormalizeTracks(truth.tracks);
    for (const bool reweighted : {true, false}) {
      ProjectiveScene scene = TrueScene(truth);
      for (size_t v = 0; v < scene.cameras.size(); ++v) {
        scene.cameras[v] =
            CameraMatrix(NormalizedFromPixels(truth.tracks.sizes[v]) * *scene.cameras[v]);
      }
      Alternate(normalized,
                IndexTracks(normalized),
                {.max_sweeps = 40, .geometric = reweighted, .loss = RobustLoss::kNone},
                &scene);
      (reweighted ? geometric : algebraic) += Summarize(normalized, scene).rms_sigma;
    }
  }
  EXPECT_LT(geometric, algebraic);
  EXPECT_LT(geometric / 10.0, 0.85);  // below 1: parameters follow the noise
}

TEST(MultiviewTracks, ValidationNamesWhatIsWrong) {
  const SyntheticTracks truth = MakeSyntheticTracks({}, {});
  EXPECT_TRUE(Validate(truth.tracks).ok());
  EXPECT_TRUE(Validate(MultiviewTracks{}).ok());
  const auto broken = [&](auto change) {
    MultiviewTracks t = truth.tracks;
    change(&t);
    return Validate(t).code() == absl::StatusCode::kInvalidArgument;
  };
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->sizes[0].width = 0; }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->point_observations[0].view = 99; }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->point_observations[0].point = -1; }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->point_observations[0].pixel.x() = NAN; }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->point_observations[0].sigma_px = 0.0; }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->line_observations[0].end.y() = INFINITY; }));
  EXPECT_TRUE(broken(
      [](MultiviewTracks* t) { t->line_observations[0].end = t->line_observations[0].start; }));
  EXPECT_TRUE(broken(
      [](MultiviewTracks* t) { t->point_observations.push_back(t->point_observations[0]); }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->points = kMaxFeatures + 1; }));
  EXPECT_TRUE(broken([](MultiviewTracks* t) { t->sizes.resize(kMaxViews + 1, {640, 480}); }));
}

}  // namespace
}  // namespace horopter
