// What features have learnt from data: value, data set, commit, and how it is found again.
#pragma once

namespace horopter {

// Where the light of an edge has its step (light_response.cc). Chosen together on parts-train,
// commit 3adafc1, in a one-off comparison of the edges found with those of the parts at their true
// poses (tests/bench/history/metric_scene.md): edges of tiers T1, T2, T3 were 0.40, 0.42, 0.58 of
// the distance off that the blur alone would give. `euclidean_report parts-train train` says how
// far poses and cameras then are from the truth.
//
// What the detector's smoothing and differences make of a sharp step, px, all directions together.
inline constexpr double kDetectorWidthPx = 1.3;
// Share of the way to the middle of the grey step at which its steepest place lies.
inline constexpr double kSteepestShare = 0.65;

}  // namespace horopter
