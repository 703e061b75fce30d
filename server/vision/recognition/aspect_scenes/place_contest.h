// What else could stand in an object's place: turns of nearly symmetric parts, other poses and
// other parts that single images show there, and how well the best other part does.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

class PlaceContest {
 public:
  // What is pointed to outlives the object.
  PlaceContest(const AspectLinkInput& input,
               const AspectLinkOptions& options,
               const ViewLinks& links,
               const SceneObjects& objects);

  // Of an object that is nearly symmetric the turn which the images of all views bear out best.
  // Returns whether any was turned.
  bool ChooseTurns(LinkedScene* scene) const;
  // Other poses that single images show better in an object's place, of it and of other parts, take
  // its place where all views say so; `standing`: more of them, of the same parts. Returns whether
  // any did.
  bool Contest(LinkedScene* scene, std::span<const AspectSceneObject> standing = {}) const;
  // Notes the best score that another part's hypothesis has in the place of each object.
  void FindBestCompeting(LinkedScene* scene) const;

 private:
  struct Rated {
    AspectSceneObject placed;
    double score = 0.0;  // in all views; 0: too few of its edges are there
  };
  // What hides an object: layers of others, in all views.
  using Hiding = std::vector<const std::vector<ObjectLayer>*>;
  // Of those of a scene's objects, what stands before one of them: what scores more. The rivals for
  // its place are hidden by the same.
  static Hiding HidingOf(const LinkedScene& scene, const SceneLayers& layers, std::size_t object);
  static bool IsWorse(const Rated& a, const Rated& b) { return a.score < b.score; }
  // Candidates adjusted to all views and judged there, in their order.
  std::vector<Rated> Settled(const LinkedScene& scene,
                             const std::vector<AspectSceneObject>& candidates,
                             const Hiding& hiding = {}) const;
  // What placed instead of an object of the scene is worth more where it lies on a plane of the
  // others, as everywhere else.
  double BonusOf(const LinkedScene& scene,
                 std::size_t object,
                 const AspectSceneObject& placed) const;
  const RenderMesh& MeshOf(int object) const { return in_.models[object].object->mesh; }
  // Whether the scene has this object in this place.
  bool IsAccepted(const LinkedScene& scene, int object, const Eigen::Vector3d& center) const;
  // Hypotheses in the place of an object that score in their image what it scores there, or nearly
  // so, best first.
  std::vector<AspectSceneObject> BetterInOneView(const LinkedScene& scene,
                                                 const LinkedObject& o) const;

  // Those of the candidates that are another pose of the object in its place.
  std::vector<AspectSceneObject> OtherPoses(const LinkedScene& scene,
                                            const LinkedObject& o,
                                            std::span<const AspectSceneObject> candidates) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const ViewLinks& links_;
  const SceneObjects& objects_;
};

// Poses of an object that are farther apart than this share of its size in an image are others.
inline constexpr double kOtherPoseShare = 0.1;

// Of the smaller diameter: centres so near are one place; chosen.
inline constexpr double kSamePlaceShare = 0.6;

}  // namespace horopter
