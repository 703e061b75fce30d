#include "server/vision/explanation/explanation.h"

#include <gtest/gtest.h>

#include "tests/support/shaded_parts.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// A bracket on a table in four views; bracket and wedge are known, both with aspects. Made once.
class ExplainObjectTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    world_ = new World;
    for (const ObjectModel& model : {LBracket(), Wedge()}) {
      world_->objects.push_back(PrepareObject(model, {.aspects = true}).value());
    }
    for (int v = 0; v < 4; ++v) {
      const double a = -0.7 + 0.5 * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 780.0);
      const Rigid3 camera_from_scene =
          LookAt({0.32 * std::sin(a), -0.32 * std::cos(a), 0.26}, {0.03, 0.02, 0.02});
      world_->views.push_back(CalibratedCamera{camera, camera_from_scene});
      const ShadedPart shown{&world_->objects[0]->model, camera_from_scene};
      world_->images.push_back(PhotographParts(camera, {&shown, 1}, 1 + v));
      world_->features.push_back(DetectFeatures(world_->images.back(), {}).value());
    }
  }
  static void TearDownTestSuite() { delete world_; }

  static RecognitionInput Input() {
    return {world_->images, world_->features, {}, nullptr, nullptr, world_->objects};
  }

  static RefusalLog Log(int object) {
    RefusalLog log;
    log.object = object;
    return log;
  }

  // What recognition says when it found the cameras but no object.
  static RecognitionResult Seen() {
    RecognitionResult result;
    result.views = world_->views;
    return result;
  }

  static MetricScene Metric(int object, const Rigid3& pose) {
    MetricScene metric;
    for (const auto& view : world_->views) {
      PosedCamera camera;
      camera.camera = view->camera;
      camera.camera_from_scene = view->camera_from_scene;
      metric.cameras.push_back(camera);
    }
    PosedObject posed;
    posed.object = object;
    posed.scene_from_object = pose;
    posed.score = 0.9;
    metric.objects.push_back(posed);
    return metric;
  }

  static Explanation Explain(const RefusalLog& log,
                             const RecognitionResult& result,
                             const MetricScene* metric = nullptr,
                             const RecognitionInput& input = Input()) {
    auto explanation = ExplainObject(input, log, result, metric, {});
    EXPECT_TRUE(explanation.ok()) << explanation.status();
    return std::move(explanation).value_or(Explanation{});
  }

  static double SupportedShare(const Explanation& e) {
    double visible = 0.0, supported = 0.0;
    for (const auto& view : e.views) {
      if (!view) continue;
      visible += view->edges.visible_px;
      supported += view->edges.supported_px;
    }
    return visible > 0.0 ? supported / visible : 0.0;
  }

  struct World {
    std::vector<std::shared_ptr<const PreparedObject>> objects;
    std::vector<std::optional<CalibratedCamera>> views;
    std::vector<cv::Mat> images;
    std::vector<ImageFeatures> features;
  };
  static World* world_;
};
ExplainObjectTest::World* ExplainObjectTest::world_ = nullptr;

TEST_F(ExplainObjectTest, AnAnsweredObjectFailsNoTest) {
  const MetricScene metric = Metric(0, {});
  const Explanation e = Explain(Log(0), Seen(), &metric);
  EXPECT_EQ(e.failed, AcceptanceTest::kNone);
  EXPECT_EQ(e.value, 0.9);
  ASSERT_EQ(e.views.size(), 4u);
  for (const auto& view : e.views) ASSERT_TRUE(view.has_value());
  EXPECT_GT(SupportedShare(e), 0.9);
}

// The search for the object alone finds it in the scene's cameras: recognition overlooked it.
TEST_F(ExplainObjectTest, AnObjectThatIsThereButWasNotFoundWasOverlooked) {
  const Explanation e = Explain(Log(0), Seen());
  EXPECT_EQ(e.failed, AcceptanceTest::kSearch) << e.detail;
  EXPECT_GE(e.value, e.needed);
  EXPECT_GT(SupportedShare(e), 0.85);
}

TEST_F(ExplainObjectTest, AnObjectThatIsNotThereHasNoSupport) {
  const Explanation e = Explain(Log(1), Seen());
  EXPECT_EQ(e.failed, AcceptanceTest::kSupport) << e.detail;
  EXPECT_LT(e.value, e.needed);
  EXPECT_LT(SupportedShare(e), 0.8);
}

TEST_F(ExplainObjectTest, AnObjectInThePlaceOfAnotherGivesWay) {
  const MetricScene metric = Metric(0, {});
  RefusalLog log = Log(1);
  // The wedge, put where the bracket is.
  for (int v = 0; v < 4; ++v) {
    const CalibratedCamera& view = *world_->views[v];
    log.hypotheses.push_back({1, v, view.camera, view.camera_from_scene, 0.4});
  }
  const Explanation e = Explain(log, Seen(), &metric);
  EXPECT_EQ(e.failed, AcceptanceTest::kPlace) << e.detail;
  EXPECT_EQ(e.other, 0);
  EXPECT_NE(e.detail.find("l_bracket"), std::string::npos);
}

TEST_F(ExplainObjectTest, WithoutCamerasEveryImageShowsItsOwnPose) {
  RecognitionResult result;
  result.views.resize(4);
  const Explanation e = Explain(Log(0), result);
  EXPECT_EQ(e.failed, AcceptanceTest::kLink) << e.detail;
  EXPECT_GT(e.value, 0.3);
  int posed = 0;
  for (const auto& view : e.views) posed += view.has_value();
  EXPECT_GE(posed, 3);
}

TEST_F(ExplainObjectTest, OfSeveralRefusalsTheOneThatCameFurthestIsTold) {
  RefusalLog log = Log(0);
  Rigid3 aside;
  aside.t = {0.02, 0, 0};
  log.refusals = {{AcceptanceTest::kChance, {}, world_->views, 0.3, 0.5},
                  {AcceptanceTest::kContradiction, aside, world_->views, 0.2, 0.25},
                  {AcceptanceTest::kChance, {}, world_->views, 0.4, 0.5}};
  const Explanation e = Explain(log, Seen());
  EXPECT_EQ(e.failed, AcceptanceTest::kContradiction);
  EXPECT_EQ(e.value, 0.2);
  EXPECT_EQ(e.needed, 0.25);
  EXPECT_LT(SupportedShare(e), 0.5);
  log.refusals.erase(log.refusals.begin() + 1);
  const Explanation chance = Explain(log, Seen());
  EXPECT_EQ(chance.failed, AcceptanceTest::kChance);
  EXPECT_EQ(chance.value, 0.4);
  EXPECT_NE(chance.detail.find("0.40, need 0.50"), std::string::npos) << chance.detail;
}

TEST_F(ExplainObjectTest, ImagesWithoutEdgesHaveNoPose) {
  RecognitionInput input = Input();
  const std::vector<cv::Mat> blank(4, cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(120)));
  input.images = blank;
  RecognitionResult result;
  result.views.resize(4);
  const Explanation e = Explain(Log(0), result, nullptr, input);
  EXPECT_EQ(e.failed, AcceptanceTest::kHypothesis);
  for (const auto& view : e.views) EXPECT_FALSE(view.has_value());
}

TEST_F(ExplainObjectTest, NobodyIsExplainedUnasked) {
  EXPECT_EQ(ExplainObject(Input(), Log(-1), Seen(), nullptr, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ExplainObject(Input(), Log(2), Seen(), nullptr, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
