#include "tests/diagnose/true_world.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "tests/diagnose/camera_report.h"
#include "tests/diagnose/match_report.h"

namespace horopter {
namespace {

using ::testing::HasSubstr;

constexpr int kViews = 4, kParts = 3;

// Cameras on an arc around three parts; as files without cam_R_w2c give it, and what is true.
struct Photographed {
  BopScene scene;
  TrueModels models;
  std::vector<Rigid3> camera_from_world;
};

ObjectModel RandomPart(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(-0.04, 0.04);
  ObjectModel model;
  for (int k = 0; k < 10; ++k) model.vertices.emplace_back(u(*rng), u(*rng), u(*rng));
  model.mesh.vertices = model.vertices;
  return model;
}

Photographed TakePhotographs(unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u(-0.15, 0.15);
  Photographed out;
  std::vector<Rigid3> placed;
  for (int k = 0; k < kParts; ++k) {
    out.models[k + 1] = RandomPart(&rng);
    const Eigen::Vector3d axis(u(rng), u(rng), u(rng));
    placed.push_back({Eigen::AngleAxisd(10.0 * u(rng), axis.normalized()).toRotationMatrix(),
                      {u(rng), u(rng), 0.2 * u(rng)}});
  }
  for (int v = 0; v < kViews; ++v) {
    const Rigid3 pose = {(Eigen::AngleAxisd(0.9, Eigen::Vector3d::UnitX()) *
                          Eigen::AngleAxisd(0.3 * v, Eigen::Vector3d::UnitZ()))
                             .toRotationMatrix(),
                         {0.01 * v, -0.01, 0.8}};
    out.camera_from_world.push_back(pose);
    BopImage image;
    image.im_id = v;
    image.camera = CenteredCamera(640, 480, 800.0);
    for (int k = 0; k < kParts; ++k) image.instances.push_back({k + 1, pose * placed[k], 1.0});
    out.scene.images.push_back(image);
  }
  return out;
}

Rigid3 Relative(const Rigid3& a, const Rigid3& b) {
  return b * a.Inverse();
}

// Of the true and the found motion between two images.
double TurnError(const Photographed& truth, const BopScene& found, int a, int b) {
  const Rigid3 true_b_from_a = Relative(truth.camera_from_world[a], truth.camera_from_world[b]);
  const Rigid3 b_from_a =
      Relative(found.images[a].camera_from_world, found.images[b].camera_from_world);
  return Eigen::AngleAxisd(true_b_from_a.R.transpose() * b_from_a.R).angle() +
         (true_b_from_a.t - b_from_a.t).norm();
}

void Drop(int obj_id, int view, BopScene* scene) {
  std::erase_if(scene->images[view].instances,
                [obj_id](const BopInstance& i) { return i.obj_id == obj_id; });
}

TEST(CompleteTruth, CamerasFollowFromAPartThatIsInAllImages) {
  const Photographed taken = TakePhotographs(1);
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  EXPECT_EQ(PosedImages(world.scene), kViews);
  for (int b = 1; b < kViews; ++b) EXPECT_LT(TurnError(taken, world.scene, 0, b), 1e-6);
  ASSERT_TRUE(world.rms_px);
  EXPECT_LT(*world.rms_px, 1e-3);
  EXPECT_TRUE(world.notes.empty());
}

TEST(CompleteTruth, CamerasFollowFromPartsThatSpanTheImages) {
  Photographed taken = TakePhotographs(2);
  for (int v : {2, 3}) Drop(1, v, &taken.scene);  // part 1 in images 0, 1
  for (int v : {0, 3}) Drop(2, v, &taken.scene);  // part 2 in images 1, 2
  for (int v : {0, 1}) Drop(3, v, &taken.scene);  // part 3 in images 2, 3
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  EXPECT_EQ(PosedImages(world.scene), kViews);
  for (int b = 1; b < kViews; ++b) EXPECT_LT(TurnError(taken, world.scene, 0, b), 1e-6);
}

TEST(CompleteTruth, AnImageThatSharesNoPartHasNoPoseAndIsNamed) {
  Photographed taken = TakePhotographs(3);
  for (int v : {0, 1, 2}) Drop(3, v, &taken.scene);
  for (int id : {1, 2}) Drop(id, 3, &taken.scene);
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  EXPECT_EQ(PosedImages(world.scene), 3);
  EXPECT_FALSE(world.scene.images[3].has_pose);
  ASSERT_EQ(world.notes.size(), 1u);
  EXPECT_THAT(world.notes[0], HasSubstr("image 3"));
}

TEST(CompleteTruth, EntriesOfOneIndexAreOnePartThoughListsDiffer) {
  Photographed taken = TakePhotographs(4);
  Drop(1, 0, &taken.scene);
  Drop(2, 2, &taken.scene);
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  for (const BopImage& image : world.scene.images) {
    ASSERT_EQ(image.instances.size(), static_cast<size_t>(kParts));
    for (int i = 0; i < kParts; ++i) {
      EXPECT_EQ(image.instances[i].obj_id, world.scene.images[0].instances[i].obj_id);
    }
  }
  // What image 0 does not list is where the others see it, and counts as hidden.
  const Photographed full = TakePhotographs(4);
  const BopInstance& absent = world.scene.images[0].instances[2];
  EXPECT_EQ(absent.obj_id, 1);
  EXPECT_EQ(absent.visib_fract, 0.0);
  EXPECT_LT(
      (absent.camera_from_object.t - full.scene.images[0].instances[0].camera_from_object.t).norm(),
      1e-6);
}

TEST(CompleteTruth, ASymmetryOfAnAnnotationDoesNotTurnTheCamera) {
  Photographed taken = TakePhotographs(5);
  Rigid3 half_turn;
  half_turn.R.diagonal() << -1, -1, 1;
  taken.models[1].symmetries.push_back(half_turn);
  for (int v : {1, 3}) {
    Rigid3& pose = taken.scene.images[v].instances[0].camera_from_object;
    pose = pose * half_turn;
  }
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  for (int b = 1; b < kViews; ++b) EXPECT_LT(TurnError(taken, world.scene, 0, b), 1e-6);
}

TEST(CompleteTruth, APartThatMovesAgainstTheOthersIsNamedAndOutvoted) {
  Photographed taken = TakePhotographs(6);
  for (int v = 0; v < kViews; ++v) {
    Rigid3& pose = taken.scene.images[v].instances[1].camera_from_object;
    pose.R = pose.R * Eigen::AngleAxisd(0.6 * v, Eigen::Vector3d::UnitX()).toRotationMatrix();
  }
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  for (int b = 1; b < kViews; ++b) EXPECT_LT(TurnError(taken, world.scene, 0, b), 0.01);
  ASSERT_EQ(world.notes.size(), 1u);
  EXPECT_THAT(world.notes[0], HasSubstr("object 2"));
}

TEST(CompleteTruth, TwoOfOneKindAreToldApartByWhereTheyAre) {
  Photographed taken = TakePhotographs(7);
  for (int v = 0; v < kViews; ++v) {
    BopInstance second = taken.scene.images[v].instances[0];
    second.camera_from_object =
        second.camera_from_object * Rigid3{Eigen::Matrix3d::Identity(), {0.1, 0.0, 0.0}};
    taken.scene.images[v].instances.push_back(second);
  }
  Drop(1, 2, &taken.scene);
  BopInstance only = TakePhotographs(7).scene.images[2].instances[0];
  only.camera_from_object =
      only.camera_from_object * Rigid3{Eigen::Matrix3d::Identity(), {0.1, 0.0, 0.0}};
  taken.scene.images[2].instances.push_back(only);  // the second one, first of its kind in the list
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  ASSERT_EQ(world.scene.images[2].instances.size(), 4u);
  EXPECT_EQ(world.scene.images[2].instances[0].visib_fract, 0.0);
  EXPECT_LT(
      (world.scene.images[2].instances[3].camera_from_object.t - only.camera_from_object.t).norm(),
      1e-9);
}

TEST(CompleteTruth, PosesOfTheFileStay) {
  Photographed taken = TakePhotographs(8);
  for (int v = 0; v < 3; ++v) {
    taken.scene.images[v].has_pose = true;
    taken.scene.images[v].camera_from_world = taken.camera_from_world[v];
  }
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  for (int v = 0; v < 3; ++v) {
    EXPECT_EQ(world.scene.images[v].camera_from_world.R, taken.camera_from_world[v].R);
  }
  EXPECT_TRUE(world.scene.images[3].has_pose);
  EXPECT_LT(TurnError(taken, world.scene, 0, 3), 1e-6);
}

// What the file did not say was once taken for cameras in one place: everything was wrong.
TEST(Truth, ThatIsNotThereIsNotAWrongAnswer) {
  Photographed taken = TakePhotographs(9);
  for (BopImage& image : taken.scene.images) image.instances.clear();
  taken.models[1].id = BopObjectName(1);
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  EXPECT_EQ(PosedImages(world.scene), 0);
  std::vector<std::optional<EstimatedView>> views;
  for (int v = 0; v < kViews; ++v) {
    views.push_back(EstimatedView{taken.scene.images[v].camera, taken.camera_from_world[v]});
  }
  const auto corners = TrueWorldCorners(world.scene, taken.models);
  for (Freedom freedom : {Freedom::kSimilarity, Freedom::kCollineation}) {
    EXPECT_FALSE(CompareCameras(views, world.scene, corners, freedom).measured);
  }
  std::vector<ImageFeatures> features(kViews);
  for (ImageFeatures& f : features) f.junctions.resize(1);
  MatchingResult matching;
  PairGeometry pair = {0, 1, Eigen::Matrix3d::Identity(), {{0, 0, 0.0}}, {}, ""};
  matching.pairs.push_back(pair);
  const std::vector<TrueView> nothing(kViews);
  EXPECT_EQ(CompareMatches(matching, world, taken.models, features, nothing).matches, 0);
  // With the parts the same match counts.
  const Photographed full = TakePhotographs(9);
  const TrueWorld known = CompleteTruth(full.scene, full.models);
  EXPECT_EQ(CompareMatches(matching, known, full.models, features, nothing).matches, 1);
}

TEST(Truth, OfPhotographsMeasuresTheirTrueCameras) {
  const Photographed taken = TakePhotographs(10);
  const TrueWorld world = CompleteTruth(taken.scene, taken.models);
  std::vector<std::optional<EstimatedView>> views;
  for (int v = 0; v < kViews; ++v) {
    views.push_back(EstimatedView{taken.scene.images[v].camera, taken.camera_from_world[v]});
  }
  const CameraFinding finding = CompareCameras(
      views, world.scene, TrueWorldCorners(world.scene, taken.models), Freedom::kSimilarity);
  EXPECT_TRUE(finding.measured);
  EXPECT_TRUE(finding.recovered);
}

}  // namespace
}  // namespace horopter
