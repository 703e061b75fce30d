#include "client/preview.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/core.hpp>

#include "client/cad_import.h"
#include "client/resting_poses.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

ObjectModel BoxModel(double x, double y, double z) {
  const TempFolder folder;
  return ImportCad(folder.Write("b.ply", AsPly(Box(x, y, z))))->model;
}

TEST(RestingPoses, ABoxRestsOnItsSixFacesTheLargestMostOften) {
  const ObjectModel box = BoxModel(60, 40, 20);
  const std::vector<RestingPose> poses = RestingPoses(box.mesh);
  ASSERT_EQ(poses.size(), 6u);
  double sum = 0.0;
  for (const RestingPose& pose : poses) {
    sum += pose.share;
    EXPECT_NEAR(pose.down_in_object.cwiseAbs().maxCoeff(), 1.0, 1e-4);
    const Eigen::Vector3d half(0.03, 0.02, 0.01);
    EXPECT_NEAR(pose.height_m, half.dot(pose.down_in_object.cwiseAbs()), 1e-4);
  }
  EXPECT_NEAR(sum, 1.0, 1e-9);
  EXPECT_NEAR(std::abs(poses[0].down_in_object.z()), 1.0, 1e-4);
  EXPECT_NEAR(std::abs(poses[5].down_in_object.x()), 1.0, 1e-4);
  EXPECT_GT(poses[0].share, 2.0 * poses[5].share);
}

TEST(RestingPoses, AMeshWithoutVolumeRestsNowhere) {
  TriangleMesh flat;
  flat.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  flat.triangles = {{0, 1, 2}};
  EXPECT_TRUE(RestingPoses(flat).empty());
  EXPECT_TRUE(RestingPoses({}).empty());
  flat.triangles = {{0, 1, 7}, {-1, 0, 1}};
  EXPECT_FALSE(CentreOfMass(flat));
}

TEST(RestingPoses, TheCentreOfMassMovesWithThePart) {
  TriangleMesh mesh = BoxModel(60, 40, 20).mesh;
  const Eigen::Vector3d before = *CentreOfMass(mesh), shift(1.0, -2.0, 3.0);
  for (Eigen::Vector3d& v : mesh.vertices) v += shift;
  EXPECT_LT((*CentreOfMass(mesh) - before - shift).norm(), 1e-9);
}

TEST(SymmetryAxes, TurnsAboutOneAxisAreOneAxisOfTheirOrder) {
  std::vector<Rigid3> symmetries;
  const Eigen::Vector3d point(0.1, 0.2, 0.0);
  for (int k = 1; k < 4; ++k) {
    const Eigen::Matrix3d R =
        Eigen::AngleAxisd(k * M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    symmetries.push_back({R, point - R * point});
  }
  const auto axes = SymmetryAxes(symmetries);
  ASSERT_EQ(axes.size(), 1u);
  EXPECT_EQ(axes[0].order, 4);
  EXPECT_NEAR((axes[0].point - point).head<2>().norm(), 0.0, 1e-9);
  EXPECT_EQ(SymmetryAxes(BoxModel(60, 40, 20).symmetries).size(), 3u);
}

// Pixels of nearly this colour.
int Count(const cv::Mat& image, const cv::Vec3b& color) {
  int n = 0;
  for (int y = 40; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      n += cv::norm(image.at<cv::Vec3b>(y, x), color) < 60.0;
    }
  }
  return n;
}

// Pixels of faces that are seen from inside: shaded in red alone.
int CountPink(const cv::Mat& image) {
  int n = 0;
  for (int y = 40; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const cv::Vec3b c = image.at<cv::Vec3b>(y, x);
      n += c[0] == 180 && c[1] == 160;
    }
  }
  return n;
}

TEST(Preview, GraspsSymmetriesAndInsideOutMeshesAreSeen) {
  ObjectModel box = BoxModel(60, 40, 20);
  const cv::Vec3b gripper(0, 110, 230), symmetry(200, 40, 200);
  const PreviewOptions small{.tile_px = 160};
  const cv::Mat plain = RenderPreview(box, small);
  EXPECT_EQ(plain.cols, 640);
  EXPECT_GT(Count(plain, symmetry), 200);
  EXPECT_LT(Count(plain, gripper), 50);
  Grasp grasp;
  grasp.object_from_gripper.t = {0.0, 0.0, -0.02};
  grasp.jaw_opening_m = 0.05;
  box.grasps.push_back(grasp);
  EXPECT_GT(Count(RenderPreview(box, small), gripper), Count(plain, gripper) + 100);
  for (Eigen::Vector3i& t : box.mesh.triangles) std::swap(t[1], t[2]);
  EXPECT_EQ(CountPink(plain), 0);
  EXPECT_GT(CountPink(RenderPreview(box, small)), 2000);
}

TEST(Preview, AnObjectWithoutAnythingIsAnEmptySheet) {
  EXPECT_FALSE(RenderPreview({}, {.tile_px = 64}).empty());
}

}  // namespace
}  // namespace horopter
