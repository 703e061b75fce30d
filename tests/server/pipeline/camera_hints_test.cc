// Camera hints through the whole pipeline, on a sample scene whose cameras are known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/pipeline.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kScene = 5;

struct Sample {
  BopScene scene;
  CatalogSnapshot catalog;  // the scene's part alone
  SceneRequest request;     // images, focal lengths and poses
  Rigid3 base_from_object;
};

absl::StatusOr<Sample> Load() {
  Sample sample;
  const absl::StatusOr<BopDataset> dataset = ReadBopDataset(kDataset);
  if (!dataset.ok()) return dataset.status();
  const absl::StatusOr<BopScene> scene = ReadBopScene(kDataset, "val", kScene);
  if (!scene.ok()) return scene.status();
  sample.scene = *scene;
  const auto& seen = scene->images[0].instances[0];
  for (const BopObject& object : dataset->objects) {
    if (object.obj_id != seen.obj_id) continue;
    absl::StatusOr<CadImport> cad = ImportCad(object.cad_path);
    if (!cad.ok()) return cad.status();
    cad->model.id = "part";
    sample.catalog.objects.push_back(PrepareCatalogObject(std::move(cad->model)).value());
  }
  sample.base_from_object = scene->images[0].camera_from_world.Inverse() * seen.camera_from_object;
  for (const BopImage& image : scene->images) {
    sample.request.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    CameraHint hint;
    hint.focal_px = image.camera.focal_px;
    hint.focal_log_sigma = 0.002;
    hint.principal_point = Eigen::Vector2d(image.camera.cx, image.camera.cy);
    sample.request.hints.push_back(hint);
    CameraPoseHint pose;
    pose.camera_from_base = image.camera_from_world;
    sample.request.camera_poses.push_back(pose);
  }
  return sample;
}

TEST(CameraHints, KnownCamerasGiveTheBaseFrameAndContradictionsAreNamed) {
  const absl::StatusOr<Sample> loaded = Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  SceneRequest request = loaded->request;
  const auto right = RecognizeScene(request, loaded->catalog, {});
  ASSERT_TRUE(right.ok()) << right.status();
  ASSERT_FALSE(right->answer.objects.empty()) << ReasonsText(right->answer);
  ASSERT_TRUE(right->answer.base_from_scene) << ReasonsText(right->answer);
  const Rigid3 found = *right->answer.base_from_scene * right->answer.objects[0].scene_from_object;
  EXPECT_LT((found.t - loaded->base_from_object.t).norm(), 0.004);
  for (size_t v = 0; v < request.images.size(); ++v) {
    ASSERT_TRUE(right->answer.cameras[v]);
    EXPECT_LT(
        std::abs(std::log(right->answer.cameras[v]->camera.focal_px / *request.hints[v].focal_px)),
        0.01);
  }
  // Two images' poses exchanged: no frame, and the answer says which. The focal lengths are not
  // exchanged, so the parts are found as before.
  std::swap(request.camera_poses[0], request.camera_poses[1]);
  const auto wrong = RecognizeScene(request, loaded->catalog, {});
  ASSERT_TRUE(wrong.ok()) << wrong.status();
  ASSERT_FALSE(wrong->answer.objects.empty()) << ReasonsText(wrong->answer);
  EXPECT_FALSE(wrong->answer.base_from_scene);
  EXPECT_THAT(ReasonsText(wrong->answer), testing::HasSubstr("contradict each other"));
}

// The request as its images' files would have it, with focal lengths that are off by this factor.
SceneRequest Presumed(const Sample& sample, double factor) {
  SceneRequest request = sample.request;
  request.camera_poses.clear();
  for (CameraHint& hint : request.hints) {
    CameraHint presumed;
    presumed.focal_px = factor * *hint.focal_px;
    presumed.focal_log_sigma = 0.06;
    presumed.presumed = true;
    hint = presumed;
  }
  return request;
}

int CountContradicted(const SceneAnswer& answer) {
  return static_cast<int>(
      std::count_if(answer.findings.begin(), answer.findings.end(), [](const AnswerFinding& f) {
        return f.kind == FindingKind::kExifContradicted;
      }));
}

TEST(PresumedFocals, AreUsedWhereTheyFitAndSaidToBeWrongWhereTheyDoNot) {
  const absl::StatusOr<Sample> loaded = Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  const auto right = RecognizeScene(Presumed(*loaded, 1.05), loaded->catalog, {});
  ASSERT_TRUE(right.ok()) << right.status();
  ASSERT_FALSE(right->answer.objects.empty()) << ReasonsText(right->answer);
  EXPECT_EQ(CountContradicted(right->answer), 0);
  EXPECT_EQ(right->answer.presumed_focal, std::vector<bool>(loaded->request.images.size(), true));

  // A cut-out of 60 per cent that kept the file's Exif: as if nothing had been said.
  SceneRequest unknown = Presumed(*loaded, 1.0);
  unknown.hints.clear();
  const auto without = RecognizeScene(unknown, loaded->catalog, {});
  const auto lied = RecognizeScene(Presumed(*loaded, 0.6), loaded->catalog, {});
  ASSERT_TRUE(without.ok() && lied.ok()) << without.status() << lied.status();
  EXPECT_GT(CountContradicted(lied->answer), 0);
  EXPECT_TRUE(lied->answer.presumed_focal.empty());
  ASSERT_EQ(lied->answer.objects.size(), without->answer.objects.size());
  for (size_t v = 0; v < lied->answer.cameras.size(); ++v) {
    ASSERT_EQ(lied->answer.cameras[v].has_value(), without->answer.cameras[v].has_value());
    if (!lied->answer.cameras[v]) continue;
    EXPECT_EQ(lied->answer.cameras[v]->camera.focal_px,
              without->answer.cameras[v]->camera.focal_px);
  }
}

// What the caller says of all cameras, off by this factor.
SceneRequest Claimed(const Sample& sample, double factor) {
  SceneRequest request = sample.request;
  request.camera_poses.clear();
  for (CameraHint& hint : request.hints) {
    *hint.focal_px *= factor;
    hint.focal_log_sigma.reset();
  }
  return request;
}

// In the first camera, to the part's place.
double ErrorM(const Sample& sample, const SceneAnswer& answer) {
  const auto& seen = sample.scene.images[0].instances[0];
  return (answer.cameras[0]->camera_from_scene * answer.objects[0].scene_from_object.t -
          seen.camera_from_object.t)
      .norm();
}

TEST(ClaimedLenses, AreUsedWhereTheyFitAndToldWhereTheImagesContradictThem) {
  const absl::StatusOr<Sample> loaded = Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  const auto right = RecognizeScene(Claimed(*loaded, 1.0), loaded->catalog, {});
  ASSERT_TRUE(right.ok()) << right.status();
  ASSERT_FALSE(right->answer.objects.empty()) << ReasonsText(right->answer);
  EXPECT_FALSE(HasReason(right->answer, ReasonKind::kHintContradicted));
  EXPECT_TRUE(right->answer.contradicted_hints.empty());
  EXPECT_GT(right->answer.objects[0].score, 0.9);
  EXPECT_LT(ErrorM(*loaded, right->answer), 0.01);

  const auto wrong = RecognizeScene(Claimed(*loaded, 2.0), loaded->catalog, {});
  ASSERT_TRUE(wrong.ok()) << wrong.status();
  EXPECT_TRUE(HasReason(wrong->answer, ReasonKind::kHintContradicted));
  for (const AnswerObject& object : wrong->answer.objects) EXPECT_LE(object.score, 0.5);
  // The images alone have answered.
  ASSERT_FALSE(wrong->answer.objects.empty()) << ReasonsText(wrong->answer);
  EXPECT_FALSE(wrong->answer.contradicted_hints.empty());
  for (const ContradictedHint& hint : wrong->answer.contradicted_hints) {
    const double truth = *loaded->request.hints[hint.image].focal_px;
    EXPECT_LT(std::abs(std::log(hint.focal_px / truth)), 0.1);
  }
}

}  // namespace
}  // namespace horopter
