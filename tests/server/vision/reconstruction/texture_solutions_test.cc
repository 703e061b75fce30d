#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "server/vision/reconstruction/texture_route.h"

namespace horopter {
namespace {

struct Relief {
  std::vector<CalibratedCamera> views;
  TextureMatching texture;
  std::vector<ImageSize> sizes;
  std::vector<ViewPrior> priors;
};

// Points of a relief 0.25 wide and `depth` deep, seen from a distance by cameras whose focal length
// is given and makes it as large in the image as always.
Relief See(unsigned seed, double distance, double depth, double noise_px) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, noise_px);
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < 150; ++k)
    points.emplace_back(0.125 * unit(rng), 0.125 * unit(rng), 0.5 * depth * unit(rng));
  Relief out;
  for (int v = 0; v < 4; ++v) {
    const double azimuth = 1.7 * v;
    const Eigen::Vector3d centre =
        distance * Eigen::Vector3d(0.35 * std::cos(azimuth), 0.35 * std::sin(azimuth), 1.0);
    CalibratedCamera view;
    view.camera = CenteredCamera(640, 480, 1000.0 * distance);
    const Eigen::Vector3d z = -centre.normalized();
    const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitY()).normalized();
    view.camera_from_scene.R << x.transpose(), z.cross(x).transpose(), z.transpose();
    view.camera_from_scene.t = -(view.camera_from_scene.R * centre);
    out.views.push_back(view);
    out.sizes.push_back({640, 480});
    ViewPrior prior;
    prior.focal_px = view.camera.focal_px;
    out.priors.push_back(prior);
    out.texture.sigma_px.push_back(std::max(noise_px, 0.3));
    out.texture.keypoints.emplace_back();
    for (const Eigen::Vector3d& X : points) {
      out.texture.keypoints.back().points.push_back(
          Project(view.camera, view.camera_from_scene * X) +
          Eigen::Vector2d(noise(rng), noise(rng)));
    }
  }
  for (int k = 0; k < 150; ++k) {
    out.texture.tracks.emplace_back();
    for (int v = 0; v < 4; ++v) out.texture.tracks.back().features.push_back({v, k});
  }
  for (int a = 0; a < 4; ++a) {
    for (int b = a + 1; b < 4; ++b) {
      TexturePair pair;
      pair.view_a = a;
      pair.view_b = b;
      for (int k = 0; k < 150; ++k) pair.matches.emplace_back(k, k);
      out.texture.pairs.push_back(pair);
    }
  }
  return out;
}

// Largest error of a relative rotation, degrees.
double WorstRotation(const Relief& truth, const Reconstruction& r) {
  double worst = 0.0;
  for (size_t v = 1; v < truth.views.size(); ++v) {
    if (!r.views[0] || !r.views[v]) return 180.0;
    const Eigen::Matrix3d found =
        r.views[v]->camera_from_scene.R * r.views[0]->camera_from_scene.R.transpose();
    const Eigen::Matrix3d right =
        truth.views[v].camera_from_scene.R * truth.views[0].camera_from_scene.R.transpose();
    worst = std::max(worst, Eigen::AngleAxisd(found.transpose() * right).angle() * 180.0 / M_PI);
  }
  return worst;
}

TEST(SolutionsOfTexture, FromAfarReliefMayBeInsideOut) {
  for (const unsigned seed : {1u, 3u, 5u}) {
    const Relief relief = See(seed, 14.0, 0.06, 0.7);
    const auto solutions =
        SolutionsOfTexture(relief.texture, relief.sizes, relief.priors, TextureRouteOptions());
    ASSERT_TRUE(solutions.ok()) << solutions.status();
    ASSERT_EQ(solutions->size(), 2u) << "seed " << seed << ": " << solutions->front().refusal;
    double nearest = 180.0, farthest = 0.0;
    for (const Reconstruction& solution : *solutions) {
      EXPECT_TRUE(solution.trusted);
      EXPECT_EQ(solution.counts.at("texture_solutions"), 2.0);
      nearest = std::min(nearest, WorstRotation(relief, solution));
      farthest = std::max(farthest, WorstRotation(relief, solution));
    }
    EXPECT_LT(nearest, 3.0) << "seed " << seed;
    EXPECT_GT(farthest, 10.0) << "seed " << seed;
  }
}

TEST(SolutionsOfTexture, WherePerspectiveTellsThereIsOne) {
  // From 4 m a growing scene may end inside out.
  for (const unsigned seed : {1u, 2u, 3u, 4u, 5u, 6u}) {
    const Relief relief = See(seed, seed < 6u ? 4.0 : 0.6, 0.06, 0.7);
    const auto solutions =
        SolutionsOfTexture(relief.texture, relief.sizes, relief.priors, TextureRouteOptions());
    ASSERT_TRUE(solutions.ok());
    ASSERT_EQ(solutions->size(), 1u) << "seed " << seed;
    ASSERT_TRUE(solutions->front().trusted) << solutions->front().refusal;
    EXPECT_LT(WorstRotation(relief, solutions->front()), 3.0) << "seed " << seed;
    EXPECT_EQ(solutions->front().counts.count("texture_solutions"), 0u);
    const auto one =
        ReconstructFromTexture(relief.texture, relief.sizes, relief.priors, TextureRouteOptions());
    ASSERT_TRUE(one.ok());
    EXPECT_EQ(one->views[1]->camera_from_scene.R, solutions->front().views[1]->camera_from_scene.R);
  }
}

TEST(SolutionsOfTexture, WhoeverWantsOneGetsTheLikelier) {
  const Relief relief = See(1, 14.0, 0.06, 0.7);
  const auto solutions =
      SolutionsOfTexture(relief.texture, relief.sizes, relief.priors, TextureRouteOptions());
  const auto one =
      ReconstructFromTexture(relief.texture, relief.sizes, relief.priors, TextureRouteOptions());
  ASSERT_TRUE(solutions.ok() && one.ok());
  ASSERT_EQ(solutions->size(), 2u);
  EXPECT_EQ(one->views[1]->camera_from_scene.R, solutions->front().views[1]->camera_from_scene.R);
}

// Seen from afar without a focal length: all along a valley it is as likely, and nothing is to be
// chosen from.
TEST(SolutionsOfTexture, AValleyIsNoChoice) {
  const Relief relief = See(8, 14.0, 0.06, 0.7);
  const auto solutions =
      SolutionsOfTexture(relief.texture, relief.sizes, {}, TextureRouteOptions());
  ASSERT_TRUE(solutions.ok());
  ASSERT_EQ(solutions->size(), 1u);
  EXPECT_FALSE(solutions->front().trusted);
  EXPECT_FALSE(solutions->front().refusal.empty());
}

TEST(SolutionsOfTexture, RefusesSizesThatDoNotAgreeAndStops) {
  const Relief relief = See(9, 1.0, 0.06, 0.7);
  EXPECT_EQ(SolutionsOfTexture(
                relief.texture, std::span(relief.sizes).first(2), {}, TextureRouteOptions())
                .status()
                .code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(
      SolutionsOfTexture(
          relief.texture, relief.sizes, relief.priors, TextureRouteOptions(), [] { return true; })
          .status()
          .code(),
      absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
