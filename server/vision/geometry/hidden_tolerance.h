// By how much a point of a part may lie behind what a depth buffer shows of the part itself and
// still be seen: shares of the part's diameter. A buffer's cells and the error of a pose both let
// an edge slip behind its own faces, so that the tolerance grows with the error.
#pragma once

namespace horopter {

// Of poses that are exact or adjusted: enrolment's own views, the metric adjustment.
inline constexpr double kHiddenShareAdjusted = 0.012;
// Of poses that are found and judged.
inline constexpr double kHiddenShareFound = 0.015;
// Of points inside faces, and of poses that are compared with others: nothing is lost by being
// generous away from the edges.
inline constexpr double kHiddenShareOfFaces = 0.02;

}  // namespace horopter
