#include "server/vision/reconstruction/relief_reversal.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <random>

namespace horopter {
namespace {

// Three views from about `distance`; the first is turned against the scene's frame.
CalibratedScene Relief(unsigned seed, double distance) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  CalibratedScene scene;
  for (int k = 0; k < 50; ++k)
    scene.points.emplace_back(Eigen::Vector3d(0.1 * unit(rng), 0.1 * unit(rng), 0.03 * unit(rng)));
  scene.points.emplace_back();
  scene.views.emplace_back();
  for (int v = 0; v < 3; ++v) {
    CalibratedView view;
    view.camera = CenteredCamera(640, 480, 1000.0 * distance);
    const Eigen::Vector3d axis = Eigen::Vector3d(unit(rng), unit(rng), unit(rng)).normalized();
    view.camera_from_scene = {Eigen::AngleAxisd(0.3 * v + 0.2, axis).matrix(), {0, 0, distance}};
    scene.views.emplace_back(view);
  }
  return scene;
}

double WorstPx(const CalibratedScene& a, const CalibratedScene& b) {
  double worst = 0.0;
  for (size_t v = 0; v < a.views.size(); ++v) {
    for (size_t j = 0; a.views[v] && j < a.points.size(); ++j) {
      if (!a.points[j]) continue;
      const auto see = [&](const CalibratedScene& s) {
        return Project(s.views[v]->camera, s.views[v]->camera_from_scene * *s.points[j]);
      };
      worst = std::max(worst, (see(a) - see(b)).norm());
    }
  }
  return worst;
}

TEST(TurnedInsideOut, LooksTheSameFromAfar) {
  double before = 1e9;
  for (const double distance : {1.0, 10.0, 100.0, 1000.0}) {
    const CalibratedScene scene = Relief(1, distance);
    const double worst = WorstPx(scene, TurnedInsideOut(scene));
    EXPECT_LT(worst, 25.0 / distance) << "seed 1, distance " << distance;
    EXPECT_LT(worst, before);
    before = worst;
  }
}

TEST(TurnedInsideOut, TwiceIsTheSame) {
  const CalibratedScene scene = Relief(2, 1.0);
  const CalibratedScene once = TurnedInsideOut(scene), twice = TurnedInsideOut(once);
  EXPECT_LT(WorstPx(scene, twice), 1e-6);
  EXPECT_GT(LargestTurn(scene.views, once.views), 0.1);
  EXPECT_NEAR(LargestTurn(scene.views, twice.views), 0.0, 1e-6);
  for (const auto& view : once.views) {
    if (view) {
      EXPECT_NEAR(view->camera_from_scene.R.determinant(), 1.0, 1e-12);
    }
  }
  EXPECT_FALSE(once.views[0]);
  EXPECT_FALSE(once.points.back());
}

TEST(TurnedInsideOut, WithoutViewsNothingIs) {
  CalibratedScene scene = Relief(3, 1.0);
  scene.views.assign(2, std::nullopt);
  EXPECT_EQ(*TurnedInsideOut(scene).points[0], *scene.points[0]);
}

}  // namespace
}  // namespace horopter
