// Rivals of an accepted object: other poses of it and other objects in its place that the images
// may support as well.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// Share of its volume that a placement has in common with another in the same place: rivals of an
// object, and the runners-up that decision.h asks for.
inline constexpr double kSamePlaceVolume = 0.3;

struct RivalOptions {
  double misfit_diameters =
      0.06;  // mean distance of the edges after a turn that is nearly a symmetry
  double min_shared_volume = kSamePlaceVolume;  // less: they do not exclude each other
  double max_score_deficit = 0.15;  // before a rival's own refinement; worse ones are not looked at
  int most_per_object = 8;
};

// Turns about the axes of the bounding box, by quarters, that are no symmetry of the object but
// bring its edges nearly onto themselves.
std::vector<Rigid3> NearSymmetries(const PreparedObject& object, double misfit_diameters);

struct Rival {
  int accepted = -1;  // index into scene->objects
  PlacedObject placed;
  // Joint score with cameras and the other objects refined to this rival, more or less by what
  // sharpness and the texture on its faces say for it and not for the winner.
  double score = 0.0;
  double gain = 0.0;  // of the whole scene then
};

// Puts every rival in the place of its accepted object, refines cameras and objects as for an
// answer, and judges it. rivals come from `placements` and from near symmetries. A rival that leads
// to a better scene by both score and gain, or whose faces clearly agree better in texture, takes
// the place; the one that loses it becomes a rival.
std::vector<Rival> ContestObjects(const JointContext& context,
                                  std::span<const PlacedObject> placements,
                                  const RivalOptions& options,
                                  SceneModel* scene);

}  // namespace horopter
