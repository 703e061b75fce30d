#include "server/pipeline/texture_stage.h"

#include <gtest/gtest.h>

#include "tests/support/textured_scene.h"

namespace horopter {
namespace {

SceneRequest RequestOf(const std::vector<cv::Mat>& images) {
  SceneRequest request;
  request.images = images;
  return request;
}

TEST(ReconstructTexture, GivesCamerasAndThenMatchesAlongThem) {
  const TexturedScene scene = MakeTexturedScene({.seed = 41, .views = 4});
  const SceneRequest request = RequestOf(RenderTextured(scene));
  PipelineOptions options;
  std::vector<StageReport> stages;
  const auto solutions = ReconstructTexture(request, options, {}, &stages);
  ASSERT_TRUE(solutions.ok()) << solutions.status();
  ASSERT_EQ(solutions->size(), 1u);
  const Reconstruction* reconstruction = &solutions->front();
  ASSERT_TRUE(reconstruction->trusted) << reconstruction->refusal;
  ASSERT_EQ(stages.size(), 2u);
  EXPECT_EQ(stages[0].stage, "matching");
  EXPECT_GT(stages[0].counts["texture_tracks"], 50.0);
  EXPECT_EQ(stages[1].stage, "reconstruction");
  EXPECT_EQ(stages[1].counts["views"], 4.0);

  std::vector<ImageFeatures> features;
  for (const cv::Mat& image : request.images)
    features.push_back(*DetectFeatures(image, options.features));
  const auto matching = MatchUnderCameras(request, features, *reconstruction, options, {}, &stages);
  ASSERT_TRUE(matching.ok()) << matching.status();
  EXPECT_EQ(matching->pairs.size(), 6u);
  EXPECT_EQ(stages.size(), 3u);
}

TEST(ReconstructTexture, AFocalLengthThatIsGivenIsKept) {
  const TexturedScene scene = MakeTexturedScene({.seed = 42, .views = 3});
  SceneRequest request = RequestOf(RenderTextured(scene));
  for (const TexturedView& view : scene.views) {
    CameraHint hint;
    hint.focal_px = view.camera.focal_px;
    request.hints.push_back(hint);
  }
  std::vector<StageReport> stages;
  const auto solutions = ReconstructTexture(request, PipelineOptions(), {}, &stages);
  ASSERT_TRUE(solutions.ok());
  const Reconstruction* reconstruction = &solutions->front();
  ASSERT_TRUE(reconstruction->trusted) << reconstruction->refusal;
  for (size_t v = 0; v < scene.views.size(); ++v) {
    EXPECT_NEAR(
        reconstruction->views[v]->camera.focal_px / scene.views[v].camera.focal_px, 1.0, 0.03);
  }
}

TEST(ReconstructTexture, BlankImagesAreRefusedAndACallIsCancelled) {
  const SceneRequest request = RequestOf({cv::Mat(480, 640, CV_8UC3, cv::Scalar(90, 90, 90)),
                                          cv::Mat(240, 320, CV_8UC1, cv::Scalar(90))});
  std::vector<StageReport> stages;
  const auto blank = ReconstructTexture(request, PipelineOptions(), {}, &stages);
  ASSERT_TRUE(blank.ok());
  ASSERT_EQ(blank->size(), 1u);
  EXPECT_FALSE(blank->front().trusted);
  EXPECT_FALSE(blank->front().refusal.empty());
  EXPECT_EQ(ReconstructTexture(
                request, PipelineOptions(), [] { return true; }, &stages)
                .status()
                .code(),
            absl::StatusCode::kCancelled);
}

TEST(IsShownByMore, CountsTheImagesOfAllParts) {
  RecognitionResult one, other;
  EXPECT_FALSE(IsShownByMore(one, other));
  one.objects.resize(1);
  one.objects[0].view_scores = {0.5, -1.0, 0.4};
  EXPECT_TRUE(IsShownByMore(one, other));
  other.objects.resize(2);
  other.objects[0].view_scores = {0.9, -1.0, -1.0};
  other.objects[1].view_scores = {-1.0, 0.9, -1.0};
  EXPECT_FALSE(IsShownByMore(one, other));  // as many: the likelier cameras stay
  EXPECT_FALSE(IsShownByMore(other, one));
  other.objects[1].view_scores[2] = 0.1;
  EXPECT_TRUE(IsShownByMore(other, one));
}

}  // namespace
}  // namespace horopter
