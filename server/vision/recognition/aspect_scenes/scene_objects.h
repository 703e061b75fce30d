// The objects of a scene held against its images: settled, judged, and one to a place.
#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_judgement.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"

namespace horopter {

// Of score; what LinkedObject::lies is worth while a scene grows
inline constexpr double kLyingBonus = 0.08;

inline constexpr double kFineRenderPx = 200.0;  // of the scores that are answered

// Poses of an object that are farther apart than this share of its size in an image are others.
inline constexpr double kOtherPoseShare = 0.1;

// Of the smaller diameter: centres so near are one place; chosen.
inline constexpr double kSamePlaceShare = 0.6;

struct SettledObject {
  AspectSceneObject placed;
  std::vector<PoseRendering> rendered;  // of it in each view's working image, on its way there
};

// Score of objects on whose plane others may lie while a scene grows.
inline constexpr double kPlaneScore = 0.5;

// By how much less than AspectLinkOptions::min_quick a candidate is clearly refused, whatever else
// hides of it; chosen.
inline constexpr double kClearly = 0.1;

// What an object explains of the images above chance, summed over the views that show it.
struct Explained {
  double above_chance = 0.0;
  int views = 0;
};

// What the objects of a scene explain together. One of them says where the cameras are, and each of
// its views bears it out; the place of every other is chosen in one view and borne out by the rest:
// small parts that fit two views by chance are not worth more than two further views.
double ExplainedTogether(std::span<const Explained> objects);

class SceneObjects {
 public:
  // What is pointed to outlives the object.
  SceneObjects(const AspectLinkInput& input,
               const AspectLinkOptions& options,
               const StopRequested& stop);

  // Views that show no object are no views, objects that explain too little are none. Returns what
  // the rest explains above chance.
  double Sift(AspectScene* scene) const;
  std::vector<LinkedObject> Judge(const AspectScene& scene, double render_px) const;
  // One object, rendered quickly.
  LinkedObject JudgeOne(const std::vector<std::optional<AspectSceneView>>& views,
                        const AspectSceneObject& placed,
                        std::span<const std::vector<ObjectLayer>* const> others = {},
                        std::span<PoseRendering> rendered = {}) const;
  // What the objects of a judged scene that are believed to hide others show, [object][view].
  SceneLayers HidingLayers(const LinkedScene& scene) const;
  // Whether no object of the scene is in this one's place: not in space, and none of the same part
  // in the images of all views, where wrong cameras may show one object as two.
  bool IsFree(const std::vector<std::optional<AspectSceneView>>& views,
              const std::vector<AspectSceneObject>& taken,
              const AspectSceneObject& o) const;
  // Candidates adjusted alone and added where the images bear them out and nothing else is. Those
  // that were clearly refused at nearly the same places of the same views are not asked for again.
  // least: score of what is added; what scores up to kClearly less than min_quick may be asked for
  // again.
  void Place(std::vector<AspectSceneObject> candidates, double least, AspectScene* scene) const;
  void Place(std::vector<AspectSceneObject> candidates, AspectScene* scene) const {
    Place(std::move(candidates), options_.min_quick, scene);
  }
  // An object adjusted alone, cameras fixed; nothing when too few of its edges are there.
  std::optional<SettledObject> Settled(
      const std::vector<std::optional<AspectSceneView>>& views,
      const AspectSceneObject& placed,
      std::span<const std::vector<ObjectLayer>* const> others = {}) const;
  LinkedScene Result(const AspectScene& scene) const;
  // The agreement of a scene with objects, with what its views say of the ground.
  ViewAgreement WithGround(const LinkedScene& scene) const;
  // Sets LinkedObject::surface of all objects, best first.
  void MeasureSurfaces(LinkedScene* scene) const;
  // Score, more where it lies on a plane.
  double Value(const LinkedObject& o) const;
  // Sets LinkedObject::lies, leans and level: beside or on others that score at least so much;
  // slack: see LiesOn.
  void FindLying(const std::vector<std::optional<AspectSceneView>>& views,
                 double least,
                 std::vector<LinkedObject>* judged,
                 double slack = 1.0) const;
  // In the end: beside those that score kPlaneScore, or less where none does.
  void FindLying(const std::vector<std::optional<AspectSceneView>>& views,
                 std::vector<LinkedObject>* judged,
                 double slack = 1.0) const;

 private:
  Explained ExplainedBy(const LinkedObject& o) const;
  std::vector<ObjectLayer> LayersOf(const LinkedScene& scene, const LinkedObject& o) const;
  // The best object in the views that show it; `without_hidden`: less what the others hide.
  std::vector<ObjectLayer> ShownOfFirst(const LinkedScene& scene, bool without_hidden) const;
  // Sets ViewAgreement::surface, and takes off the score what is not agreed on.
  void AgreeOnSurface(LinkedScene* scene) const;
  // Where parts may lie beside those of these that score at least so much, `but` left out.
  std::vector<SupportingPlane> PlanesOf(const std::vector<std::optional<AspectSceneView>>& views,
                                        const std::vector<LinkedObject>& judged,
                                        double least,
                                        int but = -1) const;
  // What Place has clearly refused: where the views showed it.
  struct Refused {
    int object = -1;
    std::vector<std::optional<Rigid3>> camera_from_object;
  };
  Refused InViews(const std::vector<std::optional<AspectSceneView>>& views,
                  const AspectSceneObject& placed) const;
  bool WasRefused(const std::vector<std::optional<AspectSceneView>>& views,
                  const Refused& asked) const;

  SceneJudgementOptions Judging(double render_px) const;
  // Leaves out what explains too little; the frame goes to the best. Returns what is explained.
  double Keep(std::vector<LinkedObject> judged, AspectScene* scene) const;
  Eigen::Vector3d CenterOf(const AspectSceneObject& o) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  std::vector<const RenderMesh*> meshes_;
  mutable std::vector<Refused> refused_;  // of Place alone, which runs on one thread
};

// An object's pose adjusted to the edges of all registered views, cameras fixed. render_px: see
// PoseEdgeOptions; others: what hides it, [object][view]. Nothing when fewer than `least_met` of
// its edge points meet image edges after the first round.
std::optional<SettledObject> SettleInViews(
    std::span<const AspectImage> images,
    const RenderMesh& mesh,
    const std::vector<std::optional<AspectSceneView>>& views,
    AspectSceneObject placed,
    double render_px,
    double least_met = 0.0,
    std::span<const std::vector<ObjectLayer>* const> others = {});

}  // namespace horopter
