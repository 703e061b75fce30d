// What the decision over aspects has learnt from data (tests/bench/fit_aspect_decision.py).
#pragma once

#include <array>

#include "server/vision/recognition/interpretation/decision_cues.h"

namespace horopter {

// Whether what aspects found is no chance fit: a constant and weights of the cues, in the order of
// DecisionCues, log odds. Fitted to 4,740 objects, 1,971 of them right, of cad-dev, parts-dev,
// parts-train and three sets of 20 - 24 parts of other people: their scenes with all parts, with
// one left out in turn and with none, and of three of the sets with the first two images and one
// alone. ADR 63.
inline constexpr double kCueConstant = -25.97;
inline constexpr std::array<double, kDecisionCues> kCueWeights = {
    3.67,   // precision
    16.05,  // score
    2.29,   // log_support
    1.06,   // surface_seen
    0.58,   // ground
    4.12,   // lies
    2.55,   // level
    -6.00,  // missing
    -0.81,  // one
    -3.03,  // first
    6.11,   // first_other
    4.86,   // first_ground
};

// The same of CameraCues: set by hand on what the photographs of prague, tools, benchvise and LM-O
// give with their own parts and with each other's (decision_report, --others), not fitted: there
// are 22 right ones and 6 impostors. Right ones have .7 and more but for a bolt and LM-O's (-5 -
// .5), impostors .6 at most. ADR 74.
inline constexpr double kCameraCueConstant = -26.8;
inline constexpr std::array<double, kCameraCues> kCameraCueWeights = {
    6.0,   // precision
    12.0,  // score
    4.0,   // least_precision
    2.0,   // log_support
    2.0,   // log_shown
    -3.0,  // missing
    0.5,   // lies
    8.0,   // ground
    2.0,   // company
};

}  // namespace horopter
