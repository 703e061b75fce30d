// What may stand where a part was answered and is in no catalog: the part stretched, or with a
// feature (hole, pocket, boss) more, less or elsewhere.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

// Something that may be instead of one answered object.
struct Rival {
  SceneAlternative what;                               // without probability and views
  double weight = 0.0;                                 // how much likelier than the answer it is
  std::string words;                                   // "it is ..."
  std::function<std::vector<ViewDifference>()> views;  // SceneAlternative::views, when asked for
};

// Edges err together: log odds of what they say are believed by so much.
inline constexpr double kEdgeBelief = 0.5;

// Of the answer's object number `place`, which has aspects. hidden: see LogOddsBetween. Poses and
// cameras of the answer are kept; the rivals refer to the context and outlive nothing of it.
std::vector<Rival> FindStrangers(const JointContext& context,
                                 std::span<const AspectImage> images,
                                 const RecognitionResult& result,
                                 int place,
                                 std::span<const DepthBuffer> hidden);

}  // namespace horopter
