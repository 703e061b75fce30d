// The fragments of a catalog's aspects, found by the similarity of their keys.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/geometry/mesh_symmetry.h"
#include "server/vision/geometry/model_circles.h"
#include "server/vision/recognition/aspects/aspect_blob.h"
#include "server/vision/recognition/aspects/aspect_fragments.h"
#include "server/vision/recognition/aspects/key_cells.h"
#include "server/vision/recognition/aspects/near_keys.h"

namespace horopter {

// A way to rest on a plane: `up` is its unit normal in the object frame, the plane is
// {x : up . x = -height_m}.
struct RestingFace {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  double height_m = 0.0;
};

// A part as the search for aspects knows it; what it points to outlives the index.
struct AspectModel {
  const ObjectAspects* object = nullptr;
  const ModelFragments* fragments = nullptr;
  std::span<const Rigid3> symmetries;  // as ObjectModel::symmetries
  // Turns that leave the part the same but for small features: views that do not show these agree
  // on it only up to such a turn.
  std::vector<Rigid3> near_turns = {};
  std::vector<RestingFace> resting = {};  // safest first
  std::vector<SymmetryAxis> round = {};   // axes about which it is the same, or nearly, by any turn
  std::vector<ModelCircle> rims = {};     // largest first (LargeRims)
};

// A point of an aspect in the plane: diameters from the image of its centre, and the direction of
// its edge modulo pi in bins of kAspectBins.
struct VotePoint {
  float x = 0.0f, y = 0.0f, bin = 0.0f;
};

inline constexpr int kFirstVotePoints = 16;  // of an aspect; those with fewer are not indexed

// The first of an aspect in steps: those of a whole catalog stay in the cache, and eight of them
// are moved at once.
struct FirstVotePoints {
  static constexpr float kPlaceScale = 16384.0f;  // steps a diameter
  static constexpr int kBinSteps = 256;           // a bin of directions: 16 bits hold all bins
  std::array<std::int16_t, kFirstVotePoints> x{}, y{};
  std::array<std::uint16_t, kFirstVotePoints> bin{};
};

struct IndexedAspect {
  std::int32_t model = -1;
  std::int32_t aspect = -1;  // of the part's AspectSet
  std::uint32_t first_point = 0;
  std::uint16_t points = 0;
  float edge_length = 0.0f;                                          // diameters
  Eigen::Matrix3f camera_from_object = Eigen::Matrix3f::Identity();  // rotation
};

// A direction with its cosine and sine, which every test of a vote asks for.
struct IndexedTurn {
  float rad = 0.0f, cos = 1.0f, sin = 0.0f;

  IndexedTurn() = default;
  explicit IndexedTurn(float angle) : rad(angle), cos(std::cos(angle)), sin(std::sin(angle)) {}
};

// What a matched fragment says about its aspect, in diameters of the aspect.
struct IndexedFragment {
  std::int32_t aspect = -1;  // of FragmentIndex::aspects
  float x = 0.0f, y = 0.0f;  // centre
  float spread = 0.0f;
  IndexedTurn turn;  // mean direction of its pieces
};

// The same of a pair of adjacent straight edges.
struct IndexedPair {
  std::int32_t aspect = -1;
  float x = 0.0f, y = 0.0f;  // corner
  float opening_rad = 0.0f;
  IndexedTurn turn;  // half way between its arms
  float length_a = 0.0f, length_b = 0.0f;
};

// The ellipse of a rim that an aspect shows, in diameters.
struct IndexedEllipse {
  std::int32_t aspect = -1;
  float x = 0.0f, y = 0.0f;  // centre
  float semi_major = 0.0f;
  float ratio = 0.0f;          // minor over major
  float direction_rad = 0.0f;  // of the major axis, modulo pi
};

// Which of a part's aspects and fragments are indexed. Fewer: less memory and time, parts missed.
struct FragmentChoice {
  int points = 64;              // of each aspect, for the votes; at least kFirstVotePoints
  double view_spacing_rad = 0;  // views nearer than this to one that is taken are left out
  // Of the part, evenly of the aspects that are taken: a symmetric part has few of these.
  int fragments = 1 << 20;
  bool pairs = true;     // of adjacent straight edges as well
  bool ellipses = true;  // of rims as well
};

// What an index holds of one part, its numbers counted from 0.
struct FragmentPiece {
  struct Entry {
    PackedFragmentKey key;
    IndexedFragment fragment;
  };
  std::vector<IndexedAspect> aspects;
  std::vector<VotePoint> points;
  std::vector<FirstVotePoints> first_points;  // of each aspect
  std::vector<Entry> entries;
  std::vector<IndexedPair> pairs;
  std::vector<IndexedEllipse> ellipses;
};
FragmentPiece MakeFragmentPiece(const ObjectAspects& object,
                                const ModelFragments& fragments,
                                const FragmentChoice& choice = {},
                                std::span<const ModelCircle> rims = {});

// Immutable once built; any number of threads may search it. `fragments` and `keys` are in the
// order of the grid's cells.
struct FragmentIndex {
  std::vector<AspectModel> models;  // of an index made of pieces alone empty
  int model_count = 0;
  std::vector<IndexedAspect> aspects;
  std::vector<VotePoint> points;
  std::vector<FirstVotePoints> first_points;  // of each aspect
  std::vector<IndexedFragment> fragments;
  std::vector<PackedFragmentKey> keys;
  CoarseKeys coarse_keys;  // the same keys
  // Grid: cell (i, j, k) holds fragments cell_begin[c] .. cell_begin[c + 1], k fastest.
  Eigen::Matrix<float, 3, kFragmentAngles> axes =
      Eigen::Matrix<float, 3, kFragmentAngles>::Zero();  // orthonormal rows
  Eigen::Array3f low = Eigen::Array3f::Zero();
  KeyCells cells;
  std::vector<std::uint32_t> cell_begin;
  std::vector<IndexedPair> pairs;        // by opening
  std::vector<IndexedEllipse> ellipses;  // by ratio

  // Appends fragments whose keys differ by at most `radius` (Euclidean, radians), at most `most`:
  // the nearest by coarse keys, of those equally near the first in the index; in its order.
  // `wanted`: a flag for each part, the others are not found; empty: all.
  void FindNearest(const FragmentKey& key,
                   float radius,
                   std::size_t most,
                   std::span<const std::uint8_t> wanted,
                   std::vector<std::uint32_t>* found) const;

  // The pairs whose openings differ by at most `reach_rad`: [first, last) of `pairs`.
  std::pair<std::size_t, std::size_t> FindPairs(float opening_rad, float reach_rad) const;

  // The ellipses whose ratios differ by at most `reach`: [first, last) of `ellipses`.
  std::pair<std::size_t, std::size_t> FindEllipses(float ratio, float reach) const;

  std::size_t bytes() const;
};

FragmentIndex BuildFragmentIndex(std::span<const AspectModel> models, int threads = 1);

// Of parts that are known by their pieces alone; part i is pieces[i] (null: none). It can be voted
// in; for the poses of its votes the aspects themselves are needed.
FragmentIndex BuildFragmentIndex(std::span<const FragmentPiece* const> pieces);

}  // namespace horopter
