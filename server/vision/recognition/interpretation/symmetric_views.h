// Views of a symmetric part that nothing but the part links.
#pragma once

#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scene/surface_texture.h"

namespace horopter {

// The edges of a symmetric part are the same in all its equivalent poses, so that views which only
// the part links may each have taken another one: the cameras then stand around it in wrong places.
// The texture on its faces tells: view by view the equivalent pose is taken in which the faces look
// most like they do in the views before it. Scenes of several objects, views that the supporting
// plane links to another, surfaces of revolution and parts without texture stay as they are. Where
// the equivalent poses do not help, the view's own hypotheses of the part are tried.
void AlignSymmetricViews(const JointContext& context,
                         const HypothesisTable& hypotheses,
                         const SurfaceImages* images,
                         SceneModel* scene);

}  // namespace horopter
