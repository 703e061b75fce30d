// How well hypotheses of single views, and the edges of their parts, bear out that another view's
// camera stands where a link of the two says.
#pragma once

#include <utility>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

class HypothesisSupport {
 public:
  // What is referred to outlives the object.
  HypothesisSupport(const AspectLinkInput& input, const AspectLinkOptions& options);

  // Of a view, best first.
  const std::vector<AspectHypothesis>& Hypotheses(int view) const { return hypotheses_[view]; }
  // Adds to what is known of a view.
  void Add(int view, std::vector<AspectHypothesis> more);

  // What a hypothesis scores above what chance gives wrong poses in its image.
  double Weight(int view, std::size_t i) const { return weights_[view][i]; }
  bool IsByChance(int view, std::size_t i) const;
  // Hypotheses of a view whose edges are carried into others: the first so many.
  std::size_t CarriedCount(int view) const { return points_[view].size(); }

  const RenderMesh& MeshOf(int object) const { return in_.models[object].object->mesh; }
  AspectSceneView ViewOf(int v, const PinholeCamera& camera, const Rigid3& pose) const;
  // The hypothesis of view v that agrees best with an object placed at `expected` (camera frame),
  // and its weight times how well; -1: none.
  std::pair<int, double> BestAgreeing(int v,
                                      const AspectSceneView& view,
                                      int object,
                                      const Rigid3& expected) const;
  // What the edges of view `from`'s best hypotheses find where a link of two views shows them in
  // view `to`: settles which of a symmetric part's turns links them. `known` needs no telling.
  double CarriedSupport(const AspectSceneView& view_from,
                        const AspectSceneView& view_to,
                        int from,
                        int to,
                        const std::vector<int>& known) const;
  // Support of a part's edge points above what a wrong place gives, 0 .. 1; its pose is not exact.
  double Found(int v,
               int object,
               const std::vector<ModelEdgePoint>& points,
               const PinholeCamera& camera,
               const Rigid3& pose) const;
  // Edge points of a part as a camera sees it.
  std::vector<ModelEdgePoint> EdgePoints(int object,
                                         const PinholeCamera& camera,
                                         const Rigid3& camera_from_object) const;

 private:
  double Agreement(const AspectSceneView& view,
                   const Rigid3& expected,
                   const AspectHypothesis& h) const;

  std::vector<std::vector<ModelEdgePoint>> Carried(int view) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  std::vector<std::vector<double>> weights_;
  // Of each view its best hypotheses' visible edges.
  std::vector<std::vector<std::vector<ModelEdgePoint>>> points_;
};

}  // namespace horopter
