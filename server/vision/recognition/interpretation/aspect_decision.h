// How sure a part is that aspects found in a scene.
#pragma once

#include "server/vision/recognition/acceptance.h"
#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

// Score that makes a part alone even that so many of the views show, whose focal lengths agree.
double EvenInViews(int registered, int views, const AspectAcceptance& options);

// Whether the views agree on the surface of a part.
bool SurfaceTells(const LinkedObject& o, const AspectAcceptance& options);

// Score that makes a part even beside others that leave no doubt of the cameras.
double EvenBeside(const LinkedObject& o, const AspectAcceptance& options);

// The probability that object `o` of `scene`, whose objects are best first, is right: by its score,
// and by what else agrees on the cameras, which adapt to a single part.
double AspectProbability(const LinkedObject& o,
                         const LinkedScene& scene,
                         const AspectAcceptance& options);

// What AspectProbability must reach for an answer.
double NeededProbability(const AspectAcceptance& options);

// The same under cameras that were known before: each view speaks for itself.
double ProbabilityUnderCameras(const LinkedObject& o, const LinkedScene& scene);

}  // namespace horopter
