#include "server/vision/invariants/object_keys.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <span>

#include "server/base/status_macros.h"
#include "server/vision/invariants/six_point_sets.h"
#include "server/vision/invariants/six_points.h"

namespace horopter {
namespace {

constexpr std::size_t kMaxVertices = 65536;  // keys hold them in 16 bits

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
  for (const bool again : {false, true}) {
    for (std::size_t i = 0; i < sets.size(); ++i) {
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

// Chains in an order in which every beginning is spread evenly over all of them: i times the golden
// section, modulo 1.
std::vector<PathViewRow> PathViewRows(const ObjectModel& model, int most) {
  std::vector<PathViewRow> rows;
  const std::vector<FourVertices> chains = VertexChains(model);
  std::vector<std::size_t> order(chains.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto at = [](std::size_t i) {
    const double x = 0.6180339887498949 * static_cast<double>(i);
    return x - std::floor(x);
  };
  std::stable_sort(
      order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return at(a) < at(b); });
  for (const std::size_t i : order) {
    const FourVertices& chain = chains[i];
    if (!Indexable(chain)) continue;
    std::array<Eigen::Vector3d, 4> path;
    for (int k = 0; k < 4; ++k) path[k] = model.vertices[chain[k]];
    const std::vector<PathViewBox> boxes = PathViewBoxes(path);
    if (rows.size() + boxes.size() > static_cast<std::size_t>(most)) break;
    for (const PathViewBox& box : boxes) {
      PathViewRow& row = rows.emplace_back();
      for (int k = 0; k < 4; ++k) row.vertices[k] = static_cast<std::uint16_t>(chain[k]);
      row.cell = static_cast<std::uint8_t>(box.cell);
      row.low = box.low;
      row.high = box.high;
    }
  }
  return rows;
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
template <>
constexpr std::size_t BytesOf<PathViewRow>() {
  return 8 + 1 + 32;
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
    if constexpr (std::is_same_v<Key, PathViewRow>) {
      Append(out, key.cell);
      Append(out, key.low);
      Append(out, key.high);
    } else {
      Append(out, key.values);
    }
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
    const auto finite = [](std::span<const float> values) {
      return std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); });
    };
    bool valid = true;
    if constexpr (std::is_same_v<Key, PathViewRow>) {
      Take(bytes, key.cell);
      Take(bytes, key.low);
      Take(bytes, key.high);
      valid = key.cell < kPathCells && finite(key.low) && finite(key.high);
      for (int k = 0; k < 4; ++k) valid &= key.low[k] <= key.high[k];
    } else {
      Take(bytes, key.values);
      valid = finite(key.values);
    }
    if (!valid) return absl::DataLossError("key with impossible values");
  }
  return keys;
}

}  // namespace

ObjectKeys ComputeObjectKeys(const ObjectModel& model, const ObjectKeyOptions& options) {
  ObjectKeys keys;
  keys.chains = FourVertexKeys(model, VertexChains(model), options.max_chains);
  keys.stars = FourVertexKeys(model, VertexStars(model), options.max_stars);
  keys.six_points = SixVertexKeys(model, options);
  keys.path_views = PathViewRows(model, options.max_path_views);
  return keys;
}

std::string EncodeObjectKeys(const ObjectKeys& keys) {
  std::string out;
  AppendTable(out, keys.chains);
  AppendTable(out, keys.stars);
  AppendTable(out, keys.six_points);
  AppendTable(out, keys.path_views);
  return out;
}

absl::StatusOr<ObjectKeys> DecodeObjectKeys(std::string_view bytes, int vertex_count) {
  ObjectKeys keys;
  HOROPTER_ASSIGN_OR_RETURN(keys.chains, TakeTable<FourVertexKey>(bytes, vertex_count));
  HOROPTER_ASSIGN_OR_RETURN(keys.stars, TakeTable<FourVertexKey>(bytes, vertex_count));
  HOROPTER_ASSIGN_OR_RETURN(keys.six_points, TakeTable<SixVertexKey>(bytes, vertex_count));
  HOROPTER_ASSIGN_OR_RETURN(keys.path_views, TakeTable<PathViewRow>(bytes, vertex_count));
  if (!bytes.empty()) return absl::DataLossError("bytes behind the key tables");
  return keys;
}

}  // namespace horopter
