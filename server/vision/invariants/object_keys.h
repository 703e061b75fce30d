// The table of invariant keys of one object: what the catalog's index is made of.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/invariants/similarity_keys.h"

namespace horopter {

// Keys of four connected vertices under similarities: SimilarityKeyOf, in the order of `vertices`.
struct FourVertexKey {
  std::array<std::uint16_t, 4> vertices{};
  std::int8_t handedness = 0;
  float log_size = 0.0f;  // of metres
  std::array<float, 5> values{};

  friend bool operator==(const FourVertexKey&, const FourVertexKey&) = default;
};

// Invariants of six vertices under collineations: the labeling to store of InvariantsOfSixPoints
// with all three of them; vertices in the order of its groups.
struct SixVertexKey {
  std::array<std::uint16_t, 6> vertices{};
  std::array<float, 3> values{};

  friend bool operator==(const SixVertexKey&, const SixVertexKey&) = default;
};

struct ObjectKeys {
  std::vector<FourVertexKey> chains;
  std::vector<FourVertexKey> stars;
  std::vector<SixVertexKey> six_points;

  friend bool operator==(const ObjectKeys&, const ObjectKeys&) = default;
};

struct ObjectKeyOptions {
  // Of more, evenly chosen ones are kept: more keys find the object more often and cost memory and
  // time of every query alike.
  int max_chains = 2000;
  int max_stars = 500;
  // Best spread sets of six that are looked at (WellSpreadSets), and six-tuples kept of them. No
  // vertex is in more than `six_point_balance` times its even share of those kept, as long as there
  // are others: raising it keeps better spread ones, which are lost together with few vertices.
  int six_point_sets = 8000;
  int max_six_points = 600;
  double six_point_balance = 1.5;
};

// Vertices beyond the first 65536 and degenerate tuples give no keys. The same model gives the same
// keys, bit by bit.
ObjectKeys ComputeObjectKeys(const ObjectModel& model, const ObjectKeyOptions& options = {});

// Byte layout, little-endian, no padding: three tables, each u32 count, then per key the vertices
// (u16 each), for chains and stars handedness (i8) and log_size (f32), and the values (f32 each).
std::string EncodeObjectKeys(const ObjectKeys& keys);
// `vertex_count` bounds the indices. Errors: DATA_LOSS.
absl::StatusOr<ObjectKeys> DecodeObjectKeys(std::string_view bytes, int vertex_count);

}  // namespace horopter
