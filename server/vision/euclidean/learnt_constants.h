// What the metric scene has learnt from data: value, data set, commit, and the command that says
// how well it holds: the share of true poses inside of the stated 95 % ellipsoids
// (tests/bench/history/metric_scene.md). All were set by hand so that this share is right on
// parts-train: `euclidean_report parts-train train`.
#pragma once

namespace horopter {

// Displacement of a CAD edge in the part, the same in all views: rounded edges shine beside
// themselves. Standard deviation per coordinate, metres. Commit 76d7bf7.
inline constexpr double kCadEdgeSigmaM = 0.00004;
// Smallest deviations believed of an edge as a whole in one view, and of one point; working px.
// Commit 76d7bf7.
inline constexpr double kMinCommonPx = 0.08;
inline constexpr double kMinPointPx = 0.1;
// Factor on the deviations for all that is not modelled. Commit 1725a12.
inline constexpr double kDeviationInflation = 1.15;

// What the deviation of a plane cell's mean does not fall below, however many matches it has:
// pixels of an image kAdjustmentWidth wide. Commit 67275e0.
inline constexpr double kCellFloorPx = 0.12;
// Noise alone gives a patch this share of its structure in every direction. Commit 67275e0.
inline constexpr double kPatchNoiseShare = 0.4;

}  // namespace horopter
