#include "server/vision/recognition/object/prepared_blob.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

using Prepared = std::shared_ptr<const PreparedObject>;

ObjectModel Turned() {
  ObjectModel model = LBracket();
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  for (Eigen::Vector3d& v : model.vertices) v = turn * v;
  for (Eigen::Vector3d& v : model.mesh.vertices) v = turn * v;
  for (ModelEdge& e : model.edges) {
    for (Eigen::Vector3d& p : e.polyline) p = turn * p;
  }
  return model;
}

void ExpectSame(const PreparedObject& a, const PreparedObject& b) {
  EXPECT_EQ(a.center, b.center);
  EXPECT_EQ(a.radius_m, b.radius_m);
  EXPECT_EQ(a.sample_spacing_m, b.sample_spacing_m);
  ASSERT_EQ(a.samples.size(), b.samples.size());
  for (std::size_t i = 0; i < a.samples.size(); ++i) {
    EXPECT_EQ(a.samples[i].point, b.samples[i].point);
    EXPECT_EQ(a.samples[i].tangent, b.samples[i].tangent);
    EXPECT_EQ(a.samples[i].edge, b.samples[i].edge);
  }
  ASSERT_EQ(a.stable_poses.size(), b.stable_poses.size());
  for (std::size_t i = 0; i < a.stable_poses.size(); ++i) {
    EXPECT_EQ(a.stable_poses[i].up, b.stable_poses[i].up);
    EXPECT_EQ(a.stable_poses[i].height_m, b.stable_poses[i].height_m);
    EXPECT_EQ(a.stable_poses[i].margin_m, b.stable_poses[i].margin_m);
  }
  EXPECT_EQ(a.sphere, b.sphere);
  ASSERT_EQ(a.near_symmetries.size(), b.near_symmetries.size());
  for (std::size_t i = 0; i < a.near_symmetries.size(); ++i) {
    EXPECT_EQ(a.near_symmetries[i].axis.axis, b.near_symmetries[i].axis.axis);
    EXPECT_EQ(a.near_symmetries[i].axis.order, b.near_symmetries[i].axis.order);
    EXPECT_EQ(a.near_symmetries[i].mismatch.place, b.near_symmetries[i].mismatch.place);
  }
  EXPECT_EQ(a.keys, b.keys);
}

TEST(PreparedBlob, RestoringGivesWhatPreparingGaveBitByBit) {
  for (const ObjectModel& model : {LBracket(), Wedge(), Turned()}) {
    const Prepared made = PrepareObject(model).value();
    EXPECT_FALSE(made->keys.chains.empty());
    const PreparedBytes bytes = EncodePrepared(*made);
    const auto restored = RestorePrepared(model, bytes);
    ASSERT_TRUE(restored.ok()) << restored.status();
    ExpectSame(**restored, *made);
    EXPECT_EQ(EncodePrepared(**restored), bytes);
    const auto keys = DecodePreparedKeys(bytes.keys, static_cast<int>(model.vertices.size()));
    ASSERT_TRUE(keys.ok()) << keys.status();
    EXPECT_EQ(*keys, made->keys);
  }
}

TEST(PreparedBlob, AnyFlippedBitAnywhereAndAnyCutIsNoticed) {
  const ObjectModel model = Wedge();
  const PreparedBytes bytes = EncodePrepared(*PrepareObject(model).value());
  std::mt19937 rng(5);
  for (int trial = 0; trial < 300; ++trial) {
    PreparedBytes damaged = bytes;
    std::string& part = trial % 2 == 0 ? damaged.data : damaged.keys;
    // The two bytes of zero in the header say nothing.
    std::size_t at = rng() % part.size();
    if (at == 6 || at == 7) at = 0;
    part[at] = static_cast<char>(part[at] ^ (1 << (rng() % 8)));
    EXPECT_FALSE(RestorePrepared(model, damaged).ok()) << "byte " << at;
    part = (trial % 2 == 0 ? bytes.data : bytes.keys).substr(0, rng() % part.size());
    EXPECT_FALSE(RestorePrepared(model, damaged).ok());
  }
}

// With the checksum made right again, so that the decoder itself meets nonsense.
TEST(PreparedBlob, NonsenseBehindARightChecksumIsRefusedOrHarmless) {
  const ObjectModel model = Wedge();
  const PreparedBytes bytes = EncodePrepared(*PrepareObject(model).value());
  const std::string& blob = bytes.data;
  const auto checksum = [](const std::string& encoded) {
    std::uint64_t value = 0xcbf29ce484222325ull;
    for (std::size_t at = 24; at < encoded.size(); at += 8) {
      std::uint64_t word = 0;
      std::memcpy(&word, encoded.data() + at, std::min<std::size_t>(8, encoded.size() - at));
      value = (value ^ word) * 0x100000001b3ull;
      value ^= value >> 29;
    }
    return value;
  };
  std::uint64_t stored = 0;
  std::memcpy(&stored, blob.data() + 16, 8);
  ASSERT_EQ(checksum(blob), stored) << "the layout in the header comment";
  std::mt19937 rng(6);
  int refused = 0;
  for (int trial = 0; trial < 300; ++trial) {
    std::string damaged = blob;
    for (int k = 0; k < 4; ++k) damaged[24 + rng() % (blob.size() - 24)] = static_cast<char>(rng());
    const std::uint64_t value = checksum(damaged);
    std::memcpy(damaged.data() + 16, &value, 8);
    const auto restored = RestorePrepared(model, {damaged, bytes.keys});
    refused += !restored.ok();
  }
  EXPECT_GT(refused, 0);
}

TEST(PreparedBlob, AnotherGeometryOrOtherOptionsAreOutOfDate) {
  const ObjectModel model = LBracket();
  const PreparedBytes blob = EncodePrepared(*PrepareObject(model).value());
  ObjectModel moved = model;
  moved.mesh.vertices[3].x() += 1e-9;
  EXPECT_EQ(RestorePrepared(moved, blob).status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(RestorePrepared(model, blob, {.max_samples = 200}).status().code(),
            absl::StatusCode::kFailedPrecondition);
  ObjectModel renamed = model;  // names, grasps and symmetries are no part of it
  renamed.display_name = "another";
  renamed.grasps.push_back({});
  EXPECT_TRUE(RestorePrepared(renamed, blob).ok());
  PreparedBytes other_version = blob;
  other_version.data[4] = static_cast<char>(kPreparedVersion + 1);
  EXPECT_EQ(RestorePrepared(model, other_version).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace horopter
