#include "server/vision/invariants/path_views.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

using Four = std::array<Eigen::Vector3d, 4>;

Four RandomFour(RandomSpace& space) {
  Four points;
  for (auto& p : points) p = space.Noise(3);
  return points;
}

Eigen::Vector3d RandomDirection(RandomSpace& space) {
  return Eigen::Vector3d(space.Noise(3)).normalized();
}

bool Holds(const PathViewBox& box, const Eigen::VectorXd& values) {
  for (int k = 0; k < 4; ++k) {
    if (values(k) < box.low[k] || values(k) > box.high[k]) return false;
  }
  return true;
}

TEST(PathViewKeyTest, SurvivesSimilaritiesOfTheImage) {
  RandomSpace space(34);
  for (int trial = 0; trial < 200; ++trial) {
    std::array<Eigen::Vector2d, 4> points, moved;
    for (auto& p : points) p = space.Noise(2);
    const Eigen::Matrix2d rotation = Eigen::Rotation2Dd(space.Normal()).toRotationMatrix();
    for (int i = 0; i < 4; ++i) moved[i] = 3.0 * rotation * points[i] + Eigen::Vector2d(5, -2);
    const auto before = PathViewKey(points), after = PathViewKey(moved);
    if (!before) continue;
    ASSERT_TRUE(after);
    EXPECT_LT((after->values - before->values).norm(), 1e-9 * (1.0 + before->values.norm()));
  }
}

// The boxes' law: a view from anywhere is inside the box of its cell, as it is from the front and
// mirrored from behind.
struct Seen {
  int views = 0;     // from cells that have a box
  int in_cell = 0;   // held by the box of the nearest cell or one beside it
  int readings = 0;  // of the four readings, held by any box
};

Seen LookAt(const Four& path, double distance, double off_axis, RandomSpace& space, int views) {
  const std::vector<PathViewBox> boxes = PathViewBoxes(path);
  Seen seen;
  for (int view = 0; view < views; ++view) {
    const Eigen::Vector3d direction = RandomDirection(space);
    // A camera that looks past the path by an angle: the exact perspective image of a turned
    // camera.
    std::array<Eigen::Vector2d, 4> image = ProjectPath(path, direction, distance);
    double diameter = 0.0;
    for (const auto& p : path) {
      for (const auto& q : path) diameter = std::max(diameter, (p - q).norm());
    }
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(off_axis, Eigen::Vector3d::UnitY()).toRotationMatrix();
    for (auto& p : image) {
      const Eigen::Vector3d ray = turn * Eigen::Vector3d(p.x(), p.y(), distance * diameter);
      p = distance * diameter * ray.head<2>() / ray.z();
    }
    const bool front = direction.z() > 0.0;
    const auto key = PathViewKey(image, {}, front ? PathReading::kForward : PathReading::kMirrored);
    if (!key || boxes.empty()) continue;
    // Cells within reach: the nearest by direction and its neighbours, as cells are triangles.
    bool has_cell = false, in_cell = false;
    const Eigen::Vector3d up = front ? direction : Eigen::Vector3d(-direction);
    for (const PathViewBox& box : boxes) {
      const double angle = std::acos(std::min(1.0, up.dot(PathCellDirection(box.cell))));
      has_cell |= angle < 0.08;  // well inside a cell
      in_cell |= angle < 0.45 && Holds(box, key->values);
    }
    if (!has_cell) continue;
    ++seen.views;
    seen.in_cell += in_cell;
    for (int r = 0; r < kPathReadings; ++r) {
      const auto reading = PathViewKey(image, {}, static_cast<PathReading>(r));
      seen.readings += reading && std::any_of(boxes.begin(), boxes.end(), [&](const auto& box) {
                         return Holds(box, reading->values);
                       });
    }
  }
  return seen;
}

TEST(PathViewBoxesTest, HoldEveryWeakPerspectiveView) {
  RandomSpace space(41);
  int views = 0, held = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const Seen seen = LookAt(RandomFour(space), 1e6, 0.0, space, 200);
    views += seen.views;
    held += seen.in_cell;
  }
  ASSERT_GT(views, 500);
  EXPECT_GE(held, 0.995 * views) << held << " of " << views;
}

TEST(PathViewBoxesTest, HoldPerspectiveViewsFromTheNearestDistanceOnAndOffTheAxis) {
  RandomSpace space(42);
  for (const double distance : {4.5, 6.0, 12.0, 40.0}) {
    for (const double off_axis : {0.0, 0.2}) {
      int views = 0, held = 0;
      for (int trial = 0; trial < 40; ++trial) {
        const Seen seen = LookAt(RandomFour(space), distance, off_axis, space, 150);
        views += seen.views;
        held += seen.in_cell;
      }
      ASSERT_GT(views, 250);
      EXPECT_GE(held, 0.97 * views)
          << distance << " diameters, " << off_axis << " rad off: " << held << " of " << views;
    }
  }
}

TEST(PathViewBoxesTest, SayLittleOfOtherPaths) {
  RandomSpace space(43);
  int boxes = 0, held = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const auto image = ProjectPath(RandomFour(space), RandomDirection(space), 8.0);
    const auto key = PathViewKey(image);
    if (!key) continue;
    for (const PathViewBox& box : PathViewBoxes(RandomFour(space))) {
      ++boxes;
      held += Holds(box, key->values);
    }
  }
  ASSERT_GT(boxes, 1000);
  EXPECT_LT(held, 0.05 * boxes) << held << " of " << boxes;
}

TEST(PathViewBoxesTest, DegeneratePathsHaveNone) {
  RandomSpace space(44);
  Four path = RandomFour(space);
  path[2] = path[1] + 1e-6 * path[0];
  EXPECT_TRUE(PathViewBoxes(path).empty());
  path[2] = path[1];
  EXPECT_TRUE(PathViewBoxes(path).empty());
  path[2].x() = NAN;
  EXPECT_TRUE(PathViewBoxes(path).empty());
  EXPECT_TRUE(PathViewBoxes(Four{path[0], path[0], path[0], path[0]}).empty());
}

TEST(PathViewKeyTest, ReadingsAreThoseOfReversedAndMirroredImages) {
  RandomSpace space(45);
  std::array<Eigen::Vector2d, 4> points, reversed, mirrored;
  for (auto& p : points) p = space.Noise(2);
  for (int i = 0; i < 4; ++i) {
    reversed[i] = points[3 - i];
    mirrored[i] = {-points[i].x(), points[i].y()};  // any mirror line
  }
  const auto values = [](const auto& p, PathReading r) { return PathViewKey(p, {}, r)->values; };
  EXPECT_LT((values(points, PathReading::kReverse) - PathViewKey(reversed)->values).norm(), 1e-12);
  EXPECT_LT((values(points, PathReading::kMirrored) - PathViewKey(mirrored)->values).norm(), 1e-9);
  EXPECT_LT(
      (values(mirrored, PathReading::kMirroredReverse) - PathViewKey(reversed)->values).norm(),
      1e-9);
  const Eigen::MatrixXd a = space.Noise(64).reshaped(8, 8);
  const Eigen::MatrixXd covariance = 1e-6 * a * a.transpose();
  for (int r = 0; r < kPathReadings; ++r) {
    const auto stated = PathViewKey(points, covariance, static_cast<PathReading>(r));
    std::vector<Eigen::VectorXd> samples;
    for (int k = 0; k < 4000; ++k) {
      const Eigen::VectorXd noise = 1e-3 * a * space.Noise(8);
      auto noisy = points;
      for (int i = 0; i < 4; ++i) noisy[i] += noise.segment<2>(2 * i);
      samples.push_back(values(noisy, static_cast<PathReading>(r)));
    }
    EXPECT_LT(CovarianceError(samples, stated->covariance), 0.1) << "reading " << r;
  }
}

TEST(PathViewKeyTest, CovarianceIsWhatNoiseShows) {
  RandomSpace space(36);
  std::array<Eigen::Vector2d, 4> points{Eigen::Vector2d(10, 80),
                                        Eigen::Vector2d(40, 20),
                                        Eigen::Vector2d(110, 30),
                                        Eigen::Vector2d(130, 90)};
  const auto stated = PathViewKey(points, 0.25 * Eigen::MatrixXd::Identity(8, 8));
  std::vector<Eigen::VectorXd> samples;
  for (int k = 0; k < 4000; ++k) {
    auto noisy = points;
    for (auto& p : noisy) p += 0.5 * space.Noise(2);
    samples.push_back(PathViewKey(noisy)->values);
  }
  EXPECT_LT(CovarianceError(samples, stated->covariance), 0.1);
}

}  // namespace
}  // namespace horopter
