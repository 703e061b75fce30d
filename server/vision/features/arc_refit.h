// Arcs fitted once more to the points of their edges by orthogonal distance (thesis 2.4), where the
// stage itself fits them to the gradient about their rim.
#pragma once

#include "server/vision/features/features.h"

namespace horopter {

// Replaces each arc of `features` by FitEllipseGeometric of the chain points within 1.5 px of it
// and inside its sweep; arcs with fewer than 12 such points, or that no ellipse fits within 1.5 px
// rms, stay. counts["arcs_refitted"] says how many were replaced.
void RefitArcs(ImageFeatures* features);

}  // namespace horopter
