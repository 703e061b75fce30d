// Views linked by how bright the surface of a symmetric or printed part is. Edges leave the turns
// of a symmetric part open, and of one that is printed all over they explain little: what is on its
// faces says which of them two views see.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

// What the surface of a placed part says of a view: the exact symmetry of the part by which the
// view agrees best with the others, and the mean correlation with them there; nothing where they
// say nothing. A surface of revolution shows its gloss, not itself: nothing is said of it.
struct SurfaceTurn {
  Rigid3 turn;
  double correlation = 0.0;
  double stated = 0.0;  // without the turn; 0 where that says nothing
};
std::optional<SurfaceTurn> TurnBySurface(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const std::vector<std::optional<AspectSceneView>>& views,
                                         const AspectSceneObject& placed,
                                         int view,
                                         const PinholeCamera& camera,
                                         const Rigid3& camera_from_object);

// Scenes of one part each, whose outline most of the views show: three and more views, each by that
// hypothesis and symmetry by which they agree on the surface. Not adjusted; best first.
std::vector<AspectScene> ScenesBySurface(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const ViewLinks& links,
                                         const StopRequested& stop);

}  // namespace horopter
