#include <gtest/gtest.h>

#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/scoring/pose_score.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

struct Scene {
  std::vector<std::shared_ptr<const PreparedObject>> objects{PrepareObject(LBracket()).value(),
                                                             PrepareObject(Wedge()).value()};
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
  std::vector<ImageFeatures> features;
  MatchingResult matching;

  RecognitionInput Input() {
    RecognitionInput input;
    input.features = features;
    input.matching = &matching;
    input.objects = objects;
    return input;
  }
};

// `shown`: indices of the objects in the scene, placed side by side on the table z = 0.
Scene MakeScene(const std::vector<int>& shown, int views, double noise_px, unsigned seed) {
  Scene scene;
  std::mt19937 rng(seed);
  for (int v = 0; v < views; ++v) {
    const double a = -0.9 + 0.3 * v;
    scene.cameras.push_back(CenteredCamera(640, 480, 900.0 + 30 * v));
    scene.camera_from_world.push_back(
        LookAt({0.48 * std::sin(a), -0.48 * std::cos(a), 0.40}, {0.03, 0.02, 0.02}));
    ImageFeatures f;
    f.width = 640;
    f.height = 480;
    for (std::size_t i = 0; i < shown.size(); ++i) {
      Rigid3 world_from_object;
      world_from_object.t.x() = 0.11 * static_cast<double>(i) - 0.04;
      AddSyntheticFeatures(*scene.objects[shown[i]],
                           scene.cameras[v],
                           scene.camera_from_world[v] * world_from_object,
                           noise_px,
                           &rng,
                           &f);
    }
    scene.features.push_back(std::move(f));
  }
  scene.matching.component.assign(views, -1);
  scene.matching.view_from_plane.assign(views, Eigen::Matrix3d::Identity());
  return scene;
}

TEST(RecognizeObjects, FindsTheOnePartThatIsThereAndItsCameras) {
  Scene scene = MakeScene({0}, 4, 0.3, 1);
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_EQ(result->objects.size(), 1u) << result->detail;
  EXPECT_EQ(result->objects[0].object, 0);
  Rigid3 world_from_object;
  world_from_object.t.x() = -0.04;
  for (int v = 0; v < 4; ++v) {
    ASSERT_TRUE(result->views[v].has_value()) << "view " << v;
    EXPECT_LT(ProjectionDistance(
                  *scene.objects[0],
                  result->views[v]->camera,
                  result->views[v]->camera_from_scene * result->objects[0].scene_from_object,
                  scene.cameras[v],
                  scene.camera_from_world[v] * world_from_object,
                  1.0),
              5.0);
  }
}

TEST(RecognizeObjects, FindsBothPartsOfAPair) {
  Scene scene = MakeScene({0, 1}, 4, 0.3, 2);
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  std::vector<int> found;
  for (const SceneObject& o : result->objects) found.push_back(o.object);
  std::sort(found.begin(), found.end());
  EXPECT_EQ(found, (std::vector<int>{0, 1})) << result->detail;
}

TEST(RecognizeObjects, OneImageIsEnoughForAPartAlone) {
  Scene scene = MakeScene({1}, 1, 0.2, 3);
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LE(result->objects.size(), 1u);
  for (const SceneObject& o : result->objects) EXPECT_EQ(o.object, 1);
}

TEST(RecognizeObjects, ImagesWithoutEdgesAreSaidToHaveTooFewFeatures) {
  Scene scene = MakeScene({}, 3, 0.0, 4);
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->state, RecognitionState::kTooFewFeatures);
  EXPECT_TRUE(result->objects.empty());
}

TEST(RecognizeObjects, UnknownStructureIsNothingFound) {
  Scene scene = MakeScene({}, 3, 0.0, 5);
  std::mt19937 rng(6);
  std::uniform_real_distribution<double> x(0, 640), y(0, 480);
  for (ImageFeatures& f : scene.features) {
    for (int i = 0; i < 12; ++i) {
      Segment s;
      s.start = {x(rng), y(rng)};
      s.end = {x(rng), y(rng)};
      f.segments.push_back(s);
    }
  }
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->state, RecognitionState::kNothingFound);
}

TEST(RecognizeObjects, EmptyCatalogAndStopAreTyped) {
  Scene scene = MakeScene({0}, 2, 0.2, 7);
  RecognitionInput input = scene.Input();
  const auto stopped = RecognizeObjects(input, {}, [] { return true; });
  EXPECT_EQ(stopped.status().code(), absl::StatusCode::kCancelled);
  input.objects = {};
  const auto nothing = RecognizeObjects(input, {});
  ASSERT_TRUE(nothing.ok());
  EXPECT_EQ(nothing->state, RecognitionState::kNothingFound);
  const std::vector<CameraHint> too_many(3);
  input.hints = too_many;
  EXPECT_EQ(RecognizeObjects(input, {}).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(RecognizeObjects, SaysWhichStepBegins) {
  Scene scene = MakeScene({0}, 3, 0.2, 9);
  std::vector<std::string> steps;
  const auto result = RecognizeObjects(
      scene.Input(), {}, {}, [&](std::string_view step) { steps.emplace_back(step); });
  ASSERT_TRUE(result.ok());
  ASSERT_GE(steps.size(), 3u);
  EXPECT_EQ(steps.front(), "edge_maps");
  EXPECT_EQ(steps.back(), "result");
}

TEST(RecognizeObjects, SameInputSameAnswer) {
  Scene scene = MakeScene({0, 1}, 3, 0.3, 8);
  RecognitionOptions one, two;
  one.threads = 1;
  two.threads = 2;
  const auto a = RecognizeObjects(scene.Input(), one);
  const auto b = RecognizeObjects(scene.Input(), two);
  ASSERT_TRUE(a.ok() && b.ok());
  ASSERT_EQ(a->objects.size(), b->objects.size());
  for (std::size_t i = 0; i < a->objects.size(); ++i) {
    EXPECT_EQ(a->objects[i].object, b->objects[i].object);
    EXPECT_EQ(a->objects[i].scene_from_object.t, b->objects[i].scene_from_object.t);
  }
}

}  // namespace
}  // namespace horopter
