// How sure a part is that aspects found in a scene.
#pragma once

#include "server/vision/recognition/acceptance.h"
#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

// The probability that object `o` of `scene`, whose objects are best first, is right: by its score,
// and by what else agrees on the cameras, which adapt to a single part.
double AspectProbability(const LinkedObject& o,
                         const LinkedScene& scene,
                         const AspectAcceptance& options);

// The same under cameras that were known before: each view speaks for itself.
double ProbabilityUnderCameras(const LinkedObject& o, const LinkedScene& scene);

}  // namespace horopter
