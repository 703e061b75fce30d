// Votes of one image's contour fragments for aspects of parts, tested against its distance maps.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// Limits of numbers are those of an image of kLimitsPx working pixels; larger ones, which show as
// much more beside the parts, have as many more.
inline constexpr double kLimitsPx = 640.0 * 480.0;

struct AspectVoteOptions {
  double min_fragment_px = 22.0;
  double fragment_factor = 1.25;
  double start_share = 0.1;  // FragmentOptions::start_share, min_step of the image's contours
  double min_step = 2.0;
  // Matches of one fragment that are tested, those with the nearest keys: common shapes match
  // tens of thousands, and come again in the lengths and starts beside them.
  int max_matches = 120;
  // Pieces that the image holds in more places than this, at one size and turn, are pattern.
  int max_repeats = 6;
  double key_rms_rad = 0.18;  // fragments whose keys differ by less are alike
  // Pairs of adjacent straight edges (segment_pairs.h): openings that differ by less are alike.
  // Both lengths give the size where they agree, else the one that is less cut off.
  double pair_opening_rad = 0.14;
  double pair_log_ratio = 0.2;  // up to this lengths agree
  int max_pairs = 300;          // of the image
  int max_pair_matches = 6000;  // of one pair that are tested, those that agree before others
  double min_arm_px = 12.0;
  double max_arm_offset_px = 1.8;  // SegmentPairOptions::max_offset of the image's
  double ellipse_ratio = 0.1;      // of axes: ellipses that differ by less are alike
  int max_ellipse_matches = 2000;  // of one ellipse that are tested, spread over all
  double min_size_px = 32.0;       // diameter of the smallest part sought
  double max_size_share = 1.6;     // of the image's width: ... of the largest
  double tau_share = 0.045;        // of the diameter: an edge farther away supports nothing
  double min_tau_px = 1.5;
  // Least support (0..1) on 6 and 16 points as matched, and on all points after the climb. Raising
  // them is faster and loses parts that are hidden or faint.
  double min_support_6 = 0.36;
  double min_support_16 = 0.42;
  double min_support = 0.50;
  double rank_support = 0.45;  // rank = length (px) x ((support - chance) / (1 - chance) - this)
  double free_chance = kFreeChance;  // chance up to this, as parts have themselves, costs nothing
  int pool = 2000;                   // votes kept of a part before the distinct ones are chosen
  int max_per_object = 80;           // distinct votes of a part
  int max_per_place = 16;            // ... with their centres in one place
  int threads = 1;
};

// A similarity that puts an aspect into the image: working pixels.
struct AspectVote {
  float rank = 0.0f;
  float support = 0.0f;
  std::int32_t aspect = -1;  // of FragmentIndex::aspects
  float size_px = 0.0f;      // of the diameter at the centre's depth
  float turn_rad = 0.0f;     // from the aspect's x axis to the image's, x towards y
  float x = 0.0f, y = 0.0f;  // of the centre of the bounding box
};

struct AspectVotes {
  std::vector<std::vector<AspectVote>> of_model;  // distinct, best first
  std::int64_t fragments = 0;                     // of the image
  std::int64_t matches = 0;                       // of the index
  std::int64_t pairs = 0, pair_matches = 0;       // the same of adjacent straight edges
  std::int64_t ellipses = 0, ellipse_matches = 0;
  std::int64_t tests_16 = 0, climbs = 0, accepted = 0;
};

// Empty lists when the image or the index is; what was found so far when stopped. The same for
// every number of threads. `wanted`: a flag for each part of the index, the others get no votes;
// empty: all.
AspectVotes VoteForAspects(const AspectImage& image,
                           const FragmentIndex& index,
                           const AspectVoteOptions& options = {},
                           const StopRequested& stop = {},
                           std::span<const std::uint8_t> wanted = {});

// The best of a part's votes that differ in place, size or turn, best first.
std::vector<AspectVote> ChooseDistinct(std::vector<AspectVote> pool,
                                       const FragmentIndex& index,
                                       std::span<const Rigid3> symmetries,
                                       const AspectVoteOptions& options);

// The pose that a vote means for a camera (of the working image): the aspect turned about its axis
// and carried onto the ray of its centre, without the lens.
Rigid3 PoseOfVote(const AspectVote& vote, const FragmentIndex& index, const PinholeCamera& camera);

}  // namespace horopter
