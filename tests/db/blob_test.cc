#include "db/blob.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>

namespace horopter {
namespace {

std::vector<Eigen::Vector3d> RandomPoints(int count, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::vector<Eigen::Vector3d> points(count);
  for (auto& point : points) point = {uniform(rng), uniform(rng), uniform(rng)};
  return points;
}

TEST(Blob, PolylineSurvivesTheRoundTripBitByBit) {
  for (const int count : {0, 1, 2, 1000}) {
    std::vector<Eigen::Vector3d> points = RandomPoints(count, count + 1);
    if (count > 0) points[0] = {-0.0, std::numeric_limits<double>::denorm_min(), 1e300};
    const auto decoded = DecodePolyline(EncodePolyline(points));
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_EQ(*decoded, points);
  }
}

TEST(Blob, MeshSurvivesTheRoundTripBitByBit) {
  TriangleMesh mesh;
  mesh.vertices = RandomPoints(17, 3);
  for (int i = 0; i + 2 < 17; ++i) mesh.triangles.emplace_back(i, i + 1, i + 2);
  const auto decoded = DecodeMesh(EncodeMesh(mesh));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(decoded->vertices, mesh.vertices);
  EXPECT_EQ(decoded->triangles, mesh.triangles);
}

// The layout is a contract with files that exist already.
TEST(Blob, PolylineHasTheDocumentedBytes) {
  const std::string expected(
      "HPOL\x01\0\0\0\x01\0\0\0"
      "\0\0\0\0\0\0\xf0\x3f\0\0\0\0\0\0\0\xc0\0\0\0\0\0\0\0\0",
      36);
  EXPECT_EQ(EncodePolyline({{1.0, -2.0, 0.0}}), expected);
}

TEST(Blob, EveryCutAndEveryChangedHeaderByteIsDataLoss) {
  const std::string polyline = EncodePolyline(RandomPoints(3, 5));
  TriangleMesh mesh{RandomPoints(4, 6), {{0, 1, 2}, {1, 2, 3}}, {}};
  const std::string blob = EncodeMesh(mesh);
  for (size_t size = 0; size < polyline.size(); ++size) {
    EXPECT_EQ(DecodePolyline(polyline.substr(0, size)).status().code(),
              absl::StatusCode::kDataLoss);
  }
  for (size_t size = 0; size < blob.size(); ++size) {
    EXPECT_EQ(DecodeMesh(blob.substr(0, size)).status().code(), absl::StatusCode::kDataLoss);
  }
  for (size_t at = 0; at < 16; ++at) {
    if (at == 6 || at == 7) continue;  // reserved
    std::string changed = blob;
    changed[at] = static_cast<char>(changed[at] ^ 0x81);
    EXPECT_EQ(DecodeMesh(changed).status().code(), absl::StatusCode::kDataLoss) << at;
  }
  EXPECT_EQ(DecodeMesh(polyline).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(DecodePolyline(polyline + "x").status().code(), absl::StatusCode::kDataLoss);
}

}  // namespace
}  // namespace horopter
