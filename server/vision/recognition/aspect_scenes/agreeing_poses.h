// Of the poses of one part that single views allow, those by which the views agree on how bright
// the part's surface and the ground under it are.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/surface_agreement.h"

namespace horopter {

// Of a part in one view, whose edges give the score.
struct AllowedPose {
  Rigid3 camera_from_object;
  double score = 0.0;
};

struct ChosenPoses {
  std::vector<int> poses;  // of each view, index into its list; -1: the list is empty
  // Means over the pairs of views of the correlation over the surface, 0 where it does not tell,
  // and over the plane under the resting face that has the highest.
  double surface = 0.0, ground = 0.0;
  double score = 0.0;  // mean of the views'

  double Agreement() const { return surface + ground; }
};

struct AgreeingPoses {
  ChosenPoses first, best;  // the first of every list; the choice that is worth most
};

struct AgreeingPosesOptions {
  double render_px = 110.0;  // a diameter, of the surface that is compared
  // False for surfaces of revolution, whose shading and gloss turn with the light, not with them.
  bool surface_tells = true;
  int beam = 200;  // choices for the first views that are continued; chosen, for time
  int threads = 1;
};

// What a choice is worth is its agreement and its score together. `images`, `cameras` and `allowed`
// one per view; the first of a list is the pose that is stated.
AgreeingPoses FindAgreeingPoses(std::span<const AspectImage> images,
                                std::span<const PinholeCamera> cameras,
                                const RenderMesh& mesh,
                                std::span<const RestingFace> resting,
                                std::span<const std::vector<AllowedPose>> allowed,
                                const AgreeingPosesOptions& options = {});

}  // namespace horopter
