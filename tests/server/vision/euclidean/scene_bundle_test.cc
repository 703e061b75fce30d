// The analytic derivatives against automatic ones and differences, and the covariance against
// draws.
#include "server/vision/euclidean/scene_bundle.h"

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>

#include "server/vision/euclidean/euclidean.h"
#include "tests/server/vision/euclidean/autodiff_costs.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

SceneBundle TwoViews(const PreparedObject* model) {
  SceneBundle bundle;
  for (int v = 0; v < 2; ++v) {
    PinholeCamera camera = CenteredCamera(640, 480, 900.0 + 80 * v);
    camera.k1 = -0.04 + 0.03 * v;
    camera.cx += 5;
    bundle.views.push_back({true, camera, LookAt({0.2 - 0.3 * v, -0.45, 0.4}, {0.03, 0.02, 0.02})});
    CameraPrior prior;
    prior.log_focal = std::log(900.0);
    bundle.priors.push_back(prior);
    bundle.working_from_image.push_back(1.0);
  }
  Rigid3 pose;
  pose.R = RotationFromVector({0.05, -0.02, 0.3});
  pose.t = {0.01, 0.02, 0.003};
  bundle.objects = {{pose, model}};
  bundle.log_scale = {0.03};
  bundle.plane.plane = {0.1, 0.2, 2.4};
  bundle.plane.anchor = {0.05, -0.45, 0.4};
  return bundle;
}

class Derivatives : public testing::Test {
 protected:
  std::shared_ptr<const PreparedObject> model_ = PrepareObject(LBracket()).value();
  SceneBundle bundle_ = TwoViews(model_.get());
};

TEST_F(Derivatives, OfAnEdgeAgreeWithDifferences) {
  EdgeObservation o;
  o.view = 1;
  o.object = 0;
  o.point_in_object = {0.07, 0.01, 0.04};
  o.edge_point = {330, 250};
  o.normal = Eigen::Vector2d(0.6, 0.8);
  o.spacing_px = 5.0;
  EdgeRow row, moved;
  ASSERT_TRUE(LinearizeEdge(bundle_, o, &row));
  const SceneBundleLayout layout = LayoutOf(bundle_);
  for (int p = 0; p < kViewParameters + kObjectParameters; ++p) {
    constexpr double kStep = 1e-6;
    Eigen::VectorXd step = Eigen::VectorXd::Zero(layout.size);
    step(p < kViewParameters ? layout.view[1] + p : layout.object[0] + p - kViewParameters) = kStep;
    SceneBundle trial = bundle_;
    MoveBundle(layout, step, &trial);
    ASSERT_TRUE(LinearizeEdge(trial, o, &moved));
    const double numeric = (moved.residual - row.residual) / kStep;
    EXPECT_NEAR(row.J(p), numeric, 1e-3 * std::max(1.0, std::abs(numeric))) << "parameter " << p;
  }
}

TEST_F(Derivatives, OfAnEdgeAgreeWithAutomaticOnes) {
  bundle_.log_scale = {0.0};
  EdgeObservation o;
  o.view = 0;
  o.object = 0;
  o.point_in_object = {0.02, 0.05, 0.0};
  o.edge_point = {300, 200};
  o.normal = Eigen::Vector2d(0.28, 0.96);
  o.spacing_px = 100.0;
  EdgeRow row;
  ASSERT_TRUE(LinearizeEdge(bundle_, o, &row));
  ceres::AutoDiffCostFunction<EdgeCost, 1, kCameraBlock, kObjectBlock> cost(
      new EdgeCost{o.point_in_object,
                   bundle_.views[0].camera_from_scene,
                   bundle_.objects[0].scene_from_object,
                   o.edge_point,
                   o.normal,
                   1.0 / bundle_.edge_sigma_px});
  const PinholeCamera& c = bundle_.views[0].camera;
  const double camera[10] = {0, 0, 0, 0, 0, 0, std::log(c.focal_px), c.cx, c.cy, c.k1};
  const double object[6] = {};
  const double* blocks[2] = {camera, object};
  double residual, by_camera[10], by_object[6];
  double* jacobians[2] = {by_camera, by_object};
  ASSERT_TRUE(cost.Evaluate(blocks, &residual, jacobians));
  EXPECT_NEAR(row.residual, residual, 1e-9 * std::abs(residual));
  for (int i = 0; i < 10; ++i) EXPECT_NEAR(row.J(i), by_camera[i], 1e-8 * row.J.norm()) << i;
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(row.J(10 + i), by_object[i], 1e-8 * row.J.norm()) << i;
}

TEST_F(Derivatives, OfAPlaneCellAgreeWithDifferences) {
  PlaneCell m{0, 1, {350, 260}, {300, 240}, Eigen::Matrix2d::Identity(), 5};
  m.whitening << 3.0, 0.5, 0.5, 2.0;
  bundle_.plane.cells = {m};
  bundle_.plane_slack = 1.5;
  PlaneRow row, moved;
  ASSERT_TRUE(LinearizePlaneCell(bundle_, m, &row));
  const SceneBundleLayout layout = LayoutOf(bundle_);
  for (int p = 0; p < 23; ++p) {
    constexpr double kStep = 1e-6;
    Eigen::VectorXd step = Eigen::VectorXd::Zero(layout.size);
    step(p < 10   ? layout.view[0] + p
         : p < 20 ? layout.view[1] + p - 10
                  : layout.plane + p - 20) = kStep;
    SceneBundle trial = bundle_;
    MoveBundle(layout, step, &trial);
    ASSERT_TRUE(LinearizePlaneCell(trial, m, &moved));
    const Eigen::Vector2d numeric = (moved.residual - row.residual) / kStep;
    EXPECT_LT((row.J.col(p) - numeric).norm(), 2e-3 * std::max(1.0, numeric.norm())) << p;
  }
}

TEST(AdjustBundle, NeverFitsWorseThanItsStart) {
  MetricSceneOptions options;
  options.parts = {PrepareObject(LBracket()).value(), PrepareObject(Wedge()).value()};
  for (unsigned seed = 1; seed <= 3; ++seed) {
    options.seed = seed;
    const MetricSceneTruth truth = MakeMetricScene(options);
    EuclideanOptions none, one;
    none.rounds = 0;
    one.rounds = 1;
    const auto before = RefineMetricScene(truth.Input(), truth.recognition, none);
    const auto after = RefineMetricScene(truth.Input(), truth.recognition, one);
    ASSERT_TRUE(before.ok() && after.ok());
    EXPECT_LT(after->rms_px, before->rms_px) << "seed " << seed;
  }
}

// Squared errors in their own deviations follow chi square with six degrees of freedom:
// median 5.35, 95 % below 12.59. euclidean_report has a thousand scenes.
TEST(SceneCovariance, HoldsTheTruthAsOftenAsItSays) {
  MetricSceneOptions options;
  options.parts = {
      PrepareObject(LBracket()).value(),
      PrepareObject(Wedge()).value(),
      PrepareObject(Prism("step", {{0, 0}, {0.05, 0}, {0.05, 0.04}, {0.02, 0.055}}, 0.06)).value()};
  std::vector<double> squared;
  for (unsigned seed = 1; seed <= 30; ++seed) {
    options.seed = seed;
    const MetricSceneTruth truth = MakeMetricScene(options);
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok()) << metric.status();
    ASSERT_EQ(metric->objects.size(), 3u) << "seed " << seed;
    for (int k = 1; k < 3; ++k) {
      const Vector6d off =
          PerturbationBetween(metric->objects[k].scene_from_object,
                              truth.world_from_object[0].Inverse() * truth.world_from_object[k]);
      // Equilibrated: radians and metres differ by orders of magnitude.
      const Matrix6d& C = metric->objects[k].covariance;
      const Vector6d s = C.diagonal().cwiseSqrt().cwiseInverse();
      const Vector6d e = s.cwiseProduct(off);
      const Matrix6d scaled = s.asDiagonal() * C * s.asDiagonal();
      squared.push_back(e.dot(scaled.ldlt().solve(e)));
    }
  }
  std::sort(squared.begin(), squared.end());
  const auto held = std::upper_bound(squared.begin(), squared.end(), 12.59) - squared.begin();
  EXPECT_GT(squared[squared.size() / 2], 3.2);
  EXPECT_LT(squared[squared.size() / 2], 7.5);
  EXPECT_GE(static_cast<double>(held) / static_cast<double>(squared.size()), 0.85);
}

TEST(SceneCovariance, OneFifthOrMoreOfTheViewsGivesWiderPoses) {
  MetricSceneOptions options;
  options.parts = {PrepareObject(LBracket()).value(), PrepareObject(Wedge()).value()};
  options.seed = 4;
  options.views = 6;
  const MetricSceneTruth many = MakeMetricScene(options);
  RecognitionResult few = many.recognition;
  for (int v = 2; v < 6; ++v) few.views[v].reset();
  const auto all = RefineMetricScene(many.Input(), many.recognition, {});
  const auto two = RefineMetricScene(many.Input(), few, {});
  ASSERT_TRUE(all.ok() && two.ok());
  EXPECT_GT(two->objects[1].covariance.trace(), all->objects[1].covariance.trace());
}

}  // namespace
}  // namespace horopter
