#include "server/vision/geometry/mesh_denoising.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/support/dense_box.h"

namespace horopter {
namespace {

constexpr double kSide = 40.0;
constexpr int kCells = 20;

// From the surface of the box without noise.
double RmsOff(const TriangleMesh& mesh) {
  double sum = 0.0;
  for (const Eigen::Vector3d& p : mesh.vertices) {
    const double off = std::abs((p.array() - kSide / 2).abs().maxCoeff() - kSide / 2);
    sum += off * off;
  }
  return std::sqrt(sum / static_cast<double>(mesh.vertices.size()));
}

TEST(MeshDenoising, OnlyNoiseMakesAScan) {
  EXPECT_FALSE(IsScan(MeasureSurfaceNoise(DenseBox(kSide, kCells, 0.0))));
  EXPECT_TRUE(IsScan(MeasureSurfaceNoise(DenseBox(kSide, kCells, 0.1))));
  // However rough, what has its vertices on its edges alone is a design.
  EXPECT_FALSE(IsScan(MeasureSurfaceNoise(DenseBox(kSide, 2, 0.1))));
}

TEST(MeshDenoising, DeviationIsTheNoise) {
  for (const double noise : {0.03, 0.1, 0.2}) {
    EXPECT_NEAR(MeasureSurfaceNoise(DenseBox(kSide, kCells, noise)).deviation, noise, 0.2 * noise);
  }
}

TEST(MeshDenoising, MeasureIsTheSameInAnyUnit) {
  TriangleMesh metres = DenseBox(kSide, kCells, 0.1);
  const SurfaceNoise before = MeasureSurfaceNoise(metres);
  for (Eigen::Vector3d& p : metres.vertices) p *= 1e-3;
  const SurfaceNoise after = MeasureSurfaceNoise(metres);
  EXPECT_NEAR(after.smooth_share, before.smooth_share, 1e-9);
  EXPECT_NEAR(after.roughness, before.roughness, 1e-9);
  EXPECT_NEAR(after.deviation, 1e-3 * before.deviation, 1e-12);
}

TEST(MeshDenoising, FacesComeOutPlainAndEdgesSharp) {
  const TriangleMesh noisy = DenseBox(kSide, kCells, 0.15);
  const SurfaceNoise noise = MeasureSurfaceNoise(noisy);
  const DenoisedSurface surface = Denoise(noisy, noise);
  EXPECT_LT(RmsOff(surface.mesh), 0.7 * RmsOff(noisy));
  for (std::size_t v = 0; v < noisy.vertices.size(); ++v) {
    EXPECT_LE((surface.mesh.vertices[v] - noisy.vertices[v]).norm(), 4.001 * noise.deviation);
  }
  // Triangles come face by face, two a square.
  const std::size_t face = 2 * kCells * kCells;
  std::vector<double> off;
  for (std::size_t t = 0; t < surface.normals.size(); ++t) {
    Eigen::Vector3d normal = Eigen::Vector3d::Unit(static_cast<int>(t / (2 * face)));
    if (t / face % 2 == 0) normal = -normal;
    off.push_back(std::acos(std::min(1.0, surface.normals[t].dot(normal))));
  }
  std::nth_element(off.begin(), off.begin() + off.size() * 9 / 10, off.end());
  EXPECT_LT(off[off.size() * 9 / 10], 0.06);  // 3.4 degrees; 12 before
}

TEST(MeshDenoising, EmptyAndPointlikeMeshesAreNoScans) {
  EXPECT_FALSE(IsScan(MeasureSurfaceNoise({})));
  TriangleMesh point;
  point.vertices.assign(3, Eigen::Vector3d::Zero());
  point.triangles.emplace_back(0, 1, 2);
  EXPECT_FALSE(IsScan(MeasureSurfaceNoise(point)));
}

}  // namespace
}  // namespace horopter
