// From a linked scene to the answer of the aspects' route: what chance does not explain, and what
// another route found in the same places.
#pragma once

#include <string>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/object/joint_context.h"
#include "server/vision/recognition/refusals.h"
#include "server/vision/recognition/types.h"

namespace horopter {

// Scores of an object's views, -1 where it is not shown.
std::vector<double> ViewScores(const LinkedObject& o);

// Adds the object, with its best competing placement where that is closer than `ambiguity_gap`.
void AddAnswer(const LinkedObject& o,
               double probability,
               double ambiguity_gap,
               RecognitionResult* result);

// What else the images leave open in the answer's place, its own object for another pose of it: the
// result is ambiguous then.
void AddAlternative(int object, SceneObject* answer, RecognitionResult* result);

// Adds a sentence to RecognitionResult::detail.
void Tell(const std::string& sentence, RecognitionResult* result);

// Objects by their numbers in the catalog. log: may be null. with_cameras: cameras were known
// before any part.
RecognitionResult ToResult(const JointContext& context,
                           const LinkedScene& scene,
                           RefusalLog* log,
                           bool with_cameras = false);

}  // namespace horopter
