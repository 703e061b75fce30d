#include "server/vision/recognition/aspect_scenes/hypothesis_support.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspect_search/near_plane.h"

namespace horopter {
namespace {

constexpr int kHypothesesPerView = 60;   // best of a view that link and are carried over
constexpr double kMinHypothesis = 0.12;  // score of these
// Of its size: a part carried into another view may be so far off
constexpr double kCarriedOffShare = 0.35;
constexpr double kLeastWeight = 0.003;  // of a hypothesis that is no better than chance
constexpr double kMostChance = 0.5;     // ... and at most; chosen, commit cffbdd4
constexpr std::size_t kLongList = 12;   // hypotheses of which a fifth may be right
constexpr double kTurnedAgrees = 0.9;  // of a round part that small features turn otherwise; chosen
constexpr double kCarriedReach = 0.06;             // of the size
constexpr double kCarriedReachPx[] = {4.0, 12.0};  // working px, least and most; chosen
constexpr std::size_t kCarriedHypotheses = 8;      // of a view, by their edges in the other one
constexpr std::size_t kCarriedOfPlace = 2;         // ... of one place; chosen
constexpr double kSamePlace = 0.2;       // of the smaller size, between two centres; chosen
constexpr int kCarriedPoints = 48;       // of an object; chosen, for time
constexpr double kCarriedChance = 0.35;  // support of edges in a wrong place

// What a fifth of a list reaches: most of a long one is wrong.
double ChanceOf(std::vector<double> scores) {
  if (scores.size() < kLongList) return kLeastChance;
  std::sort(scores.begin(), scores.end(), std::greater<>());
  return std::clamp(scores[scores.size() / 5], kLeastChance, kMostChance);
}

// Where none would be kept by its own score the view's parts may be printed on all over: then the
// score counts that two views presume.
std::vector<double> Weights(const std::vector<AspectHypothesis>& kept, double min_joint) {
  const bool any_stands = std::any_of(
      kept.begin(), kept.end(), [&](const AspectHypothesis& h) { return h.score >= min_joint; });
  std::vector<double> weights;
  for (const AspectHypothesis& h : kept) {
    weights.push_back(
        any_stands ? h.score : PresumedScore(h.precision, h.recall, h.support_px, kPresumedRecall));
  }
  const double chance = ChanceOf(weights);
  for (double& weight : weights) weight = std::max(kLeastWeight, weight - chance);
  return weights;
}

// The turn about the axis that brings a pose nearest to another.
Rigid3 TurnTowards(const SymmetryAxis& axis, const Rigid3& pose, const Rigid3& other) {
  const Eigen::Matrix3d M = other.R.transpose() * pose.R;
  const Eigen::Vector3d skew(M(2, 1) - M(1, 2), M(0, 2) - M(2, 0), M(1, 0) - M(0, 1));
  const double cosine = M.trace() - axis.axis.dot(M * axis.axis);
  return TurnAbout(axis, -std::atan2(axis.axis.dot(skew), cosine));
}

}  // namespace

HypothesisSupport::HypothesisSupport(const AspectLinkInput& input, const AspectLinkOptions& options)
    : in_(input), options_(options) {
  for (std::size_t v = 0; v < in_.images.size(); ++v) {
    std::vector<AspectHypothesis> kept;
    for (const AspectHypothesis& h : in_.hypotheses[v]) {
      if (static_cast<int>(kept.size()) >= kHypothesesPerView) break;
      if (h.score >= kMinHypothesis) kept.push_back(h);
    }
    weights_.push_back(Weights(kept, options.min_joint));
    hypotheses_.push_back(std::move(kept));
  }
  places_.resize(in_.images.size());
  carried_.resize(in_.images.size());
  ParallelFor(static_cast<int>(carried_.size()), options_.threads, [&](int v) {
    places_[v] = PlacesOf(v);
    carried_[v] = Carried(v);
  });
}

std::vector<int> HypothesisSupport::PlacesOf(int v) const {
  const std::vector<AspectHypothesis>& list = hypotheses_[v];
  std::vector<Eigen::Vector2d> centers;
  std::vector<double> sizes;
  for (const AspectHypothesis& h : list) {
    centers.push_back(
        Project(h.camera, h.camera_from_object * MeshOf(h.object).center.cast<double>()));
    sizes.push_back(SizePx(in_.models[h.object], h.camera, h.camera_from_object));
  }
  std::vector<int> out;
  for (std::size_t i = 0; i < list.size(); ++i) {
    int place = static_cast<int>(i);
    for (int k = 0; k < place; ++k) {
      if ((centers[i] - centers[k]).norm() < kSamePlace * std::min(sizes[i], sizes[k])) place = k;
    }
    out.push_back(place);
  }
  return out;
}

std::vector<HypothesisSupport::CarriedEdges> HypothesisSupport::Carried(int v) const {
  std::vector<CarriedEdges> out;
  for (std::size_t k = 0; k < hypotheses_[v].size() && out.size() < kCarriedHypotheses; ++k) {
    const int place = places_[v][k];
    const auto there = std::count_if(
        out.begin(), out.end(), [&](const CarriedEdges& c) { return c.place == place; });
    if (static_cast<std::size_t>(there) >= kCarriedOfPlace) continue;
    const AspectHypothesis& h = hypotheses_[v][k];
    out.push_back(
        {static_cast<int>(k), place, EdgePoints(h.object, h.camera, h.camera_from_object)});
  }
  return out;
}

void HypothesisSupport::Add(int view, std::vector<AspectHypothesis> more) {
  std::vector<AspectHypothesis>& list = hypotheses_[view];
  more.insert(more.end(), list.begin(), list.end());
  std::stable_sort(
      more.begin(), more.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  weights_[view] = Weights(more, options_.min_joint);
  list = std::move(more);
  places_[view] = PlacesOf(view);
  carried_[view] = Carried(view);
}

bool HypothesisSupport::IsByChance(int view, std::size_t i) const {
  return weights_[view][i] <= kLeastWeight;
}

AspectSceneView HypothesisSupport::ViewOf(int v,
                                          const PinholeCamera& camera,
                                          const Rigid3& pose) const {
  const AspectViewPrior& prior = in_.priors[v];
  return {camera, pose, std::log(prior.camera.focal_px), prior.log_focal_sigma};
}

// Whether a placed object of hypothesis h is where the view expects it.
double HypothesisSupport::Agreement(const AspectSceneView& view,
                                    const Rigid3& expected,
                                    const AspectHypothesis& h) const {
  const AspectModel& model = in_.models[h.object];
  const Eigen::Vector3d center = model.object->mesh.center.cast<double>();
  const Eigen::Vector3d x = expected * center;
  if (x.z() <= 0) return 0.0;
  const double size = view.camera.focal_px * model.object->mesh.diameter_m / x.z();
  const double reach = kCarriedOffShare * size;
  const Eigen::Vector2d there = Project(h.camera, h.camera_from_object * center);
  if ((Project(view.camera, x) - there).norm() > reach) return 0.0;
  const auto agreement = [&](const Rigid3& pose) {
    const double off = PoseDistancePx(model, view.camera, expected, h.camera, pose);
    return off < reach ? 1.0 - 0.5 * off / reach : 0.0;
  };
  double best = agreement(h.camera_from_object);
  for (const SymmetryAxis& axis : model.round) {
    const Rigid3 turned = h.camera_from_object * TurnTowards(axis, h.camera_from_object, expected);
    best = std::max(best, kTurnedAgrees * agreement(turned));
  }
  return best;
}

std::pair<int, double> HypothesisSupport::BestAgreeing(int v,
                                                       const AspectSceneView& view,
                                                       int object,
                                                       const Rigid3& expected) const {
  std::pair<int, double> best{-1, 0.0};
  for (std::size_t i = 0; i < hypotheses_[v].size(); ++i) {
    const AspectHypothesis& h = hypotheses_[v][i];
    if (h.object != object) continue;
    const double value = weights_[v][i] * Agreement(view, expected, h);
    if (value > best.second) best = {static_cast<int>(i), value};
  }
  return best;
}

double HypothesisSupport::CarriedSupport(const AspectSceneView& view_from,
                                         const AspectSceneView& view_to,
                                         int from,
                                         int to,
                                         const std::vector<int>& known) const {
  const auto is_known = [&](const CarriedEdges& c) {
    return std::any_of(known.begin(), known.end(), [&](int k) {
      return k >= 0 && (k == c.hypothesis || places_[from][k] == c.place);
    });
  };
  const Rigid3 to_from_from = view_to.camera_from_scene * view_from.camera_from_scene.Inverse();
  std::vector<std::pair<int, double>> found;  // of a place
  for (const CarriedEdges& c : carried_[from]) {
    const double weight = weights_[from][c.hypothesis];
    if (weight <= kLeastWeight || is_known(c)) continue;
    const AspectHypothesis& h = hypotheses_[from][c.hypothesis];
    const Rigid3 pose =
        to_from_from *
        WithFocal(h.camera_from_object, h.camera.focal_px, view_from.camera.focal_px);
    const double value = weight * Found(to, h.object, c.points, view_to.camera, pose);
    const auto same =
        std::find_if(found.begin(), found.end(), [&](const auto& f) { return f.first == c.place; });
    if (same == found.end()) {
      found.emplace_back(c.place, value);
    } else {
      same->second = std::max(same->second, value);
    }
  }
  double sum = 0.0;
  for (const auto& [place, value] : found) sum += value;
  return sum;
}

double HypothesisSupport::Found(int v,
                                int object,
                                const std::vector<ModelEdgePoint>& points,
                                const PinholeCamera& camera,
                                const Rigid3& pose) const {
  const RenderMesh& mesh = MeshOf(object);
  const double depth = (pose * mesh.center.cast<double>()).z();
  if (depth < kNearM) return 0.0;
  const double size = camera.focal_px * mesh.diameter_m / depth * in_.images[v].working_from_image;
  const double reach = std::clamp(kCarriedReach * size, kCarriedReachPx[0], kCarriedReachPx[1]);
  const double found = PointSupport(in_.images[v], points, camera, pose, kFreeChance, reach);
  return std::max(0.0, found - kCarriedChance) / (1.0 - kCarriedChance);
}

std::vector<ModelEdgePoint> HypothesisSupport::EdgePoints(int object,
                                                          const PinholeCamera& camera,
                                                          const Rigid3& camera_from_object) const {
  PoseEdgeOptions edges;
  edges.max_points = kCarriedPoints;
  edges.render_px = kQuickRenderPx;
  return RenderedEdgePoints(MeshOf(object), camera, camera_from_object, edges);
}

}  // namespace horopter
