#include "server/vision/invariants/object_keys.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <span>

#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/vision/invariants/six_point_sets.h"
#include "server/vision/invariants/six_points.h"

namespace horopter {
namespace {

constexpr std::size_t kMaxVertices = 65536;  // keys hold them in 16 bits
constexpr int kSetsPerLook = 64;             // at the stop flag

bool Indexable(std::span<const int> vertices) {
  return std::all_of(vertices.begin(), vertices.end(), [](int v) {
    return v >= 0 && v < static_cast<int>(kMaxVertices);
  });
}

std::vector<FourVertexKey> FourVertexKeys(const ObjectModel& model,
                                          const std::vector<FourVertices>& tuples,
                                          int most) {
  std::vector<FourVertexKey> keys;
  const std::size_t kept = std::min(tuples.size(), static_cast<std::size_t>(most));
  StopPacer pacer(kSetsPerLook);
  for (std::size_t i = 0; i < kept; ++i) {
    pacer.Step();
    const FourVertices& tuple = tuples[i * tuples.size() / kept];
    if (!Indexable(tuple)) continue;
    std::array<Eigen::Vector3d, 4> points;
    for (int k = 0; k < 4; ++k) points[k] = model.vertices[tuple[k]];
    const auto key = SimilarityKeyOf(points);
    if (!key) continue;
    FourVertexKey& out = keys.emplace_back();
    for (int k = 0; k < 4; ++k) out.vertices[k] = static_cast<std::uint16_t>(tuple[k]);
    out.handedness = static_cast<std::int8_t>(key->handedness);
    out.log_size = static_cast<float>(key->log_size);
    for (int k = 0; k < 5; ++k) out.values[k] = static_cast<float>(key->key.values(k));
  }
  return keys;
}

// The best spread sets, so chosen that no vertex is in too many of them: which ones a scene shows
// is not known. What the bound leaves out fills up the rest.
std::vector<SixVertexKey> SixVertexKeys(const ObjectModel& model, const ObjectKeyOptions& options) {
  std::vector<SixVertexKey> keys;
  const int count = static_cast<int>(std::min(model.vertices.size(), kMaxVertices));
  if (!(model.diameter_m > 0.0) || count < 6) return keys;
  const std::vector<std::array<int, 6>> sets =
      WellSpreadSets(std::span(model.vertices).first(count), options.six_point_sets);
  const int bound =
      static_cast<int>(std::ceil(options.six_point_balance * 6.0 * options.max_six_points / count));
  std::vector<int> uses(count, 0);
  std::vector<bool> left_out(sets.size(), false);
  StopPacer pacer(kSetsPerLook);
  for (const bool again : {false, true}) {
    for (std::size_t i = 0; i < sets.size(); ++i) {
      pacer.Step();
      if (static_cast<int>(keys.size()) >= options.max_six_points) return keys;
      const std::array<int, 6>& tuple = sets[i];
      if (again && !left_out[i]) continue;
      left_out[i] =
          std::any_of(tuple.begin(), tuple.end(), [&](int v) { return uses[v] >= bound; });
      if (!again && left_out[i]) continue;
      std::array<Eigen::Vector4d, 6> points;
      for (int k = 0; k < 6; ++k) {
        points[k] = (model.vertices[tuple[k]] / model.diameter_m).homogeneous();
      }
      const auto found = InvariantsOfSixPoints(points);
      if (!found || found->invariants != 3) continue;
      SixVertexKey& out = keys.emplace_back();
      const SixPointLabeling& labeling = found->labelings[0];
      for (int k = 0; k < 6; ++k) {
        out.vertices[k] = static_cast<std::uint16_t>(tuple[labeling.groups[k][0]]);
        ++uses[tuple[k]];
      }
      for (int k = 0; k < 3; ++k) out.values[k] = static_cast<float>(labeling.key.values(k));
    }
  }
  return keys;
}

template <typename T>
void Append(std::string& out, const T& value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

template <typename T>
void Take(std::string_view& bytes, T& value) {
  std::memcpy(&value, bytes.data(), sizeof(value));
  bytes.remove_prefix(sizeof(value));
}

template <typename Key>
constexpr std::size_t BytesOf();
template <>
constexpr std::size_t BytesOf<FourVertexKey>() {
  return 8 + 1 + 4 + 20;
}
template <>
constexpr std::size_t BytesOf<SixVertexKey>() {
  return 12 + 12;
}
template <typename Key>
void AppendTable(std::string& out, const std::vector<Key>& keys) {
  Append(out, static_cast<std::uint32_t>(keys.size()));
  for (const Key& key : keys) {
    Append(out, key.vertices);
    if constexpr (std::is_same_v<Key, FourVertexKey>) {
      Append(out, key.handedness);
      Append(out, key.log_size);
    }
    Append(out, key.values);
  }
}

template <typename Key>
absl::StatusOr<std::vector<Key>> TakeTable(std::string_view& bytes, int vertex_count) {
  std::uint32_t count = 0;
  if (bytes.size() < sizeof(count)) return absl::DataLossError("key table cut short");
  Take(bytes, count);
  if (count > bytes.size() / BytesOf<Key>()) return absl::DataLossError("key table cut short");
  std::vector<Key> keys(count);
  for (Key& key : keys) {
    Take(bytes, key.vertices);
    for (const int v : key.vertices) {
      if (v >= vertex_count) return absl::DataLossError("key of a vertex that is not there");
    }
    if constexpr (std::is_same_v<Key, FourVertexKey>) {
      Take(bytes, key.handedness);
      Take(bytes, key.log_size);
    }
    Take(bytes, key.values);
    if (!std::all_of(
            key.values.begin(), key.values.end(), [](float x) { return std::isfinite(x); }))
      return absl::DataLossError("key with impossible values");
  }
  return keys;
}

}  // namespace

ObjectKeys ComputeObjectKeys(const ObjectModel& model, const ObjectKeyOptions& options) {
  ObjectKeys keys;
  keys.chains = FourVertexKeys(model, VertexChains(model), options.max_chains);
  keys.stars = FourVertexKeys(model, VertexStars(model), options.max_stars);
  keys.six_points = SixVertexKeys(model, options);
  return keys;
}

std::string EncodeObjectKeys(const ObjectKeys& keys) {
  std::string out;
  AppendTable(out, keys.chains);
  AppendTable(out, keys.stars);
  AppendTable(out, keys.six_points);
  return out;
}

absl::StatusOr<ObjectKeys> DecodeObjectKeys(std::string_view bytes, int vertex_count) {
  ObjectKeys keys;
  HOROPTER_ASSIGN_OR_RETURN(keys.chains, TakeTable<FourVertexKey>(bytes, vertex_count));
  HOROPTER_ASSIGN_OR_RETURN(keys.stars, TakeTable<FourVertexKey>(bytes, vertex_count));
  HOROPTER_ASSIGN_OR_RETURN(keys.six_points, TakeTable<SixVertexKey>(bytes, vertex_count));
  if (!bytes.empty()) return absl::DataLossError("bytes behind the key tables");
  return keys;
}

}  // namespace horopter
