#include "server/vision/recognition/aspect_scenes/standing_search.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <numbers>
#include <random>

#include "server/vision/recognition/aspect_scenes/object_on_plane.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/scene_search.h"
#include "tests/support/part_photos.h"

namespace horopter {
namespace {

constexpr int kAngle = 0, kBlock = 1, kCylinder = 2;

// An angle, a block and a cylinder on the plane z = 0 before three cameras; made once.
class StandingSearch : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    parts_ = new std::vector<PhotoPart>(AngleBlockCylinder({0.03, 0.02, 0.012}, 0.018, 0.012));
    for (const PhotoPart& p : *parts_) {
      list_.push_back({&p.object, &p.fragments, p.model.symmetries});
      list_.back().resting = {{Eigen::Vector3d::UnitZ(), 0.012},
                              {-Eigen::Vector3d::UnitZ(), 0.012}};
    }
    list_[kCylinder].round.push_back({Eigen::Vector3d::UnitZ(), Eigen::Vector3d::Zero(), 0});
    index_ = new FragmentIndex(BuildFragmentIndex(list_));
  }
  static void TearDownTestSuite() {
    delete index_;
    delete parts_;
  }

  static PinholeCamera Camera() { return CenteredCamera(640, 480, 700.0); }

  // Looking down on the plane from the side, turned about the vertical.
  static std::vector<std::optional<AspectSceneView>> Views() {
    std::vector<std::optional<AspectSceneView>> out;
    for (const double turn : {-0.35, 0.0, 0.4}) {
      AspectSceneView view;
      view.camera = Camera();
      view.camera_from_scene.R = (Eigen::AngleAxisd(M_PI - 0.75, Eigen::Vector3d::UnitX()) *
                                  Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()))
                                     .toRotationMatrix();
      view.camera_from_scene.t = {0.0, 0.0, 0.36};
      view.prior_log_focal = std::log(view.camera.focal_px);
      out.push_back(view);
    }
    return out;
  }

  static Rigid3 Standing(double x, double y, double yaw) {
    Rigid3 pose = Turn(Eigen::Vector3d::UnitZ(), yaw);
    pose.t = {x, y, 0.012};
    return pose;
  }
  static AspectSceneObject AngleThere() { return {kAngle, Standing(-0.05, 0.01, 0.4)}; }
  static AspectSceneObject BlockThere() { return {kBlock, Standing(0.055, -0.015, 1.1)}; }
  static AspectSceneObject CylinderThere() { return {kCylinder, Standing(0.03, 0.055, 0.0)}; }

  static std::vector<AspectImage> Images(const std::vector<AspectSceneObject>& objects) {
    std::vector<AspectImage> out;
    for (const auto& view : Views()) {
      std::vector<std::pair<double, int>> order;
      for (std::size_t o = 0; o < objects.size(); ++o) {
        order.push_back(
            {-(view->camera_from_scene * objects[o].scene_from_object.t).z(), static_cast<int>(o)});
      }
      std::sort(order.begin(), order.end());
      std::vector<std::pair<const RenderMesh*, Rigid3>> drawn;
      for (const auto& [depth, o] : order) {
        drawn.emplace_back(&(*parts_)[objects[o].object].object.mesh,
                           view->camera_from_scene * objects[o].scene_from_object);
      }
      out.push_back(MakeAspectImage(PhotoOf(drawn, view->camera)));
    }
    return out;
  }

  static double WorstPx(const AspectSceneObject& found, const AspectSceneObject& truth) {
    double worst = 0.0;
    for (const auto& view : Views()) {
      worst = std::max(worst,
                       PoseDistancePx(list_[truth.object],
                                      view->camera,
                                      view->camera_from_scene * found.scene_from_object,
                                      view->camera,
                                      view->camera_from_scene * truth.scene_from_object));
    }
    return worst;
  }

  static std::vector<PhotoPart>* parts_;
  static std::vector<AspectModel> list_;
  static FragmentIndex* index_;
};

std::vector<PhotoPart>* StandingSearch::parts_ = nullptr;
std::vector<AspectModel> StandingSearch::list_;
FragmentIndex* StandingSearch::index_ = nullptr;

TEST_F(StandingSearch, ThePlaneIsWhereMostPartsRest) {
  const std::vector<AspectSceneObject> objects = {AngleThere(), BlockThere()};
  const auto planes = PlanesUnder(objects, list_, Views());
  ASSERT_EQ(planes.size(), 1u);
  EXPECT_EQ(planes[0].objects, 2);
  EXPECT_GT(planes[0].normal.z(), 0.999);
  EXPECT_NEAR(planes[0].offset_m, 0.0, 1e-6);
}

TEST_F(StandingSearch, ThePlaneOfABlockThatOnePartStandsOnIsSecond) {
  std::vector<AspectSceneObject> objects = {AngleThere(), BlockThere(), CylinderThere()};
  objects[2].scene_from_object.t.z() += 0.03;
  const auto planes = PlanesUnder(objects, list_, Views());
  ASSERT_EQ(planes.size(), 2u);
  EXPECT_NEAR(planes[0].offset_m, 0.0, 1e-6);
  EXPECT_NEAR(planes[1].offset_m, 0.03, 1e-6);
}

// A part on what is no part, and a tall one beside it: what either stands on is as likely, but for
// what the lower plane may carry.
TEST_F(StandingSearch, OfTwoHeightsTheLowerIsTheGround) {
  std::vector<AspectModel> parts = list_;
  parts[kBlock].resting = {{Eigen::Vector3d::UnitX(), 0.03}};  // on end
  AspectSceneObject tall = BlockThere();
  tall.scene_from_object =
      tall.scene_from_object * Turn(Eigen::Vector3d::UnitY(), -0.5 * std::numbers::pi);
  tall.scene_from_object.t.z() = 0.03;
  AspectSceneObject raised = AngleThere();
  raised.scene_from_object.t.z() += 0.02;
  const std::vector<AspectSceneObject> objects = {raised, tall};
  const auto planes = PlanesUnder(objects, parts, Views());
  ASSERT_EQ(planes.size(), 2u);
  EXPECT_NEAR(planes[0].offset_m, 0.0, 1e-6);
  EXPECT_NEAR(planes[1].offset_m, 0.02, 1e-6);
}

TEST_F(StandingSearch, NoPlaneWithoutARestingPart) {
  EXPECT_TRUE(PlanesUnder({}, list_, Views()).empty());
  AspectSceneObject tilted = AngleThere();
  std::vector<AspectModel> faceless = list_;
  faceless[kAngle].resting.clear();
  EXPECT_TRUE(PlanesUnder({&tilted, 1}, faceless, Views()).empty());
  // Upside down below the plane: the cameras would be under it.
  AspectSceneObject hanging = AngleThere();
  hanging.scene_from_object = hanging.scene_from_object * Turn(Eigen::Vector3d::UnitX(), M_PI);
  for (AspectModel& part : faceless) part.resting = {{Eigen::Vector3d::UnitZ(), 0.012}};
  EXPECT_TRUE(PlanesUnder({&hanging, 1}, faceless, Views()).empty());
}

TEST_F(StandingSearch, PartsLieOnThePlaneOfOthersAndOnTheirTops) {
  const std::vector<AspectSceneObject> objects = {AngleThere(), BlockThere()};
  const auto planes = PlanesToLieOn(objects, list_, Views());
  const AspectModel& cylinder = list_[kCylinder];
  Rigid3 pose = CylinderThere().scene_from_object;
  EXPECT_TRUE(LiesOn(planes, pose, cylinder));
  pose.t.z() += 0.004;  // in the air
  EXPECT_FALSE(LiesOn(planes, pose, cylinder));
  pose.t.z() = 0.036;  // on the block
  EXPECT_TRUE(LiesOn(planes, pose, cylinder));
  EXPECT_TRUE(LiesOn(planes, pose * Turn(Eigen::Vector3d::UnitX(), M_PI), cylinder));
  EXPECT_TRUE(LiesOn(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.03), cylinder));
  EXPECT_FALSE(LiesOn(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.06), cylinder));
  EXPECT_TRUE(LiesOn(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.06), cylinder, 1.8));
  EXPECT_FALSE(LiesOn(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.09), cylinder, 1.8));
  EXPECT_FALSE(LiesOn(planes, pose * Turn(Eigen::Vector3d::UnitX(), M_PI_2), cylinder));
  EXPECT_FALSE(LiesOn(PlanesToLieOn({}, list_, Views()), pose, cylinder));
  AspectModel round = cylinder;  // rests on nothing
  round.resting.clear();
  EXPECT_FALSE(LiesOn(planes, pose, round));
  EXPECT_FALSE(Leans(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.5), round));
  for (const double height : {0.036, 0.05}) {  // level, whatever it stands on
    pose.t.z() = height;
    EXPECT_TRUE(IsLevel(planes, pose, cylinder));
    EXPECT_TRUE(IsLevel(planes, pose * Turn(Eigen::Vector3d::UnitX(), M_PI), cylinder));
    EXPECT_FALSE(IsLevel(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.06), cylinder));
    EXPECT_FALSE(IsLevel({}, pose, cylinder));
    EXPECT_FALSE(IsLevel(planes, pose, round));
    EXPECT_FALSE(Leans(planes, pose, cylinder));
    EXPECT_FALSE(Leans(planes, pose * Turn(Eigen::Vector3d::UnitX(), M_PI), cylinder));
    EXPECT_FALSE(Leans(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.2), cylinder));
    EXPECT_TRUE(Leans(planes, pose * Turn(Eigen::Vector3d::UnitX(), 0.4), cylinder));
    EXPECT_TRUE(Leans(planes, pose * Turn(Eigen::Vector3d::UnitY(), 0.7), cylinder));
    EXPECT_FALSE(Leans({}, pose * Turn(Eigen::Vector3d::UnitX(), 0.7), cylinder));
  }
}

TEST_F(StandingSearch, NothingIsLevelBelowTheGround) {
  const std::vector<AspectSceneObject> objects = {AngleThere(), BlockThere()};
  const auto planes = PlanesToLieOn(objects, list_, Views());
  Rigid3 pose = CylinderThere().scene_from_object;
  EXPECT_TRUE(IsLevel(planes, pose, list_[kCylinder]));
  pose.t.z() = 0.012 - 0.005;
  EXPECT_FALSE(IsLevel(planes, pose, list_[kCylinder]));
}

// A turned pose does so by chance where a face meets a plane: how often is what its score may be
// lower by.
TEST_F(StandingSearch, TurnedPosesHardlyEverLie) {
  constexpr unsigned kSeed = 20261124;
  std::mt19937 random(kSeed);
  std::normal_distribution<double> turn;
  std::uniform_real_distribution<double> place(-0.1, 0.1);
  const std::vector<AspectSceneObject> objects = {AngleThere(), BlockThere()};
  const auto planes = PlanesToLieOn(objects, list_, Views());
  int lying = 0;
  for (int i = 0; i < 20000; ++i) {
    Rigid3 pose;
    pose.R = Eigen::Quaterniond(turn(random), turn(random), turn(random), turn(random))
                 .normalized()
                 .toRotationMatrix();
    pose.t = {place(random), place(random), place(random)};
    lying += LiesOn(planes, pose, list_[kCylinder]);
  }
  EXPECT_LT(lying, 20) << "seed " << kSeed;
}

TEST_F(StandingSearch, ObjectsKnowWhetherTheyLieWithTheSureOnes) {
  const std::vector<AspectSceneObject> objects = {AngleThere(), BlockThere(), CylinderThere()};
  const std::vector<AspectImage> images = Images(objects);
  const std::vector<AspectViewPrior> priors(images.size());
  const std::vector<std::vector<AspectHypothesis>> none(images.size());
  const AspectLinkInput input{images, priors, none, list_};
  const AspectLinkOptions options;
  const StopRequested never;
  const SceneObjects scene(input, options, never);
  std::vector<LinkedObject> judged(3);
  for (int i = 0; i < 3; ++i) {
    judged[i].object = objects[i].object;
    judged[i].scene_from_object = objects[i].scene_from_object;
    judged[i].score = i < 2 ? 0.6 : 0.36;
  }
  scene.FindLying(Views(), kPlaneScore, &judged);
  for (const LinkedObject& o : judged) {
    EXPECT_TRUE(o.lies) << o.object;
    EXPECT_NEAR(scene.Value(o), o.score + kLyingBonus, 1e-12);
  }
  judged[2].scene_from_object.t.z() += 0.004;
  scene.FindLying(Views(), kPlaneScore, &judged);
  EXPECT_TRUE(judged[0].lies);
  EXPECT_FALSE(judged[2].lies);
  EXPECT_NEAR(scene.Value(judged[2]), judged[2].score, 1e-12);
  for (LinkedObject& o : judged) o.score = 0.4;  // none is sure
  scene.FindLying(Views(), kPlaneScore, &judged);
  for (const LinkedObject& o : judged) EXPECT_FALSE(o.lies) << o.object;
  scene.FindLying(Views(), 0.38, &judged);  // two of these lie together
  EXPECT_TRUE(judged[0].lies);
  EXPECT_TRUE(judged[1].lies);
  EXPECT_FALSE(judged[2].lies);
}

TEST_F(StandingSearch, APartNobodyHypothesisedIsFoundInItsPlace) {
  const std::vector<AspectSceneObject> there = {AngleThere(), BlockThere(), CylinderThere()};
  const std::vector<AspectImage> images = Images(there);
  const std::vector<AspectSceneObject> taken = {AngleThere()};
  const auto planes = PlanesUnder(taken, list_, Views());
  ASSERT_EQ(planes.size(), 1u);
  const auto found = FindStanding(images, Views(), list_, planes[0], taken);
  for (const AspectSceneObject& truth : {BlockThere(), CylinderThere()}) {
    const auto best = std::find_if(found.begin(), found.end(), [&](const StandingCandidate& c) {
      return c.placed.object == truth.object;
    });
    ASSERT_NE(best, found.end()) << truth.object;
    EXPECT_LT(WorstPx(best->placed, truth), truth.object == kCylinder ? 14.0 : 8.0);
    EXPECT_GT(best->support, 0.5);
  }
}

// What stands before a part is known: points that it hides are not asked for, and its own edges say
// nothing of what is behind it.
TEST_F(StandingSearch, ExplainedEdgesAreGoneAndWhatPartsHideIsKnown) {
  const std::vector<AspectSceneObject> taken = {AngleThere()};
  const std::vector<AspectImage> images = Images({AngleThere(), BlockThere()});
  const auto planes = PlanesUnder(taken, list_, Views());
  ASSERT_EQ(planes.size(), 1u);
  const StandingGround ground = MakeGround(images, Views(), planes[0], taken, list_);
  ASSERT_EQ(ground.images.size(), images.size());
  for (std::size_t v = 0; v < images.size(); ++v) {
    const auto near = [&](const AspectSceneObject& o, const AspectImage& image) {
      const double half = 0.55 * 700.0 * list_[o.object].object->mesh.diameter_m / 0.36;
      const Eigen::Vector3d center =
          o.scene_from_object * list_[o.object].object->mesh.center.cast<double>();
      const Eigen::Vector2d at =
          Project(ground.cameras[v], Eigen::Vector3d(ground.camera_from_scene[v] * center));
      return std::count_if(image.edges.begin(), image.edges.end(), [&](const ImageEdgePoint& e) {
        return (e.point.cast<double>() - at).norm() < half;
      });
    };
    EXPECT_LT(near(AngleThere(), ground.images[v]), 0.25 * near(AngleThere(), images[v])) << v;
    EXPECT_GT(near(BlockThere(), ground.images[v]), 0.9 * near(BlockThere(), images[v])) << v;
    const HidingMap& hiding = ground.hiding[v];
    const Eigen::Vector3d center =
        ground.camera_from_scene[v] *
        Eigen::Vector3d(AngleThere().scene_from_object * Eigen::Vector3d(0.0, 0.0, -0.011));
    const Eigen::Vector2d at = 0.5 * Project(ground.cameras[v], center);
    const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
    EXPECT_TRUE(hiding.Hides(x, y, static_cast<float>(center.z() + 0.05))) << v;
    EXPECT_FALSE(hiding.Hides(x, y, static_cast<float>(center.z() - 0.05))) << v;
    EXPECT_FALSE(hiding.Hides(-1, y, 10.0f));
    EXPECT_FALSE(hiding.Hides(2, 2, 10.0f));  // the table
  }
}

TEST_F(StandingSearch, APartHalfBehindAnotherIsFirst) {
  const AspectSceneObject behind{kBlock, Standing(-0.04, 0.055, 0.5)};
  const std::vector<AspectImage> images = Images({AngleThere(), behind});
  const std::vector<AspectSceneObject> taken = {AngleThere()};
  const auto planes = PlanesUnder(taken, list_, Views());
  ASSERT_EQ(planes.size(), 1u);
  const auto found = FindStanding(images, Views(), list_, planes[0], taken);
  ASSERT_FALSE(found.empty());
  EXPECT_EQ(found.front().placed.object, kBlock);
  EXPECT_LT(WorstPx(found.front().placed, behind), 8.0);
}

// Where the ground is seen no part is.
TEST_F(StandingSearch, NothingIsLookedForWhereTheGroundIsSeen) {
  std::vector<AspectImage> images = Images({AngleThere(), BlockThere()});
  const std::vector<AspectSceneObject> taken = {AngleThere()};
  const auto planes = PlanesUnder(taken, list_, Views());
  ASSERT_EQ(planes.size(), 1u);
  ASSERT_FALSE(FindStanding(images, Views(), list_, planes[0], taken).empty());
  for (AspectImage& image : images)
    image.ground.assign(static_cast<std::size_t>(image.half_width) * image.half_height, 1);
  EXPECT_TRUE(FindStanding(images, Views(), list_, planes[0], taken).empty());
}

TEST(Expected, FewPointsAreWorthLessThanMany) {
  EXPECT_LT(Expected(8.0, 8.0, 24.0), Expected(24.0, 24.0, 24.0));
  EXPECT_LT(Expected(24.0, 24.0, 24.0), Expected(96.0, 96.0, 24.0));
  EXPECT_LT(Expected(96.0, 96.0, 24.0), 1.0);
}

TEST_F(StandingSearch, NothingStandsOnAnEmptyTable) {
  const std::vector<AspectSceneObject> taken = {AngleThere()};
  const std::vector<AspectImage> images = Images(taken);
  const auto planes = PlanesUnder(taken, list_, Views());
  ASSERT_EQ(planes.size(), 1u);
  EXPECT_TRUE(FindStanding(images, Views(), list_, planes[0], taken).empty());
  EXPECT_TRUE(FindStanding({}, {}, list_, planes[0], taken).empty());
  const auto stopped =
      FindStanding(Images({AngleThere(), BlockThere()}), Views(), list_, planes[0], taken, {}, [] {
        return true;
      });
  EXPECT_TRUE(stopped.empty());
}

TEST_F(StandingSearch, WhatAnotherPartHidesIsNotMissed) {
  // The block right behind the angle, as the cameras look along +y.
  AspectSceneObject behind{kBlock, Standing(-0.04, 0.055, 0.5)};
  const std::vector<AspectSceneObject> there = {AngleThere(), behind};
  const std::vector<AspectImage> images = Images(there);
  const auto views = Views();
  const RenderMesh& mesh = list_[kBlock].object->mesh;
  const Rigid3 pose = views[1]->camera_from_scene * behind.scene_from_object;
  const ObjectLayer layer =
      MakeObjectLayer(images[1],
                      WorkingEdges(images[1],
                                   list_[kAngle].object->mesh,
                                   views[1]->camera,
                                   views[1]->camera_from_scene * AngleThere().scene_from_object,
                                   200.0),
                      views[1]->camera);
  ASSERT_GT(layer.width, 0);
  const ObjectLayer* others[] = {&layer};
  const AspectScore alone = ScorePose(images[1], mesh, views[1]->camera, pose);
  const AspectScore among = ScorePose(images[1], mesh, views[1]->camera, pose, {}, others);
  EXPECT_EQ(alone.hidden_px, 0.0);
  EXPECT_GT(among.hidden_px, 10.0);
  EXPECT_NEAR(among.hidden_px + among.claimed_px + among.visible_px, alone.visible_px, 1e-3);
  EXPECT_GT(among.precision, alone.precision + 0.05);
  EXPECT_GE(among.recall, alone.recall);
}

// The views agree only on a round part, whose turn they do not show: what else is seen settles it.
TEST_F(StandingSearch, RoundPartsLinkViewsByTheTurnThatOthersBearOut) {
  const std::vector<AspectSceneObject> there = {AngleThere(), BlockThere(), CylinderThere()};
  const std::vector<AspectImage> images = Images(there);
  const auto views = Views();
  std::vector<AspectViewPrior> priors;
  std::vector<std::vector<AspectHypothesis>> hypotheses(images.size());
  for (std::size_t v = 0; v < images.size(); ++v) {
    priors.push_back({Camera(), 0.05});
    for (const AspectSceneObject& o : there) {
      // The angle is hypothesised in the first view only, the block in the second only.
      if ((o.object == kAngle && v != 0) || (o.object == kBlock && v != 1)) continue;
      AspectHypothesis h;
      h.object = o.object;
      h.camera = Camera();
      h.camera_from_object =
          views[v]->camera_from_scene * o.scene_from_object *
          (o.object == kCylinder ? Turn(Eigen::Vector3d::UnitZ(), 1.7 * v) : Rigid3{});
      h.score = 0.7;
      hypotheses[v].push_back(h);
    }
  }
  AspectLinkOptions options;
  options.standing = 0;
  const LinkedScene scene = SearchScene({images, priors, hypotheses, list_}, options);
  EXPECT_EQ(scene.registered(), 3);
  ASSERT_EQ(scene.objects.size(), 3u);
  for (const AspectSceneObject& truth : there) {
    const auto found = std::find_if(scene.objects.begin(), scene.objects.end(), [&](const auto& o) {
      return o.object == truth.object;
    });
    ASSERT_NE(found, scene.objects.end()) << truth.object;
    for (std::size_t v = 0; v < views.size(); ++v) {
      ASSERT_TRUE(scene.views[v].has_value());
      EXPECT_LT(PoseDistancePx(list_[truth.object],
                               scene.views[v]->camera,
                               scene.views[v]->camera_from_scene * found->scene_from_object,
                               views[v]->camera,
                               views[v]->camera_from_scene * truth.scene_from_object),
                truth.object == kCylinder ? 12.0 : 5.0)
          << "part " << truth.object << " view " << v;
    }
  }
}

}  // namespace
}  // namespace horopter
