// Recognition of synthetic parts in images that are drawn of them.
#include <gtest/gtest.h>

#include <atomic>

#include "server/vision/recognition/recognition.h"
#include "tests/support/matched_scene.h"
#include "tests/support/rendered_scene.h"

namespace horopter {
namespace {

using Objects = std::vector<std::shared_ptr<const PreparedObject>>;

const Objects& Catalog() {
  static const Objects* const kObjects = [] {
    PrepareOptions options;
    options.aspects = true;
    auto* objects = new Objects;
    for (const ObjectModel& m : {LBracket(), Wedge(), TwistedPrism(1)})
      objects->push_back(PrepareObject(m, options).value());
    return objects;
  }();
  return *kObjects;
}

// Images of parts, each in a colour of its own, on a grey table.
std::vector<cv::Mat> Draw(const std::vector<std::pair<int, Rigid3>>& shown,
                          double table_z,
                          const std::vector<PinholeCamera>& cameras,
                          const std::vector<Rigid3>& camera_from_world) {
  std::vector<RenderMesh> meshes;
  for (const auto& [object, pose] : shown) {
    const ObjectModel& model = Catalog()[object]->model;
    meshes.push_back(ExactRenderMesh(model.mesh, model.diameter_m).value());
  }
  const Rigid3 to_table{Eigen::Matrix3d::Identity(), {0, 0, -table_z}};  // the table is z = 0
  PaintedScene scene;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    PaintedPart part;
    part.mesh = &meshes[i];
    part.world_from_object = to_table * shown[i].second;
    part.color = Eigen::Vector3f(0.25f, 0.3f + 0.2f * static_cast<float>(i), 0.6f);
    scene.parts.push_back(part);
  }
  scene.table.reflectance = cv::Mat_<cv::Vec3f>(64, 64, cv::Vec3f(0.75f, 0.75f, 0.75f));
  scene.lights.push_back({{0.4, -0.3, 1.5}, Eigen::Vector3f::Constant(0.7f), false});
  scene.lights.push_back({{-0.8, 0.5, 1.0}, Eigen::Vector3f::Constant(0.3f), false});
  scene.radius_m = 0.2;
  const SceneRenderer renderer(std::move(scene));
  std::vector<cv::Mat> images;
  for (std::size_t v = 0; v < cameras.size(); ++v) {
    CameraLook look;
    look.seed = static_cast<unsigned>(v) + 1;
    images.push_back(
        renderer.Take(cameras[v], camera_from_world[v] * to_table.Inverse(), look).image);
  }
  return images;
}

struct Scene {
  Objects objects = Catalog();
  std::vector<std::pair<int, Rigid3>> shown;
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
  std::vector<cv::Mat> images;
  std::vector<ImageFeatures> features;

  RecognitionInput Input() const {
    RecognitionInput input;
    input.images = images;
    input.features = features;
    input.objects = objects;
    return input;
  }
};

// `shown`: indices of the objects in the scene, placed side by side on the table z = 0.
Scene MakeScene(const std::vector<int>& shown, int views) {
  Scene scene;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    Rigid3 pose;
    pose.t.x() = 0.11 * static_cast<double>(i) - 0.04;
    scene.shown.emplace_back(shown[i], pose);
  }
  for (int v = 0; v < views; ++v) {
    const double a = -0.9 + 0.3 * v;
    scene.cameras.push_back(CenteredCamera(640, 480, 900.0 + 30 * v));
    scene.camera_from_world.push_back(
        LookAt({0.48 * std::sin(a), -0.48 * std::cos(a), 0.40}, {0.03, 0.02, 0.02}));
  }
  scene.images = Draw(scene.shown, 0.0, scene.cameras, scene.camera_from_world);
  for (const cv::Mat& image : scene.images)
    scene.features.push_back(DetectFeatures(image, {}).value());
  return scene;
}

TEST(RecognizeObjects, FindsTheOnePartThatIsThereAndItsCameras) {
  const Scene scene = MakeScene({0}, 4);
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_EQ(result->objects.size(), 1u) << result->detail;
  EXPECT_EQ(result->objects[0].object, 0);
  for (std::size_t v = 0; v < scene.cameras.size(); ++v) {
    ASSERT_TRUE(result->views[v].has_value()) << "view " << v;
    EXPECT_LT(ProjectionDistance(
                  *scene.objects[0],
                  result->views[v]->camera,
                  result->views[v]->camera_from_scene * result->objects[0].scene_from_object,
                  scene.cameras[v],
                  scene.camera_from_world[v] * scene.shown[0].second),
              5.0);
  }
}

TEST(RecognizeObjects, FindsBothPartsOfAPairWhateverTheThreads) {
  const Scene scene = MakeScene({0, 1}, 4);
  std::vector<RecognitionResult> results;
  for (const int threads : {1, 2}) {
    RecognitionOptions options;
    options.threads = threads;
    const auto result = RecognizeObjects(scene.Input(), options);
    ASSERT_TRUE(result.ok()) << result.status();
    results.push_back(*result);
  }
  std::vector<int> found;
  for (const SceneObject& o : results[0].objects) found.push_back(o.object);
  std::sort(found.begin(), found.end());
  EXPECT_EQ(found, (std::vector<int>{0, 1})) << results[0].detail;
  ASSERT_EQ(results[0].objects.size(), results[1].objects.size());
  for (std::size_t i = 0; i < results[0].objects.size(); ++i) {
    EXPECT_EQ(results[0].objects[i].object, results[1].objects[i].object);
    EXPECT_EQ(results[0].objects[i].scene_from_object.t, results[1].objects[i].scene_from_object.t);
  }
}

TEST(RecognizeObjects, SaysNothingOfAPartThatIsNotEnrolled) {
  Scene scene = MakeScene({2}, 3);
  scene.objects.pop_back();
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_TRUE(result->objects.empty());
}

TEST(RecognizeObjects, ImagesWithoutEdgesAreSaidToHaveTooFewFeatures) {
  const Scene scene = MakeScene({}, 3);
  const auto result = RecognizeObjects(scene.Input(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->state, RecognitionState::kTooFewFeatures);
  EXPECT_TRUE(result->objects.empty());
}

TEST(RecognizeObjects, RefusesInputThatDoesNotAgree) {
  const Scene scene = MakeScene({0}, 2);
  RecognitionInput input = scene.Input();
  const std::vector<CameraHint> too_many(3);
  input.hints = too_many;
  EXPECT_EQ(RecognizeObjects(input, {}).status().code(), absl::StatusCode::kInvalidArgument);
  input = scene.Input();
  input.images = input.images.first(1);
  EXPECT_EQ(RecognizeObjects(input, {}).status().code(), absl::StatusCode::kInvalidArgument);
  input = scene.Input();
  const Objects plain = {PrepareObject(LBracket()).value()};
  input.objects = plain;
  EXPECT_EQ(RecognizeObjects(input, {}).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(RecognizeObjects, StopsWhenToldAndAnswersInAHurry) {
  const Scene scene = MakeScene({0}, 3);
  const auto stopped = RecognizeObjects(scene.Input(), {}, [] { return true; });
  EXPECT_EQ(stopped.status().code(), absl::StatusCode::kCancelled);
  for (int asked = 1; asked < 2000; asked *= 10) {
    std::atomic<int> count{0};
    const StopRequested after = [&] { return ++count > asked; };
    const auto result = RecognizeObjects(scene.Input(), {}, after);
    if (!result.ok()) {
      EXPECT_EQ(result.status().code(), absl::StatusCode::kCancelled);
    }
    count = 0;
    RecognitionOptions options;
    options.hurry = after;
    const auto hurried = RecognizeObjects(scene.Input(), options);
    ASSERT_TRUE(hurried.ok()) << hurried.status();
    EXPECT_LE(hurried->objects.size(), 1u) << "asked " << asked;
  }
}

// A second look at a request goes on with what effort the first has left.
TEST(RecognizeObjects, EffortIsCountedOverAllLooksAtARequest) {
  const Scene scene = MakeScene({0}, 4);
  RecognitionOptions options;
  options.effort = 1000.0;
  const auto spent = [&](AspectWork* work) {
    const auto result = RecognizeObjects(scene.Input(), options, {}, {}, nullptr, work);
    EXPECT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->effort_spent, result->counts.at("search_effort") >= options.effort);
    return result->counts.at("search_effort");
  };
  const std::shared_ptr<AspectWork> first = MakeAspectWork();
  const double once = spent(first.get());
  EXPECT_GE(once, 2.0);
  EXPECT_DOUBLE_EQ(spent(MakeAspectWork(first.get()).get()), 2.0 * once);
  EXPECT_DOUBLE_EQ(spent(MakeAspectWork().get()), once);
  options.effort = once;
  const std::shared_ptr<AspectWork> second = MakeAspectWork(first.get());
  EXPECT_LT(spent(second.get()), 2.0 * once);
}

TEST(RecognizeObjects, SaysWhichStepBegins) {
  const Scene scene = MakeScene({0}, 2);
  std::vector<std::string> steps;
  const auto result = RecognizeObjects(
      scene.Input(), {}, {}, [&](std::string_view step) { steps.emplace_back(step); });
  ASSERT_TRUE(result.ok());
  ASSERT_GE(steps.size(), 3u);
  EXPECT_EQ(steps.front(), "aspect_images");
  EXPECT_EQ(steps.back(), "shapes");
}

// The thesis's ways alone: no image is searched, the structure of matched corners proposes scenes.
class StructureAlone : public testing::TestWithParam<bool> {};

TEST_P(StructureAlone, FindsThePartAndItsCameras) {
  const bool metric = GetParam();
  int right = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    // A part in general position has projective keys.
    const Objects objects =
        metric ? Objects{Catalog()[0], Catalog()[1]} : Objects{Catalog()[2], Catalog()[0]};
    const MatchedScene scene = MakeMatchedScene(objects, 5, 0.2, seed);
    const double below = -2.0 * objects[0]->model.diameter_m;
    const std::vector<cv::Mat> images = Draw(
        {{metric ? 0 : 2, scene.world_from_object}}, below, scene.cameras, scene.camera_from_world);
    RecognitionInput input = scene.Input();
    input.images = images;
    Reconstruction nothing;  // is known of the cameras
    nothing.views.resize(images.size());
    if (!metric) input.reconstruction = &nothing;
    RecognitionOptions options;
    options.routes = {false, false, metric, !metric};
    const auto result = RecognizeObjects(input, options);
    ASSERT_TRUE(result.ok()) << result.status();
    for (const SceneObject& o : result->objects) {
      AspectScene answered;
      for (const auto& view : result->views) {
        answered.views.emplace_back();
        if (view) answered.views.back() = AspectSceneView{view->camera, view->camera_from_scene};
      }
      answered.objects.push_back({o.object, o.scene_from_object});
      EXPECT_EQ(o.object, 0);
      EXPECT_LT(scene.LargestError(answered), 5.0);
      ++right;
    }
  }
  EXPECT_GE(right, 2);
}

INSTANTIATE_TEST_SUITE_P(Ways, StructureAlone, testing::Bool(), [](const auto& way) {
  return way.param ? "metric" : "projective";
});

}  // namespace
}  // namespace horopter
