// How well hypotheses of single views, and the edges of their parts, bear out that another view's
// camera stands where a link of the two says.
#pragma once

#include <utility>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

namespace horopter {

inline constexpr double kLeastChance = 0.25;  // of a wrong pose's score in an image

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
  const RenderMesh& MeshOf(int object) const { return in_.models[object].object->mesh; }
  AspectSceneView ViewOf(int v, const PinholeCamera& camera, const Rigid3& pose) const;
  // The hypothesis of view v that agrees best with an object placed at `expected` (camera frame),
  // and its weight times how well; -1: none.
  std::pair<int, double> BestAgreeing(int v,
                                      const AspectSceneView& view,
                                      int object,
                                      const Rigid3& expected) const;
  // What the edges of view `from`'s best hypotheses find where a link of two views shows them in
  // view `to`: settles which of a symmetric part's turns links them. Of one place of the image the
  // one that finds most counts, of those of the `known` hypotheses none: they need no telling.
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

  // Visible edges of a hypothesis, and which place of its image it has.
  struct CarriedEdges {
    int hypothesis = -1;
    int place = -1;
    std::vector<ModelEdgePoint> points;
  };
  std::vector<int> PlacesOf(int view) const;
  std::vector<CarriedEdges> Carried(int view) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  std::vector<std::vector<double>> weights_;
  std::vector<std::vector<int>> places_;            // of each hypothesis the first one in its place
  std::vector<std::vector<CarriedEdges>> carried_;  // of each view's best hypotheses
};

}  // namespace horopter
