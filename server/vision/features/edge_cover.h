// Which pixels an edge of a given direction already covers.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Of maps of directions, about a degree a step: a pixel that no edge covers, and what two edges
// of one direction differ by at most.
inline constexpr std::uint8_t kFree = 255;
inline constexpr int kSameDirection = 30;
inline constexpr int kMinRun = 6;  // px of a chain between what is covered

// Map of the edges taken so far; positions are pixels inside width x height.
class EdgeCover {
 public:
  EdgeCover(int width, int height);

  // Undirected direction of the edge across a gradient, [0, 180); an L1 angle, within 4 degrees of
  // the true one.
  static uint8_t EdgeDirection(const Eigen::Vector2f& gradient);

  void Mark(const Eigen::Vector2f& point, uint8_t direction);
  // Is there an edge within 30 degrees in the 3x3 pixels about the point?
  bool Covers(const Eigen::Vector2f& point, uint8_t direction) const;

 private:
  int width_;
  int height_;
  std::vector<uint8_t> direction_;
};

// Equally long ones stay in their order.
void SortLongestFirst(std::vector<EdgeChain>* chains);

// Drops what a longer chain of another channel already covers; runs shorter than 6 points are
// dropped too. Chains of a single channel come back unchanged.
std::vector<EdgeChain> JoinLinkedChains(std::vector<EdgeChain> chains, int width, int height);

}  // namespace horopter
