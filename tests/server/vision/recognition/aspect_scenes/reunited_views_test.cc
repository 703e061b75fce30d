#include "server/vision/recognition/aspect_scenes/reunited_views.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>

namespace horopter {
namespace {

constexpr int kViews = 4;
constexpr double kTurn = 2.0 * std::numbers::pi / 5.0;

Rigid3 TurnZ(double angle) {
  return {Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
          Eigen::Vector3d::Zero()};
}

// A star of five points at the origin, that all views show, joins views 0 and 1 with 2 and 3 by a
// wrong one of its turns: two parts beside it, without symmetries, are there twice.
class ReunitedScenesTest : public testing::Test {
 protected:
  ReunitedScenesTest() {
    for (int k = 1; k < 5; ++k) star_turns_.push_back(TurnZ(k * kTurn));
    parts_.resize(3);
    for (ObjectAspects& o : aspects_) o.mesh.diameter_m = 0.06;
    for (int p = 0; p < 3; ++p) parts_[p].object = &aspects_[p];
    parts_[0].symmetries = star_turns_;
    const Rigid3 wrong = TurnZ(kTurn);
    for (int v = 0; v < kViews; ++v) {
      AspectSceneView view;
      view.camera = CenteredCamera(640, 480, 700.0);
      view.camera_from_scene = {
          Eigen::AngleAxisd(2.4 + 0.2 * v, Eigen::Vector3d::UnitX()).toRotationMatrix(),
          Eigen::Vector3d(0.02 * v, 0.0, 0.5)};
      truth_.push_back(view.camera_from_scene);
      if (v >= 2) view.camera_from_scene = view.camera_from_scene * wrong.Inverse();
      scene_.views.emplace_back(view);
    }
    Add(0, {}, {0, 1, 2, 3});
    for (const int part : {1, 2}) {
      place_[part].t = {0.1 * part, -0.05, 0.0};
      place_[part].R = TurnZ(0.3 * part).R;
      Add(part, place_[part], {0, 1});
      Add(part, wrong * place_[part], {2, 3});
    }
  }

  void Add(int part, const Rigid3& pose, const std::vector<int>& shown) {
    LinkedObject o;
    o.object = part;
    o.scene_from_object = pose;
    o.views.resize(kViews);
    o.shown.assign(kViews, false);
    for (const int v : shown) {
      o.shown[v] = true;
      o.views[v].score = 0.6;
    }
    scene_.objects.push_back(o);
  }

  std::vector<AspectScene> Reunited(std::size_t most = 10) const {
    return ReunitedScenes(scene_, parts_, most);
  }

  std::array<ObjectAspects, 3> aspects_;
  std::vector<Rigid3> star_turns_;
  std::vector<AspectModel> parts_;
  std::array<Rigid3, 3> place_;
  std::vector<Rigid3> truth_;  // camera from scene
  LinkedScene scene_;
};

TEST_F(ReunitedScenesTest, ViewsAreTurnedUntilWhatStandsTwiceIsOne) {
  const std::vector<AspectScene> found = Reunited();
  ASSERT_FALSE(found.empty());
  EXPECT_EQ(found[0].objects.size(), 3u);
  for (int v = 0; v < kViews; ++v) {
    EXPECT_TRUE(found[0].views[v]->camera_from_scene.R.isApprox(truth_[v].R, 1e-9)) << v;
    EXPECT_TRUE(found[0].views[v]->camera_from_scene.t.isApprox(truth_[v].t, 1e-9)) << v;
  }
  EXPECT_EQ(found.size(), 1u) << "both pairs say the same";
  EXPECT_TRUE(Reunited(0).empty());
}

TEST_F(ReunitedScenesTest, PosesMayBeOffByAFewMillimetres) {
  const LinkedScene exact = scene_;
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    scene_ = exact;
    std::mt19937 random(seed);
    std::normal_distribution<double> off(0.0, 0.003);
    for (LinkedObject& o : scene_.objects)
      o.scene_from_object.t += Eigen::Vector3d(off(random), off(random), off(random));
    const std::vector<AspectScene> found = Reunited();
    ASSERT_EQ(found.size(), 1u);
    EXPECT_EQ(found[0].objects.size(), 3u);
    for (int v = 0; v < kViews; ++v) {
      EXPECT_TRUE(found[0].views[v]->camera_from_scene.R.isApprox(truth_[v].R, 1e-9)) << v;
      EXPECT_LT((found[0].views[v]->camera_from_scene.t - truth_[v].t).norm(), 0.02) << v;
    }
  }
}

TEST_F(ReunitedScenesTest, WhatOnlyTheTurnedViewsShowGoesWithThem) {
  scene_.objects.erase(scene_.objects.begin() + 3);  // the first of part 2
  const std::vector<AspectScene> found = Reunited();
  ASSERT_EQ(found.size(), 1u);
  ASSERT_EQ(found[0].objects.size(), 3u);
  EXPECT_EQ(found[0].objects[2].object, 2);
  EXPECT_TRUE(found[0].objects[2].scene_from_object.t.isApprox(place_[2].t, 1e-9));
}

TEST_F(ReunitedScenesTest, NoneOfWhatOneViewShowsTwice) {
  for (const std::size_t o : {1u, 3u}) {
    scene_.objects[o].shown[2] = true;
    scene_.objects[o].views[2].score = 0.6;
  }
  EXPECT_TRUE(Reunited().empty());
  // A view that should show it, and does not, is none that does.
  for (const std::size_t o : {1u, 3u}) scene_.objects[o].views[2].score = 0.1;
  EXPECT_FALSE(Reunited().empty());
}

// What all views show does not stay in its place, and one other part alone becomes one.
TEST_F(ReunitedScenesTest, NoneWhereAsMuchContradicts) {
  scene_.objects[0].scene_from_object.t = {0.3, 0.3, 0.0};
  EXPECT_TRUE(Reunited().empty());
}

// Two equal parts far from each other, each before cameras of its own.
TEST_F(ReunitedScenesTest, NoneWhereNothingElseAgrees) {
  scene_.objects.resize(3);
  scene_.objects[0].scene_from_object.t = {0.3, 0.3, 0.0};
  EXPECT_TRUE(Reunited().empty());
  scene_.objects.erase(scene_.objects.begin());
  EXPECT_TRUE(Reunited().empty());
  scene_.objects.clear();
  EXPECT_TRUE(Reunited().empty());
}

}  // namespace
}  // namespace horopter
