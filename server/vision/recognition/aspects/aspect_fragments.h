// The contour fragments of a part's aspects: what an image's fragments are compared with.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/aspect_set.h"
#include "server/vision/recognition/aspects/contour_fragments.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// One fragment of an aspect in 26 bytes. Unit of length: the diameter as the aspect's camera sees
// it at the centre's depth; origin: the image of the centre of the bounding box; axes as in images.
struct AspectFragment {
  static constexpr float kPlaceScale = 8192.0f;                      // of x and y
  static constexpr float kSpreadScale = 16384.0f;                    // of spread
  static constexpr float kTurnScale = 32768.0f / 3.14159265358979f;  // 16 bits hold pi

  PackedFragmentKey key{};
  std::int16_t x = 0, y = 0;  // centre of the nine points
  std::uint16_t spread = 1;   // rms distance from it
  std::int16_t chord = 0;     // direction of the chord
  std::uint16_t aspect = 0;   // of the part's AspectSet

  friend bool operator==(const AspectFragment&, const AspectFragment&) = default;
};

// Two adjacent straight edges of an aspect, in 14 bytes; units and axes as above.
struct AspectSegmentPair {
  static constexpr float kTurnScale = AspectFragment::kTurnScale;    // of the angles
  static constexpr float kPlaceScale = AspectFragment::kPlaceScale;  // of x and y

  std::int16_t x = 0, y = 0;   // corner
  std::int16_t direction = 0;  // of arm a
  std::uint16_t opening = 0;   // from it to arm b, see segment_pairs.h
  std::uint16_t length_a = 1, length_b = 1;
  std::uint16_t aspect = 0;

  friend bool operator==(const AspectSegmentPair&, const AspectSegmentPair&) = default;
};

struct ModelFragments {
  std::vector<AspectFragment> fragments;
  std::vector<AspectSegmentPair> pairs;
  std::vector<float> edge_length;  // of each aspect, diameters

  friend bool operator==(const ModelFragments&, const ModelFragments&) = default;
};

// Draws the fragments of each aspect with probabilities that grow with length x turning; the same
// for the same input and any number of threads.
ModelFragments MakeModelFragments(const RenderMesh& mesh, const AspectSet& set);

// Aspects and their fragments from one rendering of each view: the same, bit for bit, as
// MakeAspects and then MakeModelFragments.
struct AspectsWithFragments {
  AspectSet aspects;
  ModelFragments fragments;
};
AspectsWithFragments MakeAspectsWithFragments(const RenderMesh& mesh,
                                              std::span<const Rigid3> symmetries,
                                              const AspectOptions& options = {});

}  // namespace horopter
