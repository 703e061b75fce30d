// Links of views through the parts that both show: hypotheses of single images that agree on where
// the cameras stand, and the edges of what only one of them shows.
#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/recognition/aspect_scenes/pair_links.h"

namespace horopter {

class ViewLinks {
 public:
  // What is pointed to outlives the object.
  ViewLinks(const AspectLinkInput& input,
            const AspectLinkOptions& options,
            const StopRequested& stop);

  // The view of a scene in which the hypothesis' part is where its own frame is.
  AspectSceneView ViewOf(int view, const AspectHypothesis& h) const {
    return support_.ViewOf(view, h.camera, h.camera_from_object);
  }
  // Of a view, best first.
  const std::vector<AspectHypothesis>& Hypotheses(int view) const {
    return support_.Hypotheses(view);
  }
  // Adds to what is known of a view.
  void Add(int view, std::vector<AspectHypothesis> more) {
    support_.Add(view, std::move(more));
    ++added_;
  }
  // How often that was done: whether more is known than before.
  int added() const { return added_; }
  // The hypotheses of all registered views in a scene with these cameras, best first.
  std::vector<AspectSceneObject> Carried(
      const std::vector<std::optional<AspectSceneView>>& views) const;
  const LinkTurns& turns() const { return turns_; }

  // Links of pairs of views, best first, of each pair only a few.
  std::vector<GrownScene> InitialScenes() const;
  // Adds the view that the placed objects explain best, by the camera under which most of them are
  // where its hypotheses or its edges say. Returns it, -1: none of `wanted`.
  int Grow(const std::vector<bool>& wanted, GrownScene* scene) const;
  // Cameras and poses that agree best with what the views say of the objects: their hypotheses as
  // points, each part's symmetry chosen by what is nearest.
  void AdjustToHypotheses(const GrownScene& grown, AspectScene* scene) const;

 private:
  std::pair<double, AspectSceneView> BestView(
      const GrownScene& scene, const std::vector<std::vector<ModelEdgePoint>>& points, int v) const;
  // A view by a hypothesis for an object of the scene, and what supports it.
  struct LinkedView {
    double support = 0.0;
    AspectSceneView view;
    const GrownObject* by = nullptr;
  };
  // The first of the list, best first, unless the surface of the part that links it asks for a
  // symmetry of that part, or for another one of the list.
  AspectSceneView ChosenBySurface(const GrownScene& scene,
                                  int v,
                                  std::span<const LinkedView> linked) const;
  // What a view under this camera says of the scene's objects: by its hypotheses, or else by its
  // edges. Of all but `linking`.
  double SupportOfView(const GrownScene& scene,
                       const std::vector<std::vector<ModelEdgePoint>>& points,
                       int v,
                       const AspectSceneView& view,
                       const GrownObject* linking) const;
  // What the edges of the registered view nearest in number bear out of the view's own hypotheses.
  double SupportInOthers(const GrownScene& scene,
                         int v,
                         const AspectSceneView& view,
                         const AspectHypothesis& linking) const;
  // Visible edges of the scene's objects, each as the first view that is registered sees it.
  std::vector<std::vector<ModelEdgePoint>> PointsOf(const GrownScene& scene) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  const LinkTurns turns_;
  HypothesisSupport support_;
  int added_ = 0;
};

}  // namespace horopter
