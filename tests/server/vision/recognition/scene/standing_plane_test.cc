#include "server/vision/recognition/scene/standing_plane.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// Brackets and wedges that stand on z = 0, turned about it.
struct Parts {
  JointContext context;
  std::vector<std::shared_ptr<const PreparedObject>> objects = {PrepareObject(LBracket()).value(),
                                                                PrepareObject(Wedge()).value()};
  std::vector<PlacedObject> placed;

  Parts(int count, unsigned seed, double noise_m) {
    context.objects = objects;
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> u(-1.0, 1.0);
    std::normal_distribution<double> noise(0.0, noise_m);
    for (int i = 0; i < count; ++i) {
      PlacedObject p;
      p.object = i % 2;
      p.scene_from_object = {
          Eigen::AngleAxisd(3.0 * u(rng), Eigen::Vector3d::UnitZ()).toRotationMatrix(),
          {0.12 * std::cos(2.4 * i), 0.12 * std::sin(2.4 * i), noise(rng)}};
      placed.push_back(p);
    }
  }
};

// What a badly known lens does to a matched plane.
SupportingPlane Off(double offset_m, double tilt_rad) {
  SupportingPlane plane;
  plane.normal =
      Eigen::AngleAxisd(tilt_rad, Eigen::Vector3d(0.8, 0.6, 0.0)) * Eigen::Vector3d::UnitZ();
  plane.offset_m = offset_m;
  return plane;
}

double Tilt(const SupportingPlane& plane) {
  return std::acos(std::min(1.0, plane.normal.z()));
}

TEST(PlaneUnderObjects, ReturnsToTheFeetAsNoiseGrows) {
  for (const double noise_m : {0.0, 0.0005, 0.001}) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << " noise " << noise_m);
      const Parts parts(4, seed, noise_m);
      const SupportingPlane plane =
          PlaneUnderObjects(parts.context, parts.placed, Off(-0.012, 0.03));
      EXPECT_LT(Tilt(plane), 0.006 + 20 * noise_m);
      EXPECT_LT(std::abs(plane.offset_m), 0.001 + 3 * noise_m);
    }
  }
}

TEST(PlaneUnderObjects, APartOnTopOfAFlatOneDoesNotLiftIt) {
  Parts parts(5, 7, 0.0002);
  parts.placed.back().scene_from_object.t.z() += 0.015;
  const SupportingPlane plane = PlaneUnderObjects(parts.context, parts.placed, Off(-0.004, 0.01));
  for (std::size_t i = 0; i + 1 < parts.placed.size(); ++i) {
    EXPECT_NEAR(
        plane.normal.dot(parts.placed[i].scene_from_object.t) - plane.offset_m, 0.0, 0.0015);
  }
}

TEST(PlaneUnderObjects, TooFewOrFarOrTiltedPartsLeaveIt) {
  const SupportingPlane given = Off(-0.01, 0.02);
  const auto expect_given = [&](const Parts& parts) {
    const SupportingPlane plane = PlaneUnderObjects(parts.context, parts.placed, given);
    EXPECT_EQ(plane.offset_m, given.offset_m);
    EXPECT_EQ(plane.normal, given.normal);
  };
  expect_given(Parts(0, 1, 0.0));
  expect_given(Parts(1, 1, 0.0));
  Parts far(3, 1, 0.0), tilted(3, 1, 0.0);
  for (PlacedObject& p : far.placed) p.scene_from_object.t.z() += 0.2;
  for (PlacedObject& p : tilted.placed) {
    p.scene_from_object.R =
        Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitX()) * p.scene_from_object.R;
  }
  expect_given(far);
  expect_given(tilted);
}

}  // namespace
}  // namespace horopter
