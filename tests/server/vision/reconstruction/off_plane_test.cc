#include "server/vision/reconstruction/off_plane.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace horopter {
namespace {

using Views = std::vector<std::optional<CalibratedView>>;

const SupportingPlane kTable;  // z = 0

// Cameras on an arc, 1 above and beside the table, that look at its middle; one is not known.
Views CamerasAround() {
  Views views;
  for (int v = 0; v < 5; ++v) {
    const double azimuth = 0.25 * v - 0.5;
    const Eigen::Vector3d centre(0.7 * std::sin(azimuth), -0.7 * std::cos(azimuth), 0.7);
    const Eigen::Vector3d z = -centre.normalized();
    const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
    CalibratedView view;
    view.camera = CenteredCamera(640, 480, 800.0);
    view.camera_from_scene.R << x.transpose(), z.cross(x).transpose(), z.transpose();
    view.camera_from_scene.t = -(view.camera_from_scene.R * centre);
    views.emplace_back(view);
  }
  views.emplace_back();
  return views;
}

// Points of `count` on the faces of an upright box that stands at `foot`.
void AddBox(const Eigen::Vector2d& foot,
            const Eigen::Vector3d& size,
            int count,
            std::mt19937* rng,
            std::vector<Eigen::Vector3d>* points) {
  std::uniform_real_distribution<double> place(-0.5, 0.5);
  for (int k = 0; k < count; ++k) {
    Eigen::Vector3d at(place(*rng), place(*rng), place(*rng));
    at[k % 3] = k % 2 == 0 ? 0.5 : -0.5;
    at.z() += 0.5;
    points->push_back(at.cwiseProduct(size) + Eigen::Vector3d(foot.x(), foot.y(), 0.0));
  }
}

void AddTable(int count, std::mt19937* rng, std::vector<Eigen::Vector3d>* points) {
  std::uniform_real_distribution<double> place(-0.35, 0.35);
  for (int k = 0; k < count; ++k) points->emplace_back(place(*rng), place(*rng), 0.0);
}

// As triangulated from all views of that noise: true points moved by a draw of their covariances.
std::vector<SpacePoint> Seen(const std::vector<Eigen::Vector3d>& truth,
                             const Views& views,
                             double sigma_px,
                             std::mt19937* rng) {
  std::vector<ReconstructedPoint> points(truth.size());
  for (std::size_t i = 0; i < truth.size(); ++i) {
    points[i].point_in_world = truth[i];
    for (int v = 0; v < std::ssize(views); ++v) points[i].observations.emplace_back(v, -1);
  }
  std::vector<SpacePoint> seen = PointsInSpace(points, views, std::max(sigma_px, 1e-6));
  EXPECT_EQ(seen.size(), truth.size());
  std::normal_distribution<double> normal;
  for (SpacePoint& p : seen) {
    const Eigen::Vector3d draw(normal(*rng), normal(*rng), normal(*rng));
    p.point += p.covariance.llt().matrixL() * draw;
  }
  return seen;
}

bool Holds(const SpaceBox& box, const Eigen::Vector3d& x) {
  const Eigen::Vector3d at = box.base_from_box.Inverse() * x;
  return (at.cwiseAbs().array() <= 0.5 * box.size_m.array() + 1e-9).all();
}

TEST(FindOffPlane, FindsWhatStandsThereWithItsBoxes) {
  const Views views = CamerasAround();
  for (const unsigned seed : {1u, 2u, 3u}) {
    for (const double sigma_px : {0.0, 0.5, 1.0, 2.0}) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << ", sigma " << sigma_px);
      std::mt19937 rng(seed);
      std::vector<Eigen::Vector3d> truth;
      AddTable(200, &rng, &truth);
      AddBox({-0.15, 0.0}, {0.12, 0.08, 0.06}, 60, &rng, &truth);
      AddBox({0.15, 0.05}, {0.05, 0.05, 0.10}, 40, &rng, &truth);
      const auto groups = FindOffPlane(Seen(truth, views, sigma_px, &rng), kTable, views);
      ASSERT_EQ(groups.size(), 2u);
      for (int g = 0; g < 2; ++g) {
        const int first = g == 0 ? 200 : 260, last = g == 0 ? 260 : 300;
        const Eigen::Vector3d size =
            g == 0 ? Eigen::Vector3d(0.12, 0.08, 0.06) : Eigen::Vector3d(0.05, 0.05, 0.10);
        for (const int i : groups[g].points) EXPECT_TRUE(i >= first && i < last) << i;
        for (int i = first; i < last; ++i) EXPECT_TRUE(Holds(groups[g].box, truth[i])) << i;
        EXPECT_LT(groups[g].box.size_m.maxCoeff(), 2.2 * size.maxCoeff());
        ASSERT_EQ(groups[g].images.size(), views.size());
        EXPECT_FALSE(groups[g].images.back());
        for (int v = 0; v < 5; ++v) {
          ASSERT_TRUE(groups[g].images[v]);
          for (int i = first; i < last; ++i) {
            EXPECT_TRUE(groups[g].images[v]->contains(
                Project(views[v]->camera, views[v]->camera_from_scene * truth[i])));
          }
        }
      }
    }
  }
}

TEST(FindOffPlane, FollowsAChangeOfFrameAndUnit) {
  const Views views = CamerasAround();
  std::mt19937 rng(4);
  std::vector<Eigen::Vector3d> truth;
  AddTable(100, &rng, &truth);
  AddBox({0.0, 0.0}, {0.1, 0.06, 0.05}, 50, &rng, &truth);
  const std::vector<SpacePoint> points = Seen(truth, views, 0.5, &rng);
  const double scale = 370.0;
  const Rigid3 moved = {Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, -1).normalized()).matrix(),
                        {30.0, -500.0, 80.0}};
  std::vector<SpacePoint> other = points;
  for (SpacePoint& p : other) {
    p.point = moved * Eigen::Vector3d(scale * p.point);
    p.covariance = scale * scale * moved.R * p.covariance * moved.R.transpose();
  }
  Views other_views = views;
  for (auto& view : other_views) {
    if (!view) continue;
    view->camera_from_scene.t *= scale;
    view->camera_from_scene = view->camera_from_scene * moved.Inverse();
  }
  const Eigen::Vector3d normal = moved.R.col(2);
  const auto a = FindOffPlane(points, kTable, views);
  const auto b = FindOffPlane(other, {normal, normal.dot(moved.t)}, other_views);
  ASSERT_EQ(a.size(), 1u);
  ASSERT_EQ(b.size(), 1u);
  EXPECT_EQ(a[0].points, b[0].points);
  EXPECT_TRUE(b[0].box.size_m.isApprox(scale * a[0].box.size_m, 1e-6));
  for (std::size_t v = 0; v < 5; ++v) {
    EXPECT_LT((a[0].images[v]->min() - b[0].images[v]->min()).norm(), 1e-4);
    EXPECT_LT((a[0].images[v]->max() - b[0].images[v]->max()).norm(), 1e-4);
  }
}

TEST(FindOffPlane, WhatLiesOnThePlaneOrUnderItIsNothing) {
  const Views views = CamerasAround();
  for (const unsigned seed : {5u, 6u, 7u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    std::mt19937 rng(seed);
    std::vector<Eigen::Vector3d> truth;
    AddTable(400, &rng, &truth);
    EXPECT_TRUE(FindOffPlane(Seen(truth, views, 1.0, &rng), kTable, views).empty());
    AddBox({0.1, 0.0}, {0.1, 0.1, -0.1}, 60, &rng, &truth);  // the table's reflection, or the floor
    AddBox({-0.1, 0.0}, {0.05, 0.05, 0.05}, 5, &rng, &truth);  // too few
    EXPECT_TRUE(FindOffPlane(Seen(truth, views, 1.0, &rng), kTable, views).empty());
  }
}

TEST(FindOffPlane, PointsWithoutDepthAndScatteredOnesAreNoThing) {
  const Views views = CamerasAround();
  std::mt19937 rng(8);
  std::vector<Eigen::Vector3d> truth;
  AddTable(100, &rng, &truth);
  std::vector<SpacePoint> points = Seen(truth, views, 0.5, &rng);
  std::uniform_real_distribution<double> place(-0.3, 0.3);
  for (int k = 0; k < 20; ++k) {  // as matches of two views next to each other leave them
    points.push_back({{0.01 * k, 0.0, 0.1}, 0.04 * Eigen::Matrix3d::Identity()});
  }
  for (int k = 0; k < 8; ++k)
    points.push_back({{0.1 * k - 0.4, place(rng), 0.3}, 1e-6 * Eigen::Matrix3d::Identity()});
  EXPECT_TRUE(FindOffPlane(points, kTable, views).empty());
}

TEST(FindOffPlane, ABackgroundIsNoThing) {
  const Views views = CamerasAround();
  std::mt19937 rng(9);
  std::vector<Eigen::Vector3d> truth;
  AddTable(100, &rng, &truth);
  for (int k = 0; k < 2000; ++k) truth.emplace_back(0.04 * (k % 50) - 1.0, 0.6, 0.03 * (k / 50));
  AddBox({0.0, 0.0}, {0.1, 0.06, 0.05}, 50, &rng, &truth);
  const auto groups = FindOffPlane(Seen(truth, views, 0.2, &rng), kTable, views);
  ASSERT_EQ(groups.size(), 1u);
  EXPECT_GE(groups[0].points.front(), 2100);  // not the wall behind
}

TEST(FindOffPlane, WithoutViewsOrPointsThereIsNone) {
  const std::vector<SpacePoint> points(50, {{0, 0, 1}, Eigen::Matrix3d::Zero()});
  EXPECT_TRUE(FindOffPlane(points, kTable, Views()).empty());
  EXPECT_TRUE(FindOffPlane(points, kTable, Views(3)).empty());
  EXPECT_TRUE(FindOffPlane({}, kTable, CamerasAround()).empty());
}

TEST(PointsInSpace, OfOneViewOrOneRayHaveNoDepth) {
  Views views = CamerasAround();
  ReconstructedPoint point;
  point.observations = {{0, -1}};
  EXPECT_TRUE(PointsInSpace({&point, 1}, views).empty());
  views[1] = views[0];
  point.observations = {{0, -1}, {1, -1}};
  EXPECT_TRUE(PointsInSpace({&point, 1}, views).empty());
  point.observations = {{0, -1}, {5, -1}};  // the other is not registered
  EXPECT_TRUE(PointsInSpace({&point, 1}, views).empty());
  point.observations = {{0, -1}, {2, -1}};
  const auto one = PointsInSpace({&point, 1}, views, 1.0);
  const auto two = PointsInSpace({&point, 1}, views, 2.0);
  ASSERT_EQ(one.size(), 1u);
  EXPECT_TRUE(two[0].covariance.isApprox(4.0 * one[0].covariance, 1e-9));
}

TEST(PointsOfEdge, HaveItsEndsAndNoWiderStep) {
  const SpacePoint a = {{0, 0, 0.1}, Eigen::Matrix3d::Identity()};
  const SpacePoint b = {{0.1, 0, 0.1}, 3.0 * Eigen::Matrix3d::Identity()};
  const auto points = PointsOfEdge(a, b, 0.03);
  ASSERT_EQ(points.size(), 5u);
  EXPECT_EQ(points.front().point, a.point);
  EXPECT_EQ(points.back().point, b.point);
  for (std::size_t k = 1; k < points.size(); ++k)
    EXPECT_LE((points[k].point - points[k - 1].point).norm(), 0.03);
  EXPECT_TRUE(points[2].covariance.isApprox(2.0 * Eigen::Matrix3d::Identity()));
  EXPECT_EQ(PointsOfEdge(a, a, 0.03).size(), 2u);
  EXPECT_EQ(PointsOfEdge(a, {{1e9, 0, 0}, a.covariance}, 1e-3).size(), 100u);
}

}  // namespace
}  // namespace horopter
