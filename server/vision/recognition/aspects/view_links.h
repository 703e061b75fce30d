// Links of views through the parts that both show: hypotheses of single images that agree on where
// the cameras stand, and the edges of what only one of them shows.
#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/recognition/aspects/aspect_linking.h"

namespace horopter {

// A placed object and the hypotheses of views that say so.
struct GrownObject {
  AspectSceneObject placed;
  std::vector<int> hypothesis;  // of each view, -1: none
};

// Some views linked, and what they agree on.
struct GrownScene {
  std::vector<std::optional<AspectSceneView>> views;
  std::vector<GrownObject> objects;
  double support = 0.0;
};

class ViewLinks {
 public:
  // What is pointed to outlives the object.
  ViewLinks(const AspectLinkInput& input,
            const AspectLinkOptions& options,
            const StopRequested& stop);

  // Of a view, best first.
  const std::vector<AspectHypothesis>& Hypotheses(int view) const { return hypotheses_[view]; }
  // Adds to what is known of a view.
  void Add(int view, std::vector<AspectHypothesis> more);

  void AppendSpread(std::span<const Rigid3> all, std::vector<Rigid3>* turns) const;
  // Links of pairs of views, best first, of each pair only a few.
  std::vector<GrownScene> Seeds() const;
  // Adds the view that the placed objects explain best, by the camera under which most of them are
  // where its hypotheses or its edges say. Returns it, -1: none of `wanted`.
  int Grow(const std::vector<bool>& wanted, GrownScene* scene) const;
  // Cameras and poses that agree best with what the views say of the objects: their hypotheses as
  // points, each part's symmetry chosen by what is nearest.
  void AdjustToHypotheses(const GrownScene& grown, AspectScene* scene) const;

 private:
  const AspectPart& PartOf(const AspectHypothesis& h) const { return in_.parts[h.object]; }
  // What hypotheses score above what chance gives wrong poses in their image: most of a long list
  // is wrong.
  static std::vector<double> Weights(const std::vector<AspectHypothesis>& kept);
  // Of a part seen in two views: as good as in the worse one, both count.
  static double Support(double a, double b);
  // The identity, the symmetries of a part and what is nearly one, at most max_symmetries of each,
  // spread over all of them: those of a surface of revolution are listed turn by turn.
  std::vector<Rigid3> Turns(int object) const;
  // Turns of a round part in steps of three degrees, both ways up when that looks the same.
  static std::vector<Rigid3> FineTurns(const AspectPart& part);
  AspectSceneView ViewOf(int v, const PinholeCamera& camera, const Rigid3& pose) const;
  // Whether a placed object of hypothesis h is where the view expects it.
  double Agreement(const AspectSceneView& view,
                   const Rigid3& expected,
                   const AspectHypothesis& h) const;
  // The hypothesis of view v that agrees best with an object placed at `expected` (camera frame).
  std::pair<int, double> BestAgreeing(int v,
                                      const AspectSceneView& view,
                                      int object,
                                      const Rigid3& expected) const;
  // Two views linked by one hypothesis of each, and the other parts that agree.
  GrownScene LinkPair(int a, int b, int i, int j, const Rigid3& turn) const;
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
  static std::vector<int> HypothesesOf(const GrownScene& scene, int v);
  // Edge points of the best hypotheses of each view.
  void RenderBest();
  bool IsApart(const Eigen::Vector3d& center,
               double diameter,
               const std::vector<Eigen::Vector3d>& places,
               const std::vector<double>& sizes) const;
  std::vector<GrownScene> PairSeeds(int a, int b) const;
  // Whether two links of views say nearly the same: where b's camera stands and looks from a's.
  bool IsSameLink(const GrownScene& s, const GrownScene& other, int a, int b) const;
  std::vector<GrownScene> SingleViewSeeds() const;
  static void KeepBest(std::size_t count, std::vector<GrownScene>* scenes);
  std::pair<double, AspectSceneView> BestView(
      const GrownScene& scene, const std::vector<std::vector<ModelEdgePoint>>& points, int v) const;
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

  // The turns by which hypotheses of one part may link two views: of a round part those that the
  // edges of other parts bear out, `support` says how well.
  template <typename SupportOfTurn>
  std::vector<Rigid3> LinkTurns(int object, const SupportOfTurn& support) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  std::vector<std::vector<double>> weights_;  // score above chance, of each hypothesis
  std::vector<const RenderMesh*> meshes_;
  // Of each view its best hypotheses' visible edges.
  std::vector<std::vector<std::vector<ModelEdgePoint>>> points_;
  std::vector<std::vector<Rigid3>> fine_turns_;  // of each part; empty: it is not round
};

}  // namespace horopter
