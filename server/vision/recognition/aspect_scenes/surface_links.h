// Views linked by how bright the surface of a symmetric or printed part is. Edges leave the turns
// of a symmetric part open, and of one that is printed all over they explain little: what is on its
// faces says which of them two views see.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

// A part in a view.
struct PoseInView {
  PinholeCamera camera;
  Rigid3 camera_from_object;
};

// What the surface of a placed part says of another view's poses of it: the one by which that view
// agrees best with its nearest of `views`, turned by an exact symmetry of the part.
struct SurfaceChoice {
  std::size_t pose = 0;
  Rigid3 turn;
  double correlation = 0.0;  // mean with these views
  double stated = 0.0;       // of the first pose without a turn; 0 where it says nothing
};
// Nothing where no other pose or turn is asked for, or none says anything. A surface of revolution
// shows its gloss, not itself: nothing is said of it.
std::optional<SurfaceChoice> ChooseBySurface(
    const AspectLinkInput& input,
    const std::vector<std::optional<AspectSceneView>>& views,
    const AspectSceneObject& placed,
    int view,
    std::span<const PoseInView> poses,
    const LinkTurns& turns);

// Scenes of one part each, whose outline most of the views show: three and more views, each by that
// hypothesis and symmetry by which they agree on the surface. Not adjusted; best first.
std::vector<AspectScene> ScenesBySurface(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const ViewLinks& links,
                                         const StopRequested& stop);

// One of them adjusted from the middle one of its focal lengths: a single image hardly says its
// own, and what is printed on the part is in its place only under the right one.
AspectScene FromOneFocal(const AspectLinkInput& input,
                         const AspectLinkOptions& options,
                         const AspectScene& scene);

}  // namespace horopter
