#include "server/vision/invariants/object_keys.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <set>

#include "server/base/status_macros.h"
#include "server/vision/invariants/six_points.h"

namespace horopter {
namespace {

constexpr std::size_t kMaxVertices = 65536;

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
  for (std::size_t i = 0; i < kept; ++i) {
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

double Choose6(double n) {
  return n < 6 ? 0.0 : n * (n - 1) * (n - 2) * (n - 3) * (n - 4) * (n - 5) / 720.0;
}

// Every set of six, or `draws` different ones when there are more.
std::vector<std::array<int, 6>> SixTuples(int vertices, int draws) {
  std::vector<std::array<int, 6>> tuples;
  if (vertices < 6) return tuples;
  std::array<int, 6> t{0, 1, 2, 3, 4, 5};
  if (Choose6(vertices) <= draws) {
    while (true) {
      tuples.push_back(t);
      int k = 5;
      while (k >= 0 && t[k] == vertices - 6 + k) --k;
      if (k < 0) return tuples;
      ++t[k];
      for (int j = k + 1; j < 6; ++j) t[j] = t[j - 1] + 1;
    }
  }
  std::mt19937 rng(1);  // the same tuples for the same part
  std::set<std::array<int, 6>> seen;
  for (int draw = 0; draw < draws; ++draw) {
    for (int k = 0; k < 6; ++k) {
      do {
        t[k] = static_cast<int>(rng() % static_cast<unsigned>(vertices));
      } while (std::find(t.begin(), t.begin() + k, t[k]) != t.begin() + k);
    }
    std::sort(t.begin(), t.end());
    if (seen.insert(t).second) tuples.push_back(t);
  }
  return tuples;
}

std::vector<SixVertexKey> SixVertexKeys(const ObjectModel& model, const ObjectKeyOptions& options) {
  std::vector<SixVertexKey> keys;
  const int count = static_cast<int>(std::min(model.vertices.size(), kMaxVertices));
  if (!(model.diameter_m > 0.0)) return keys;
  for (const std::array<int, 6>& tuple : SixTuples(count, options.six_point_draws)) {
    if (static_cast<int>(keys.size()) >= options.max_six_points) break;
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
    }
    for (int k = 0; k < 3; ++k) out.values[k] = static_cast<float>(labeling.key.values(k));
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
    for (const float x : key.values) {
      if (!std::isfinite(x)) return absl::DataLossError("key that is not finite");
    }
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
