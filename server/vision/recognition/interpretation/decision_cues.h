// What speaks for and against a part that aspects found, as numbers whose weighted sum is the
// logarithm of a likelihood ratio: the decision is learnt from them (learnt_cue_weights.h,
// tests/bench/fit_aspect_decision.py).
#pragma once

#include <array>
#include <cstddef>
#include <string_view>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

inline constexpr std::size_t kDecisionCues = 12;

// In the order of kCueWeights. Means are over the views that show the part.
//   precision      of the edges it should show, those that are found
//   score          LinkedObject::score
//   log_support    logarithm of the mean length of edge found and 50 px more
//   surface_seen   1 where views can be compared on how bright its surface is
//   ground         ViewAgreement::ground
//   lies, level    1 where it lies on a plane with others; is level with one but does not lie
//   missing        share of the images that are not linked
//   one            1 where only one is
//   first          1 for the best part, to which the cameras adapt
//   first_other    of the best part: score of the best other one of 0.40 and more, 0.32 where it
//                  lies, else 0
//   first_ground   of the best part where three images and more are linked: `ground`, 0.4 at most
using DecisionCues = std::array<double, kDecisionCues>;

// Of an object of the scene, whose objects are best first.
DecisionCues CuesOf(const LinkedObject& o, const LinkedScene& scene);

const std::array<std::string_view, kDecisionCues>& CueNames();

// Logarithm of how much likelier it is that the part is right than that chance put it there, with
// what is likely before the images are seen.
double FittedLogOdds(const DecisionCues& cues);

inline constexpr std::size_t kCameraCues = 9;

// The same of an object under cameras that were known before, in the order of kCameraCueWeights:
// they adapt to no part, so each view that shows it speaks for itself.
//   precision        as above
//   score            as above
//   least_precision  of the view that shows least
//   log_support      as above
//   log_shown        logarithm of the number of views that show it
//   missing          share of the images whose cameras are not known, or hold for nothing
//   lies             as above
//   ground           ViewAgreement::ground above what chance gives where the ground has texture:
//                    cameras that know nothing of the part agree on what it stands on; else 0
//   company          1 where a better part of the scene is sure: both share cameras and their unit
using CameraCues = std::array<double, kCameraCues>;
CameraCues CameraCuesOf(const LinkedObject& o, const LinkedScene& scene);
double FittedLogOdds(const CameraCues& cues);

}  // namespace horopter
