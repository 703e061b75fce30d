// What is shallow and seen from afar looks the same turned inside out (Necker's reversal).
#pragma once

#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/scene_views.h"

namespace horopter {

// The scene with its depths turned round, seen from the first registered view, about the points'
// middle, which every camera sees where it did: exactly the same images where there is no
// perspective. Its lines are left as they are.
CalibratedScene TurnedInsideOut(const CalibratedScene& scene);

// Largest angle between the relative rotations that two solutions give, to the first view of both.
double LargestTurn(OptionalViews a, OptionalViews b);

}  // namespace horopter
