#include "client/bop_evaluate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <random>

#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

// Two objects (2 has a half turn about z as symmetry) in two images, one of the instances barely
// visible in the second.
struct Sample {
  TempFolder folder;
  BopDataset dataset;
  BopScene scene;

  Sample() {
    folder.Write("models/obj_000001.ply", AsPly(Box(40, 30, 20)));
    folder.Write("models/obj_000002.ply", AsPly(Box(60, 20, 10)));
    folder.Write("models/models_info.json",
                 R"({"1": {"diameter": 53.85}, "2": {"diameter": 64.03,
                     "symmetries_discrete": [[-1,0,0,0, 0,-1,0,0, 0,0,1,0, 0,0,0,1]]}})");
    folder.Write(
        "val/000001/scene_camera.json",
        R"({"0": {"cam_K": [800,0,320,0,800,240,0,0,1]}, "1": {"cam_K": [900,0,310,0,900,250,0,0,1]}})");
    folder.Write("val/000001/scene_gt.json", R"({
      "0": [{"cam_R_m2c": [1,0,0,0,1,0,0,0,1], "cam_t_m2c": [0,0,500], "obj_id": 1},
            {"cam_R_m2c": [0,-1,0,1,0,0,0,0,1], "cam_t_m2c": [80,10,520], "obj_id": 2}],
      "1": [{"cam_R_m2c": [1,0,0,0,0,-1,0,1,0], "cam_t_m2c": [0,0,500], "obj_id": 1},
            {"cam_R_m2c": [0,-1,0,1,0,0,0,0,1], "cam_t_m2c": [80,10,520], "obj_id": 2}]})");
    folder.Write("val/000001/scene_gt_info.json",
                 R"({"0": [{"visib_fract": 0.9}, {"visib_fract": 0.9}],
                     "1": [{"visib_fract": 0.9}, {"visib_fract": 0.2}]})");
    dataset = *ReadBopDataset(folder.path());
    scene = *ReadBopScene(folder.path(), "val", 1);
  }

  // The ground truth as an answer.
  BopResults Truth() const {
    BopResults results;
    for (const BopImage& image : scene.images) {
      results.cameras[1][image.im_id] = image.K;
      for (const BopInstance& i : image.instances) {
        results.estimates.push_back({1, image.im_id, i.obj_id, 0.9, i.camera_from_object, 3.0});
      }
    }
    return results;
  }

  BopScores Score(const BopResults& results, const BopEvaluateOptions& options = {}) const {
    const auto evaluation = EvaluateBopResults(dataset, "val", results, options);
    EXPECT_TRUE(evaluation.ok()) << evaluation.status();
    return evaluation.ok() ? evaluation->all : BopScores{};
  }
};

TEST(BopEvaluate, TruthScoresOne) {
  const Sample sample;
  const BopScores s = sample.Score(sample.Truth());
  EXPECT_EQ(s.targets, 3);
  EXPECT_DOUBLE_EQ(s.ar, 1.0);
  EXPECT_DOUBLE_EQ(s.recall_10px, 1.0);
  EXPECT_DOUBLE_EQ(s.precision, 1.0);
  EXPECT_NEAR(s.rel_mm, 0.0, 1e-9);
  EXPECT_DOUBLE_EQ(s.focal_error, 0.0);
  EXPECT_DOUBLE_EQ(s.seconds_per_set, 3.0);
}

TEST(BopEvaluate, ByItsOwnCameraAnAnswerMayBeRightWhereTheTrueOneSaysWrong) {
  // What a cut-out's principal point does: all is turned a little, and seen in the same place.
  const Sample sample;
  BopResults results = sample.Truth();
  const double shift_px = 120.0;
  for (auto& [image, K] : results.cameras[1]) K(0, 2) += shift_px;
  for (BopEstimate& e : results.estimates) {
    const double focal_px = sample.scene.images[static_cast<size_t>(e.im_id)].K(0, 0);
    e.camera_from_object.t.x() -= shift_px / focal_px * e.camera_from_object.t.z();
  }
  const BopScores s = sample.Score(results);
  EXPECT_DOUBLE_EQ(s.precision, 1.0);
  EXPECT_DOUBLE_EQ(s.recall_10px, 0.0);
  EXPECT_DOUBLE_EQ(s.own_10px, 1.0);
  for (BopEstimate& e : results.estimates) e.camera_from_object.t.x() += 0.5;
  EXPECT_DOUBLE_EQ(sample.Score(results).own_10px, 0.0);
  EXPECT_DOUBLE_EQ(sample.Score({}).own_10px, 0.0);
}

TEST(BopEvaluate, TheLensesOfAnAnswerCountByItsOwnCamera) {
  const Sample sample;
  BopResults results = sample.Truth();
  EXPECT_DOUBLE_EQ(sample.Score(results).own_10px, 1.0);
  for (const BopImage& image : sample.scene.images) {
    results.distortions[1][image.im_id] = {-8.0, 0.0, 0.0, 0.0};
  }
  EXPECT_LT(sample.Score(results).own_10px, 1.0);
  EXPECT_DOUBLE_EQ(sample.Score(results).recall_10px, 1.0);
}

TEST(BopEvaluate, SymmetricPosesAreEqual) {
  const Sample sample;
  BopResults results = sample.Truth();
  for (BopEstimate& e : results.estimates) {
    if (e.obj_id == 2)
      e.camera_from_object = e.camera_from_object * sample.dataset.Find(2)->symmetries[0];
  }
  EXPECT_DOUBLE_EQ(sample.Score(results).ar, 1.0);
  EXPECT_NEAR(sample.Score(results).rel_deg, 0.0, 1e-6);
  for (BopEstimate& e : results.estimates) {
    if (e.obj_id == 1)
      e.camera_from_object = e.camera_from_object * sample.dataset.Find(2)->symmetries[0];
  }
  EXPECT_LT(sample.Score(results).ar, 1.0);  // object 1 has no symmetry in the dataset
}

TEST(BopEvaluate, AnEmptyAnswerScoresZeroAndHasNoPrecision) {
  const Sample sample;
  const BopScores s = sample.Score({});
  EXPECT_DOUBLE_EQ(s.ar, 0.0);
  EXPECT_TRUE(std::isnan(s.precision));
  EXPECT_TRUE(std::isnan(s.seconds_per_set));
}

TEST(BopEvaluate, WrongIdentityIsAFalseEstimate) {
  const Sample sample;
  BopResults results = sample.Truth();
  results.estimates[0].obj_id = 2;
  const auto evaluation = EvaluateBopResults(sample.dataset, "val", results);
  ASSERT_TRUE(evaluation.ok());
  EXPECT_DOUBLE_EQ(evaluation->all.precision, 0.75);
  EXPECT_NEAR(evaluation->all.recall_10px, 2.0 / 3, 1e-12);
  EXPECT_EQ(evaluation->scenes.at(1).false_estimates, 1);
}

// What intervals over scenes are made from: single values that give the figures of all again.
TEST(BopEvaluate, ASceneHasItsOwnFiguresAndEveryEstimateItsVerdict) {
  const Sample sample;
  BopResults results = sample.Truth();
  results.estimates[0].obj_id = 2;
  results.estimates[0].score = 0.4;
  const auto evaluation = EvaluateBopResults(sample.dataset, "val", results);
  ASSERT_TRUE(evaluation.ok());
  const BopSceneScores& scene = evaluation->scenes.at(1);
  EXPECT_EQ(scene.scores.targets, evaluation->all.targets);
  EXPECT_DOUBLE_EQ(scene.scores.ar, evaluation->all.ar);
  EXPECT_DOUBLE_EQ(scene.scores.own_10px, evaluation->all.own_10px);
  ASSERT_EQ(scene.estimates.size(), results.estimates.size());
  for (const BopScoredEstimate& e : scene.estimates) {
    EXPECT_EQ(e.right, e.score != 0.4);
    EXPECT_EQ(e.own_px < 1e-6, e.right) << e.own_px;
  }
  EXPECT_EQ(scene.rel_mm.size(), 2u);  // both ways, of the one image that shows both rightly
  EXPECT_EQ(scene.rel_deg.size(), 2u);
  EXPECT_EQ(scene.focal_error.size(), 2u);
}

TEST(BopEvaluate, TheSecondOfTwoEqualAnswersIsFalse) {
  const Sample sample;
  BopResults results = sample.Truth();
  results.estimates.push_back(results.estimates[0]);
  EXPECT_DOUBLE_EQ(sample.Score(results).ar, 1.0);
  EXPECT_DOUBLE_EQ(sample.Score(results).precision, 0.8);
}

// An instance below the visibility limit is no target, but an estimate of it is right.
TEST(BopEvaluate, HiddenInstancesAreNeitherRequiredNorWrong) {
  const Sample sample;
  BopResults results = sample.Truth();
  results.estimates.pop_back();
  EXPECT_DOUBLE_EQ(sample.Score(results).ar, 1.0);
  BopEvaluateOptions strict;
  strict.min_visib = 0.1;
  EXPECT_EQ(sample.Score(results, strict).targets, 4);
  EXPECT_LT(sample.Score(results, strict).ar, 1.0);
}

TEST(BopEvaluate, RowOrderAndScoreScaleDoNotMatter) {
  constexpr unsigned kSeed = 5;
  SCOPED_TRACE(testing::Message() << "seed " << kSeed);
  std::mt19937 rng(kSeed);
  std::normal_distribution<double> normal;
  const Sample sample;
  BopResults results = sample.Truth();
  for (BopEstimate& e : results.estimates) {
    e.camera_from_object.t += 0.003 * Eigen::Vector3d(normal(rng), normal(rng), normal(rng));
    e.score = std::uniform_real_distribution<double>(0.1, 0.9)(rng);
  }
  const BopScores before = sample.Score(results);
  std::shuffle(results.estimates.begin(), results.estimates.end(), rng);
  for (BopEstimate& e : results.estimates) e.score *= 0.5;
  EXPECT_DOUBLE_EQ(sample.Score(results).ar, before.ar);
  EXPECT_DOUBLE_EQ(sample.Score(results).rel_mm, before.rel_mm);
}

// Depth along the line of sight: a scaling of the scene moves no pixel, but every point.
TEST(BopEvaluate, MspdIgnoresAScalingAboutTheCameraAndMssdDoesNot) {
  const Sample sample;
  double last = 2.0;
  for (const double factor : {1.0, 1.01, 1.02, 1.05, 1.1}) {
    BopResults results = sample.Truth();
    for (BopEstimate& e : results.estimates) e.camera_from_object.t *= factor;
    const BopScores s = sample.Score(results);
    EXPECT_GT(s.recall_10px, 0.99) << factor;  // only the size in the image changes a little
    EXPECT_LE(s.ar_mssd, last);
    last = s.ar_mssd;
  }
  EXPECT_LT(last, 0.1);
}

TEST(BopEvaluate, RelativeErrorIsOfTheSecondObjectAlone) {
  const Sample sample;
  BopResults results = sample.Truth();
  for (BopEstimate& e : results.estimates) {
    if (e.obj_id == 2) e.camera_from_object.t.x() += 0.002;
  }
  EXPECT_NEAR(sample.Score(results).rel_mm, 2.0, 0.01);
  // A common motion of both is no relative error.
  for (BopEstimate& e : results.estimates) {
    if (e.obj_id == 1) e.camera_from_object.t.x() += 0.002;
  }
  EXPECT_NEAR(sample.Score(results).rel_mm, 0.0, 1e-9);
}

TEST(BopEvaluate, ADatasetWithoutTruthOrModelsIsRefused) {
  Sample sample;
  std::filesystem::remove(sample.folder.path() + "/val/000001/scene_gt.json");
  EXPECT_EQ(EvaluateBopResults(sample.dataset, "val", {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  sample.dataset.objects[0].mesh_path.clear();
  EXPECT_THAT(std::string(EvaluateBopResults(sample.dataset, "val", {}).status().message()),
              testing::HasSubstr("object 1"));
}

}  // namespace
}  // namespace horopter
