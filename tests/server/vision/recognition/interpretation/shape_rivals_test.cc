// Answers held against their mirror images, look-alikes of the catalog and stretched copies.
#include "server/vision/recognition/interpretation/shape_rivals.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <optional>

#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/shape_strain.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/shaded_photo.h"
#include "tests/support/solid_meshes.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

enum Part { kHanded, kMirrored, kLonger, kBare, kParts };

void AddBox(const Eigen::Vector3d& half, const Eigen::Vector3d& center, ObjectModel* model) {
  Append(BoxMesh(half), center, &model->mesh);
  const int first = static_cast<int>(model->vertices.size());
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d sign(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
    model->vertices.push_back(center + half.cwiseProduct(sign));
  }
  for (int i = 0; i < 8; ++i) {
    for (const int bit : {1, 2, 4}) {
      if (i & bit) continue;
      const int a = first + i, b = first + (i | bit);
      model->edges.push_back(
          {CurveKind::kLine, a, b, 1.57, {model->vertices[a], model->vertices[b]}});
    }
  }
}

const Eigen::Vector3d kLowerPeg{-0.03, 0.02, 0.015};

// A slab with two different pegs; both: else the lower one is missing.
ObjectModel Slab(const char* id, const Eigen::Vector3d& scale, bool both = true) {
  ObjectModel model;
  model.id = id;
  AddBox({0.05, 0.03, 0.01}, Eigen::Vector3d::Zero(), &model);
  AddBox({0.008, 0.006, 0.012}, {0.036, 0.02, 0.022}, &model);
  if (both) AddBox({0.012, 0.005, 0.005}, kLowerPeg, &model);
  for (auto& v : model.vertices) v = v.cwiseProduct(scale);
  for (auto& e : model.edges) {
    for (auto& p : e.polyline) p = p.cwiseProduct(scale);
  }
  for (auto& v : model.mesh.vertices) v = v.cwiseProduct(scale);
  for (auto& t : model.mesh.triangles) {
    if (scale.prod() < 0.0) std::swap(t[1], t[2]);
  }
  for (const auto& a : model.mesh.vertices) {
    for (const auto& b : model.mesh.vertices)
      model.diameter_m = std::max(model.diameter_m, (a - b).norm());
  }
  return model;
}

class ShapeRivals : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    parts_ = new std::vector<std::shared_ptr<const PreparedObject>>;
    const auto add = [](ObjectModel model) {
      parts_->push_back(PrepareObject(std::move(model), {.aspects = true}).value());
    };
    add(Slab("handed", {1, 1, 1}));
    add(Slab("mirrored", {-1, 1, 1}));
    add(Slab("longer", {1.06, 1, 1}));
    add(Slab("bare", {1, 1, 1}, false));
  }
  static void TearDownTestSuite() { delete parts_; }

  // Three views of one part in the origin, answered as another where only those of `catalog` are
  // enrolled, the first of them.
  void See(Part shown, const std::vector<Part>& catalog) {
    result_ = {};
    images_.clear();
    objects_.clear();
    for (const Part p : catalog) objects_.push_back((*parts_)[p]);
    context_.objects = objects_;
    for (int v = 0; v < 3; ++v) {
      const double a = 0.4 + 0.6 * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 800);
      const Rigid3 camera_from_scene =
          LookAt({0.25 * std::sin(a), -0.25 * std::cos(a), 0.22}, {0.0, 0.0, 0.0});
      images_.push_back(MakeAspectImage(
          ShadedPhoto({{&(*parts_)[shown]->model.mesh, camera_from_scene}}, camera)));
      result_.views.push_back(CalibratedCamera{camera, camera_from_scene});
    }
    SceneObject answer;
    answer.object = 0;
    answer.score = 0.99;
    std::vector<std::optional<AspectSceneView>> fixed;
    for (const auto& view : result_.views)
      fixed.push_back(AspectSceneView{view->camera, view->camera_from_scene, 0.0, 1.0});
    answer.scene_from_object =
        SettleInViews(
            images_, objects_[0]->aspects->object.mesh, fixed, {0, Rigid3()}, kFineRenderPx)
            ->placed.scene_from_object;
    result_.objects.push_back(answer);
    result_.state = RecognitionState::kRecognized;
    WeighShapes(context_, images_, &result_);
  }

  static std::vector<std::shared_ptr<const PreparedObject>>* parts_;
  std::vector<std::shared_ptr<const PreparedObject>> objects_;
  JointContext context_;
  std::vector<AspectImage> images_;
  RecognitionResult result_;
};

std::vector<std::shared_ptr<const PreparedObject>>* ShapeRivals::parts_ = nullptr;

TEST_F(ShapeRivals, APartThatIsThereStaysCertain) {
  See(kHanded, {kHanded, kMirrored, kBare, kLonger});
  ASSERT_EQ(result_.objects.size(), 1u) << result_.detail;
  EXPECT_EQ(result_.objects[0].object, 0);
  EXPECT_GT(result_.objects[0].pose_probability, 0.9) << result_.detail;
  EXPECT_EQ(result_.state, RecognitionState::kRecognized);
}

TEST_F(ShapeRivals, AMirrorImageIsNotAnsweredForThePart) {
  See(kMirrored, {kHanded});
  EXPECT_TRUE(result_.objects.empty());
  EXPECT_EQ(result_.state, RecognitionState::kNothingFound);
  EXPECT_NE(result_.detail.find("mirror"), std::string::npos) << result_.detail;
}

TEST_F(ShapeRivals, APartOfTheCatalogThatIsShownTakesThePlace) {
  See(kMirrored, {kHanded, kMirrored});
  ASSERT_EQ(result_.objects.size(), 1u) << result_.detail;
  EXPECT_EQ(result_.objects[0].object, 1);
  EXPECT_LT((result_.objects[0].scene_from_object.R - Eigen::Matrix3d::Identity()).norm(), 0.03);
  EXPECT_GT(result_.objects[0].pose_probability, 0.9) << result_.detail;

  See(kHanded, {kBare, kHanded});
  ASSERT_EQ(result_.objects.size(), 1u) << result_.detail;
  EXPECT_EQ(result_.objects[0].object, 1) << result_.detail;
}

// Only the part with both pegs is enrolled, and one without the lower one is shown.
TEST_F(ShapeRivals, AFeatureThatIsNotThereIsToldByName) {
  See(kBare, {kHanded});
  ASSERT_EQ(result_.objects.size(), 1u) << result_.detail;
  const SceneObject& answer = result_.objects[0];
  EXPECT_LT(answer.pose_probability, 0.7) << result_.detail;
  EXPECT_EQ(result_.state, RecognitionState::kAmbiguous);
  ASSERT_FALSE(answer.left_open.empty());
  const auto feature =
      std::find_if(answer.left_open.begin(), answer.left_open.end(), [](const auto& a) {
        return a.kind == AlternativeKind::kFeature;
      });
  ASSERT_NE(feature, answer.left_open.end()) << result_.detail;
  EXPECT_LT((feature->feature_place - kLowerPeg).norm(), 0.002);
  EXPECT_NEAR(feature->feature_size_m, 0.024, 0.002);
  double sum = answer.pose_probability;
  for (const SceneAlternative& a : answer.left_open) sum += a.probability;
  EXPECT_LE(sum, 1.0 + 1e-9);
  // From above it shows, from below it does not.
  double above = 0.0, below = 0.0;
  for (const ViewDifference& v : feature->views) {
    if (v.toward_camera.z() > 0.9) above = v.differing_px;
    if (v.toward_camera.z() < -0.9) below = v.differing_px;
  }
  EXPECT_GT(above, 20.0);
  EXPECT_LT(below, 1.0);
}

TEST_F(ShapeRivals, StrangersAreLikelierWhereMoreIsUnknown) {
  See(kBare, {kHanded});
  ASSERT_EQ(result_.objects.size(), 1u);
  const double usual = result_.objects[0].pose_probability;
  context_.options.unknown_share = 0.5;
  See(kBare, {kHanded});
  ASSERT_EQ(result_.objects.size(), 1u);
  EXPECT_LT(result_.objects[0].pose_probability, usual);
  context_.options.unknown_share = 0.001;
  See(kHanded, {kHanded});
  EXPECT_GT(result_.objects[0].pose_probability, 0.98);
}

// A block before one end of the part, seen by all three views.
TEST_F(ShapeRivals, WhatHidesAPartIsNotTakenForItsStretch) {
  ObjectModel block;
  block.id = "block";
  block.mesh = BoxMesh({0.02, 0.012, 0.025});
  block.diameter_m = 0.07;
  const auto prepared = PrepareObject(std::move(block), {.aspects = true}).value();
  objects_ = {(*parts_)[kHanded], prepared};
  context_.objects = objects_;
  Rigid3 before;
  before.t = {0.05, -0.045, 0.015};
  for (int v = 0; v < 3; ++v) {
    const double a = 0.2 + 0.4 * v;
    const PinholeCamera camera = CenteredCamera(640, 480, 800);
    const Rigid3 camera_from_scene =
        LookAt({0.25 * std::sin(a), -0.25 * std::cos(a), 0.22}, {0.0, 0.0, 0.0});
    images_.push_back(
        MakeAspectImage(ShadedPhoto({{&(*parts_)[kHanded]->model.mesh, camera_from_scene},
                                     {&prepared->model.mesh, camera_from_scene * before}},
                                    camera)));
    result_.views.push_back(CalibratedCamera{camera, camera_from_scene});
  }
  result_.objects.resize(2);
  result_.objects[0].object = 0;
  result_.objects[1].object = 1;
  result_.objects[1].scene_from_object = before;
  const RenderMesh& mesh = objects_[0]->aspects->object.mesh;
  const auto stretch = [&](std::span<const DepthBuffer> hidden) {
    return EstimateStrain(images_, mesh, result_.views, Rigid3(), hidden).strain.norm();
  };
  const auto hidden = DepthOfOthers(context_, images_, result_, 0);
  EXPECT_LT(stretch(hidden), 0.01);
  EXPECT_LT(stretch(hidden), 0.5 * stretch({}));
}

TEST_F(ShapeRivals, AStretchedCopyIsNotCertain) {
  See(kLonger, {kHanded});
  ASSERT_EQ(result_.objects.size(), 1u) << result_.detail;
  EXPECT_LT(result_.objects[0].pose_probability, 0.5) << result_.detail;
  EXPECT_EQ(result_.state, RecognitionState::kAmbiguous);
  EXPECT_NE(result_.detail.find("stretched"), std::string::npos) << result_.detail;
}

}  // namespace
}  // namespace horopter
