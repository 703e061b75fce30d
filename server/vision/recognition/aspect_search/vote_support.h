// Support of an aspect's points under a similarity of the plane, on the distance maps of an image.
#pragma once

#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// Bin of the sum of two directions, given in bins plus a half, below 2 kAspectBins + 2.
inline int TurnedBin(float bins) {
  return static_cast<int>(bins) % kAspectBins;
}

// A direction modulo pi in bins, plus a half.
float TurnBins(float turn_rad);

// Puts an aspect's points, in diameters, into the working image: size, turn and place.
struct Similarity {
  float a = 0.0f, b = 0.0f;  // size (cos, sin)
  float x = 0.0f, y = 0.0f;
  float size = 0.0f, turn = 0.0f;
};

// With the aspect's centre at the origin.
Similarity MakeSimilarity(float size, float turn);

// Mean support of points [from, to) under a similarity: 1 on an edge, 0 from tau8 / 8 px on.
float Support(const AspectImage& image,
              const VotePoint* points,
              int from,
              int to,
              const Similarity& s,
              int tau8);

// Mean support that the directions of the first n points find around their places anyway, beyond
// what is free (AspectScoreOptions::free_chance).
float ExcessChance(const AspectImage& image,
                   const VotePoint* points,
                   int n,
                   const Similarity& s,
                   int tau8,
                   double free_chance);

// What a support says where this much of it is chance.
inline float AboveChance(float support, float excess_chance) {
  return (support - excess_chance) / (1.0f - excess_chance);
}

// An oriented distance map in cells of some pixels, with a border of far cells so that places are
// clamped, not tested.
struct CoarseMap {
  int cell_px = 0, width = 0, height = 0;  // the border included
  std::vector<std::uint8_t> distance;      // [bin][y][x], 1/8 px

  CoarseMap(const AspectImage& image, int cell);

  // As Support above.
  float Support(
      const FirstVotePoints& points, int from, int to, const Similarity& s, int tau8) const;
};

// Of one image.
struct CoarseMaps {
  explicit CoarseMaps(const AspectImage& image) : half(image, 2), quarter(image, 4) {}
  // The coarsest that says as much at this tolerance.
  const CoarseMap& For(int tau8) const;

  CoarseMap half, quarter;
};

}  // namespace horopter
