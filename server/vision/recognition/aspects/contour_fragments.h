// Pieces of contours described so that position, turn and size do not matter: nine equidistant
// points, the eight directions between them against the chord. After the k-adjacent segments of
// Ferrari, Fevrier, Jurie, Schmid 2008 and the edgelet paths of Damen et al. 2012.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "server/vision/recognition/aspects/contour_chains.h"

namespace horopter {

inline constexpr int kFragmentPoints = 9;                    // a fragment is sampled at; chosen
inline constexpr int kFragmentAngles = kFragmentPoints - 1;  // 16 bit each: one vector

using FragmentKey = std::array<float, kFragmentAngles>;  // radians

// A key in steps of 1 / kKeyScale rad: one 16 byte vector.
using PackedFragmentKey = std::array<std::int16_t, kFragmentAngles>;
inline constexpr float kKeyScale = 512.0f;  // steps a radian; kMaxPacked of them are 15.6 rad
PackedFragmentKey PackKey(const FragmentKey& key);
FragmentKey UnpackKey(const PackedFragmentKey& packed);

// Laws: `key` is unchanged by similarities; a mirror image has all angles negated; the same piece
// walked from its other end has them in reverse order and `chord_rad` turned by pi.
struct ContourFragment {
  FragmentKey key{};
  Eigen::Vector2f center = Eigen::Vector2f::Zero();  // mean of the nine points
  Eigen::Vector2f pivot = Eigen::Vector2f::Zero();   // the point where the fragment turns most
  float spread = 0.0f;                               // rms distance of the nine points to center
  float chord_rad = 0.0f;                            // direction from the first to the last point
  float length = 0.0f;                               // along the contour
  float turning = 0.0f;                              // sum of the absolute turns, radians
};

struct FragmentOptions {
  double min_length = 0.0;  // in the unit of the points
  double max_length = 0.0;
  double length_factor = 1.25;    // between one length and the next
  double start_share = 0.125;     // of the length: distance between starts
  double min_step = 2.0;          // between starts at least
  double min_bend_rad = 0.16;     // rms of the key; straighter pieces say nothing
  double min_chord_share = 0.15;  // chord over length; nearly closed pieces have no direction
};

// Of nine points; nothing if they are nearly straight or nearly closed.
std::optional<ContourFragment> MakeFragment(
    const std::array<Eigen::Vector2f, kFragmentPoints>& points, const FragmentOptions& options);

// The same piece walked from the other end.
ContourFragment Reversed(const ContourFragment& fragment);

// All pieces of the lengths min_length * length_factor^k up to max_length, each walked one way
// only.
std::vector<ContourFragment> CollectFragments(const ContourGraph& graph,
                                              const FragmentOptions& options);

// Leaves out pieces that come again, at one size and direction, in more than max_repeats places:
// holes of a perforated sheet, teeth, weave. Places nearer than a piece's spread are one.
void DropRepeated(int max_repeats, std::vector<ContourFragment>* fragments);

// Sum of squared differences of two keys.
inline float SquaredDistance(const FragmentKey& a, const FragmentKey& b) {
  float sum = 0.0f;
  for (int i = 0; i < kFragmentAngles; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

}  // namespace horopter
