// Views of a part alone that its near symmetries turned wrongly. A part that nothing else stands
// beside links the views by its own poses; edges hardly tell the turns of one that is nearly
// symmetric, and not at all those of one that is. A view that is turned wrongly has a wrong camera,
// which only the brightness of the part's surface and of the ground deny.
#pragma once

#include <optional>
#include <vector>

#include "server/vision/recognition/aspect_scenes/agreeing_poses.h"
#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

class ViewTurns {
 public:
  // What is pointed to outlives the object.
  ViewTurns(const AspectLinkInput& input,
            const AspectLinkOptions& options,
            const ViewLinks& links,
            const SceneObjects& objects);

  // The scene of one object with its views turned, not adjusted; nothing when its views agree as
  // they are, or no better turned.
  std::optional<AspectScene> Turned(const LinkedScene& scene) const;

 private:
  // Poses of the object in a view that score there nearly what the stated one does, which comes
  // first.
  std::vector<AllowedPose> AllowedIn(const LinkedScene& scene, int view) const;
  // Its near turns and the view's hypotheses of the same part that score there about `own`, what
  // the stated one does, or more; each adjusted to the view alone.
  std::vector<AllowedPose> OthersIn(const LinkedScene& scene, int view, double own) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const ViewLinks& links_;
  const SceneObjects& objects_;
};

}  // namespace horopter
