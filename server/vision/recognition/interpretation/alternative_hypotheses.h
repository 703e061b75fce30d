// Alternatives of an accepted object: other poses of it and other objects in its place that the
// images may support as well.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scene/surface_texture.h"

namespace horopter {

// Turns about the axes of the bounding box, by quarters, that are no symmetry of the object but
// bring its edges nearly onto themselves.
std::vector<Rigid3> NearSymmetries(const PreparedObject& object, double misfit_diameters);

struct Alternative {
  int accepted = -1;  // index into scene->objects
  PlacedObject placed;
  // Joint score with cameras and the other objects refined to this alternative, more or less by
  // what sharpness and the texture on its faces say for it and not for the winner.
  double score = 0.0;
  double description_gain = 0.0;  // of the whole scene then
};

// Puts every alternative in the place of its accepted object, refines cameras and objects as for an
// answer, and judges it. alternatives come from `placements` and from near symmetries. A
// alternative that leads to a better scene by both score and description-length gain, or whose
// faces clearly agree better in texture, takes the place; the one that loses it becomes an
// alternative. images: null, texture says nothing.
std::vector<Alternative> ContestObjects(const JointContext& context,
                                        const SurfaceImages* images,
                                        std::span<const PlacedObject> placements,
                                        SceneModel* scene);

}  // namespace horopter
