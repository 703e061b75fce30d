// A scene completed: what else its views show is carried into all of them, adjusted and verified
// together with it. The same for cameras that parts have linked and for those that are known before
// any part is.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/transfer.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

// Cameras that are known before any part: scenes are in the prior's frame, in metres. Without them
// cameras are what parts say.
struct PriorCameras {
  const CamerasPrior* prior = nullptr;
  const ContourPoints* contours = nullptr;  // of the parts searched for
};

// What a scene of known cameras explains above chance: its score.
double WorthOf(const LinkedScene& scene);

class SceneCompletion {
 public:
  // What is pointed to outlives the object.
  SceneCompletion(const AspectLinkInput& input,
                  const AspectLinkOptions& options,
                  const ViewLinks& links,
                  const SceneObjects& objects,
                  const StopRequested& stop,
                  const PriorCameras& known = {});

  // Drops what the images contradict, adds what they show beside it, adjusts and verifies, while
  // objects are added. unit_m: of known cameras, as CamerasPrior has it.
  LinkedScene Finish(AspectScene scene, double unit_m = 1.0) const;
  // Hypotheses of all views in the scene's cameras, at most so many, those that most views confirm.
  void AddCarried(int most, AspectScene* scene) const;
  // Cameras, objects and the unit of known cameras, over the edges met.
  void Adjust(AspectScene* scene, CamerasPrior* known) const;
  // Parts on the planes under those found which no single image showed well enough. Returns whether
  // any was added.
  bool AddStanding(LinkedScene* best);
  // A view that stays poor has a wrong camera: better none. The rest is finished without it.
  void LeaveOutPoorViews(LinkedScene* best) const;
  // Last: parts that say little by their edges; how well other parts do in each place; what the
  // views say of the ground.
  void Conclude(LinkedScene* best) const;

 private:
  std::vector<AspectSceneObject> Carried(const AspectScene& scene) const;
  std::vector<AspectSceneObject> Transferred(const AspectScene& scene) const;
  std::vector<AspectSceneObject> FreeCarried(int most, const AspectScene& scene) const;
  std::vector<AspectSceneObject> Standing(std::span<const StandingPlane> planes,
                                          const AspectScene& scene) const;
  std::vector<AspectSceneObject> StandingAgain(const AspectScene& scene) const;
  void AddFaint(LinkedScene* best) const;
  LinkedScene Verified(const AspectScene& scene) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const ViewLinks& links_;
  const SceneObjects& objects_;
  const StopRequested& stop_;
  const CamerasPrior* known_;
  const ContourPoints* contours_;
  std::vector<const RenderMesh*> meshes_;
  // What was looked at on planes last, and the best object of then.
  struct Stood {
    AspectSceneObject beside;
    std::vector<AspectSceneObject> candidates;
  } stood_;
};

}  // namespace horopter
