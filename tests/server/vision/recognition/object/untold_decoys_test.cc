#include "server/vision/recognition/object/untold_decoys.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>

#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

// A slab of 100 x 60 x 20 mm with two pegs of different height, which no plane halves, and the
// outlines of the pegs as edges.
ObjectModel Handed(double peg_scale) {
  ObjectModel model;
  model.id = "handed";
  model.mesh = BoxMesh({0.05, 0.03, 0.01});
  const auto add = [&](const Eigen::Vector3d& half, const Eigen::Vector3d& foot) {
    const Eigen::Vector3d size = peg_scale * half;
    const Eigen::Vector3d center = foot + Eigen::Vector3d(0, 0, size.z());
    Append(BoxMesh(size), center, &model.mesh);
    ModelEdge top;
    top.dihedral_rad = std::numbers::pi / 2;
    for (const auto& [x, y] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}, {-1, -1}})
      top.polyline.push_back(center + size.cwiseProduct(Eigen::Vector3d(x, y, 1)));
    model.edges.push_back(top);
  };
  add({0.008, 0.006, 0.012}, {0.036, 0.02, 0.01});
  add({0.012, 0.005, 0.005}, {-0.03, 0.02, 0.01});
  model.diameter_m = 0.12;
  return model;
}

std::vector<UntoldDecoy> Of(const ObjectModel& model) {
  return FindUntoldDecoys(model);
}

TEST(UntoldDecoys, LargeFeaturesTellAPartFromWhatIsLikeIt) {
  EXPECT_TRUE(Of(Handed(1.0)).empty());
}

TEST(UntoldDecoys, AreFeaturesThatImagesDoNotShow) {
  const std::vector<UntoldDecoy> found = Of(Handed(0.2));
  int features = 0, mirrored = 0;
  for (const UntoldDecoy& decoy : found) {
    (decoy.kind == UntoldDecoy::Kind::kFeature ? features : mirrored) += 1;
    EXPECT_LT(decoy.differing_px, 16.0);
    if (decoy.kind == UntoldDecoy::Kind::kFeature) EXPECT_LT(decoy.feature_size_m, 0.006);
  }
  EXPECT_EQ(features, 2);
  EXPECT_LE(mirrored, 1);
}

TEST(UntoldDecoys, NoneOfAPartWithoutASurface) {
  ObjectModel model = Handed(0.2);
  model.mesh = {};
  EXPECT_TRUE(FindUntoldDecoys(model).empty());
  EXPECT_TRUE(FindUntoldDecoys(ObjectModel()).empty());
}

}  // namespace
}  // namespace horopter
