#include "server/vision/station/station_adjustment.h"

#include <gtest/gtest.h>

#include <cmath>

#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

constexpr int kViews = 3;

MetricSceneOptions RigOptions() {
  MetricSceneOptions options;
  options.seed = 11;
  options.views = kViews;
  options.parts = {PrepareObject(LBracket()).value(), PrepareObject(Wedge()).value()};
  const MetricSceneTruth truth = MakeMetricScene(options);
  options.rig_cameras = truth.cameras;
  options.rig_from_world = truth.camera_from_world;
  options.end_sigma_px = 0.2;
  return options;
}

TEST(RefineUnderStation, LearnsARigAndAnswersBetterWithIt) {
  const StationViews views = {0, 1, 2};
  StationState state;
  for (int c = 0; c < kViews; ++c) AddStationCamera("c" + std::to_string(c), 640, 480, {}, &state);
  MetricSceneOptions options = RigOptions();
  double first = 0.0, last = 0.0;
  for (int r = 0; r < 8; ++r) {
    options.seed = static_cast<unsigned>(100 + r);
    const MetricSceneTruth truth = MakeMetricScene(options);
    const auto scene = RefineUnderStation(truth.Input(), truth.recognition, state, views, {}, {});
    ASSERT_TRUE(scene.ok()) << scene.status();
    EXPECT_TRUE(scene->test.agrees) << "request " << r;
    state = UpdateStation(state, views, scene->evidence, scene->test, {});
    double worst = 0.0;
    for (int v = 0; v < kViews; ++v) {
      worst = std::max(worst,
                       std::abs(std::log(scene->metric.cameras[v]->camera.focal_px /
                                         truth.cameras[v].focal_px)));
    }
    if (r == 0) first = worst;
    last = worst;
  }
  EXPECT_LT(last, 0.01);
  EXPECT_LE(last, first + 0.002);
  for (const StationCamera& c : state.cameras) EXPECT_TRUE(c.posed);
}

TEST(RefineUnderStation, AWrongPriorIsNotUsed) {
  const StationViews views = {0, 1, 2};
  StationState state;
  for (int c = 0; c < kViews; ++c) AddStationCamera("c" + std::to_string(c), 640, 480, {}, &state);
  MetricSceneOptions options = RigOptions();
  for (int r = 0; r < 8; ++r) {
    options.seed = static_cast<unsigned>(100 + r);
    const MetricSceneTruth truth = MakeMetricScene(options);
    const auto scene = RefineUnderStation(truth.Input(), truth.recognition, state, views, {}, {});
    ASSERT_TRUE(scene.ok());
    state = UpdateStation(state, views, scene->evidence, scene->test, {});
  }
  options.seed = 300;
  options.rig_cameras[1].focal_px *= 1.05;
  const MetricSceneTruth truth = MakeMetricScene(options);
  const auto alone = RefineMetricScene(truth.Input(), truth.recognition, {});
  const auto scene = RefineUnderStation(truth.Input(), truth.recognition, state, views, {}, {});
  ASSERT_TRUE(alone.ok() && scene.ok());
  EXPECT_FALSE(scene->prior_used);
  ASSERT_FALSE(scene->test.agrees);
  ASSERT_FALSE(scene->test.changes.empty());
  EXPECT_EQ(scene->test.changes[0].kind, StationChangeKind::kLens);
  EXPECT_EQ(scene->test.changes[0].cameras, std::vector<int>{1});
  EXPECT_NEAR(scene->test.changes[0].log_focal, std::log(1.05), 0.02);
  // What is known of the cameras that did not change makes the answer better than the images alone.
  const auto error = [&](const MetricScene& m) {
    double sum = 0.0;
    for (int v = 0; v < kViews; ++v)
      sum += std::abs(std::log(m.cameras[v]->camera.focal_px / truth.cameras[v].focal_px));
    return sum;
  };
  EXPECT_LT(error(scene->metric), error(*alone));
}

TEST(RefineUnderStation, WantsOneCameraPerImage) {
  const MetricSceneTruth truth = MakeMetricScene(RigOptions());
  EXPECT_EQ(RefineUnderStation(truth.Input(), truth.recognition, {}, {0}, {}, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
