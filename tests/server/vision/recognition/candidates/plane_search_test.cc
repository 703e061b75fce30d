#include "server/vision/recognition/candidates/plane_search.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>

#include "server/vision/recognition/scene/plane_points.h"
#include "server/vision/recognition/scene/support_surface.h"
#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

TEST(SightPlane, SaysWhereAPixelsPointStandsAtEveryHeight) {
  PinholeCamera camera = CenteredCamera(640, 480, 900);
  camera.k1 = -0.08;
  const Rigid3 camera_from_table = LookAt({0.3, -0.5, 0.4}, {0, 0, 0});
  for (const double z : {0.0, 0.03, 0.1}) {
    const Eigen::Vector3d point(0.05, -0.02, z);
    PlaneSighting s;
    ASSERT_TRUE(
        SightPlane(camera, camera_from_table, Project(camera, camera_from_table * point), &s));
    EXPECT_LT((s.base + z * s.shift - point.head<2>()).norm(), 1e-6);
  }
}

TEST(SightPlane, RefusesRaysThatDoNotGoDown) {
  const PinholeCamera camera = CenteredCamera(640, 480, 300);
  PlaneSighting s;
  EXPECT_FALSE(SightPlane(camera, LookAt({0, -0.5, 0.1}, {0, 0, 0.1}), {320, 10}, &s));
}

TEST(PosesFromSightings, RecoversPoseAndScaleOfRandomPaths) {
  const unsigned seed = 11;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  int solved = 0, tried = 0;
  for (int trial = 0; trial < 500; ++trial) {
    Eigen::Vector3d vertices[3];
    for (Eigen::Vector3d& p : vertices) p << 0.05 * u(rng), 0.05 * u(rng), 0.03 * (1 + u(rng));
    if (trial % 5 == 0) vertices[1].head<2>() = vertices[0].head<2>();  // an upright edge first
    const double yaw = std::numbers::pi * u(rng), units = std::exp(u(rng));
    const Rigid3 plane_from_part = Standing(yaw, 0.1 * u(rng), 0.1 * u(rng), 0);
    const PinholeCamera camera = CenteredCamera(640, 480, 900);
    Rigid3 camera_from_table = LookAt({0.3 * u(rng), -0.5, 0.4}, {0, 0, 0});
    camera_from_table.t *= units;  // table units
    PlaneSighting sightings[3];
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d in_units = units * (plane_from_part * vertices[k]);
      ASSERT_TRUE(SightPlane(
          camera, camera_from_table, Project(camera, camera_from_table * in_units), &sightings[k]));
    }
    if ((vertices[2] - vertices[1]).head<2>().norm() < 0.01) continue;
    ++tried;
    PlaneYaw found[2];
    const int n = PosesFromSightings(vertices, sightings, 0.05, found);
    for (int k = 0; k < n; ++k) {
      if (std::abs(found[k].units_per_metre / units - 1) < 1e-6 &&
          std::abs(std::remainder(std::atan2(found[k].sin_yaw, found[k].cos_yaw) - yaw,
                                  2 * std::numbers::pi)) < 1e-6 &&
          (found[k].position - units * plane_from_part.t.head<2>()).norm() < 1e-6) {
        ++solved;
        break;
      }
    }
  }
  // Edges between upright and level by the bound have no yaw of their own.
  EXPECT_GT(solved, 0.93 * tried) << solved << " of " << tried;
}

TEST(PosesFromSightings, RefusesWhatNoPoseExplains) {
  const Eigen::Vector3d vertices[3] = {{0, 0, 0}, {0.05, 0, 0}, {0.05, 0.05, 0}};
  PlaneSighting sightings[3];
  sightings[1].base = {0.05, 0};
  sightings[2].base = {0.2, 0.0};
  PlaneYaw found[2];
  EXPECT_EQ(PosesFromSightings(vertices, sightings, 0.1, found), 0);
  sightings[1].base = sightings[2].base = {0, 0};
  EXPECT_EQ(PosesFromSightings(vertices, sightings, 0.1, found), 0);
}

TEST(PoseVotes, FindsTheHeaviestPosesAcrossCellBorders) {
  const unsigned seed = 12;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  PoseVotes votes;
  const auto vote = [&](double x, double y, double yaw, double units) {
    PlaneYaw pose;
    pose.position = {x, y};
    pose.cos_yaw = std::cos(yaw);
    pose.sin_yaw = std::sin(yaw);
    pose.units_per_metre = units;
    votes.Add(pose, 1.0);
  };
  for (int i = 0; i < 12; ++i) {  // yaw at the seam
    vote(0.1 + 0.001 * noise(rng),
         -0.05 + 0.001 * noise(rng),
         std::numbers::pi + 0.02 * noise(rng),
         1.0 + 0.005 * noise(rng));
  }
  for (int i = 0; i < 200; ++i) vote(0.3 * u(rng), 0.3 * u(rng), 3.1 * u(rng), std::exp(u(rng)));
  const auto peaks = votes.Peaks(4.0, 10);
  ASSERT_FALSE(peaks.empty());
  EXPECT_GE(peaks[0].weight, 8.0);
  EXPECT_LT((peaks[0].pose.position - Eigen::Vector2d(0.1, -0.05)).norm(), 0.004);
  EXPECT_LT(peaks[0].pose.cos_yaw, -0.99);
  EXPECT_TRUE(PoseVotes().Peaks(1.0, 10).empty());
}

TEST(StandingObjects, StandOnTheTable) {
  const auto object = PrepareObject(LBracket()).value();
  const std::vector<StandingObject> parts = StandingObjects(*object);
  ASSERT_GE(parts.size(), 3u);
  for (const StandingObject& part : parts) {
    double lowest = 1e9;
    for (const Eigen::Vector3d& v : part.vertices) lowest = std::min(lowest, v.z());
    EXPECT_NEAR(lowest, 0.0, 1e-9);
    EXPECT_NEAR(part.plane_from_object.R.determinant(), 1.0, 1e-9);
  }
}

TEST(SearchSurfaces, AreThePlaneAndTheTopsOfWhatStandsOnIt) {
  Table table = MakeTable({}, 2, 0.0, 18);
  const JointContext context = table.Context();
  SceneModel scene;
  scene.plane = SupportingPlane{};
  PlacedObject bracket, doubtful;
  bracket.object = doubtful.object = 0;
  bracket.scene_from_object = Standing(0.3, 0.1, 0.0, 0.0);
  doubtful.scene_from_object = Standing(0.9, -0.1, 0.0, 0.0);
  doubtful.score = 0.5;
  const auto surfaces = [&](double bar) {
    return SearchSurfaces(context, scene, {&doubtful, 1}, bar, 0.006, 6);
  };
  EXPECT_EQ(surfaces(0.6).size(), 1u);  // the plane alone
  scene.objects = {bracket};
  const std::vector<SearchSurface> sure = surfaces(0.6), both = surfaces(0.4);
  ASSERT_EQ(sure.size(), 2u);
  EXPECT_TRUE(sure[0].discs.empty());
  EXPECT_NEAR(sure[1].height_m, 0.04, 1e-9);
  EXPECT_EQ(sure[1].discs.size(), 1u);
  ASSERT_EQ(both.size(), 2u);  // as high: one search
  EXPECT_EQ(both[1].discs.size(), 2u);
  // What was searched is not searched again, in whatever order; new places are.
  EXPECT_TRUE(NotCovered(sure, both).empty());
  EXPECT_EQ(NotCovered(both, sure).size(), 1u);
  EXPECT_EQ(NotCovered(both, {}).size(), 2u);
  EXPECT_TRUE(NotCovered(both, {{0.0, {}}, {0.04, {}}}).empty());
}

class Noise : public testing::TestWithParam<double> {};

TEST_P(Noise, FindPlacesPartsOnTheTableAndOnOtherParts) {
  const Rigid3 bracket = Standing(-0.4, 0.05, 0.02, 0), wedge = Standing(1.2, -0.07, -0.03, 0.04);
  Table table = MakeTable({{0, bracket}, {1, wedge}}, 4, GetParam(), 14);
  const JointContext context = table.Context();
  SceneModel scene;
  for (std::size_t v = 0; v < table.cameras.size(); ++v)
    scene.views.push_back(CalibratedCamera{table.cameras[v], table.camera_from_table[v]});
  scene.plane = SupportingPlane{};
  const double limit = 1.0 + 2.0 * GetParam();
  const auto right = [&](int object, const Rigid3& truth, const std::vector<SearchSurface>& on) {
    const auto found = PlaneSearch(context, scene, on, {}).Find(object);
    return !found.empty() && LargestError(table, object, found[0].scene_from_object, truth) < limit;
  };
  const SearchSurface plane, above{0.04, {}};
  EXPECT_TRUE(right(0, bracket, {plane, above}));
  EXPECT_TRUE(right(1, wedge, {plane, above}));
  // Over the place where it stands, whatever the height the disc's centre is given at; not
  // elsewhere.
  EXPECT_TRUE(right(1, wedge, {{0.04, {{{-0.05, 0.0, 0.3}, 0.06}}}}));
  for (const auto& elsewhere : {SearchSurface{0.04, {{{0.3, 0.2, 0}, 0.06}}}, plane}) {
    for (const PlanePose& pose : PlaneSearch(context, scene, {elsewhere}, {}).Find(1))
      EXPECT_GT(LargestError(table, 1, pose.scene_from_object, wedge), 3.0);
  }
}
INSTANTIATE_TEST_SUITE_P(Sweep, Noise, testing::Values(0.0, 0.3, 0.6));

TEST(ViewScore, PrintInsideASureSilhouetteIsForgiven) {
  EdgeSupport s;
  s.visible = 1000;
  s.supported = 950;
  s.inside = 3000;
  s.explained = 950;
  EXPECT_LT(SilhouetteF1(s), 0.5);
  EXPECT_GT(ViewScore(s), 0.65);
  EXPECT_GT(DescriptionGain(s), 0.0);
  s.supported = s.explained = 600;  // what chance finds in texture
  EXPECT_LT(ViewScore(s), 0.4);
  EXPECT_LT(DescriptionGain(s), 0.0);
  EXPECT_EQ(ViewScore({}), 0.0);
}

TEST(PlaneTransferError, IsZeroForTheTrueCamerasAndEmptyBehindThem) {
  CalibratedCamera a{CenteredCamera(640, 480, 900), LookAt({0.3, -0.5, 0.4}, {0, 0, 0})};
  CalibratedCamera b{CenteredCamera(640, 480, 700), LookAt({-0.2, -0.5, 0.5}, {0, 0, 0})};
  a.camera.k1 = -0.06;
  b.camera.k1 = 0.03;
  PlanePoints plane;
  plane.anchor = {0, -0.5, 0.45};
  plane.plane = Eigen::Vector3d(0, 0, 1) / 0.45;  // z = 0
  const Eigen::Vector3d p(0.04, 0.02, 0.0);
  const PlanePoints::Match m{
      0, 1, Project(a.camera, a.camera_from_scene * p), Project(b.camera, b.camera_from_scene * p)};
  const auto e = PlaneTransferError(a, b, plane, m);
  ASSERT_TRUE(e);
  EXPECT_LT(e->norm(), 1e-5);
  plane.plane = -plane.plane;  // above the cameras
  EXPECT_FALSE(PlaneTransferError(a, b, plane, m));
}

}  // namespace
}  // namespace horopter
