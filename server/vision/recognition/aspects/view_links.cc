#include "server/vision/recognition/aspects/view_links.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspects/aspect_score.h"
#include "server/vision/recognition/aspects/scene_judgement.h"

namespace horopter {
namespace {

constexpr double kLeastWeight = 0.003;  // of a hypothesis that is no better than chance
constexpr double kLeastChance = 0.25;   // of a wrong pose's score in an image
constexpr double kMostChance = 0.5;
constexpr std::size_t kLongList = 12;  // hypotheses of which a fifth may be right
constexpr int kSeedObjects = 8;
constexpr double kNearM = 1e-3;
constexpr int kFineTurns = 120;  // of a round part
constexpr int kPeaks = 3;        // of these, that are looked at closer
constexpr int kPeakWidth = 4;
constexpr double kNearPeak = 0.7;        // of the best support
constexpr std::size_t kLinkTurns = 2;    // of one pair of hypotheses
constexpr double kLeastCarried = 0.02;   // that tells turns apart
constexpr double kSameAxis = 0.01;       // between unit vectors
constexpr double kSameLinkRad = 0.07;    // relative poses of two views nearer than this are one
constexpr double kSameLinkShare = 0.12;  // ... and of their distance
constexpr double kCarriedShare = 0.2;    // of carried edges against a hypothesis's weight
constexpr double kCarriedReach = 0.06;   // of the size
constexpr double kCarriedReachPx[] = {4.0, 12.0};
constexpr double kFreeChance = 0.10;
constexpr std::size_t kCarriedHypotheses = 8;  // of a view, by their edges in the other one
constexpr int kCarriedPoints = 48;
constexpr double kCarriedChance = 0.35;  // support of edges in a wrong place
constexpr int kVirtualSteps = 12;
constexpr double kVirtualSigmaPx = 6.0;

}  // namespace

ViewLinks::ViewLinks(const AspectLinkInput& input,
                     const AspectLinkOptions& options,
                     const StopRequested& stop)
    : in_(input), options_(options), stop_(stop) {
  for (std::size_t v = 0; v < in_.images.size(); ++v) {
    std::vector<AspectHypothesis> kept;
    for (const AspectHypothesis& h : in_.hypotheses[v]) {
      if (static_cast<int>(kept.size()) >= options.hypotheses_per_view) break;
      if (h.score >= options.min_hypothesis) kept.push_back(h);
    }
    weights_.push_back(Weights(kept));
    hypotheses_.push_back(std::move(kept));
  }
  for (const AspectPart& part : in_.parts) {
    meshes_.push_back(&part.object->mesh);
    fine_turns_.push_back(FineTurns(part));
  }
  RenderBest();
}

void ViewLinks::Add(int view, std::vector<AspectHypothesis> more) {
  std::vector<AspectHypothesis>& list = hypotheses_[view];
  more.insert(more.end(), list.begin(), list.end());
  std::stable_sort(
      more.begin(), more.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  weights_[view] = Weights(more);
  list = std::move(more);
}

std::vector<double> ViewLinks::Weights(const std::vector<AspectHypothesis>& kept) {
  double chance = kLeastChance;
  if (kept.size() >= kLongList)
    chance = std::clamp(kept[kept.size() / 5].score, kLeastChance, kMostChance);
  std::vector<double> weights;
  for (const AspectHypothesis& h : kept)
    weights.push_back(std::max(kLeastWeight, h.score - chance));
  return weights;
}

double ViewLinks::Support(double a, double b) {
  return 2.0 * std::sqrt(a * b);
}

std::vector<Rigid3> ViewLinks::Turns(int object) const {
  std::vector<Rigid3> turns = {Rigid3{}};
  AppendSpread(in_.parts[object].symmetries, &turns);
  AppendSpread(in_.parts[object].near_turns, &turns);
  return turns;
}

void ViewLinks::AppendSpread(std::span<const Rigid3> all, std::vector<Rigid3>* turns) const {
  const std::size_t most = static_cast<std::size_t>(std::max(1, options_.max_symmetries));
  const std::size_t count = std::min(all.size(), most);
  for (std::size_t i = 0; i < count; ++i) turns->push_back(all[i * all.size() / count]);
}

std::vector<Rigid3> ViewLinks::FineTurns(const AspectPart& part) {
  std::vector<Rigid3> out;
  for (const SymmetryAxis& axis : part.round) {
    std::vector<Rigid3> sides = {Rigid3{}};
    for (const Rigid3& s : part.symmetries) {
      if ((s.R * axis.axis + axis.axis).norm() > kSameAxis) continue;
      sides.push_back(s);
      break;
    }
    for (const Rigid3& side : sides) {
      for (int k = 0; k < kFineTurns; ++k)
        out.push_back(TurnAbout(axis, 2 * std::numbers::pi * k / kFineTurns) * side);
    }
  }
  return out;
}

template <typename SupportOfTurn>
std::vector<Rigid3> ViewLinks::LinkTurns(int object, const SupportOfTurn& support) const {
  const std::vector<Rigid3>& fine = fine_turns_[object];
  if (fine.empty()) return Turns(object);
  // Every other turn, then those beside the good ones.
  std::vector<double> supports(fine.size(), -1.0);
  double best = 0.0;
  for (std::size_t t = 0; t < fine.size(); t += 2) {
    supports[t] = support(fine[t]);
    best = std::max(best, supports[t]);
  }
  for (std::size_t t = 1; t < fine.size(); t += 2) {
    const std::size_t next = (t + 1) % kFineTurns == 0 ? t + 1 - kFineTurns : t + 1;
    if (std::max(supports[t - 1], supports[next]) > kNearPeak * best)
      supports[t] = support(fine[t]);
  }
  std::vector<int> order(fine.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(
      order.begin(), order.end(), [&](int a, int b) { return supports[a] > supports[b]; });
  if (supports[order.front()] < kLeastCarried) return Turns(object);
  std::vector<int> kept;
  for (const int t : order) {
    if (static_cast<int>(kept.size()) >= kPeaks) break;
    const bool beside = std::any_of(kept.begin(), kept.end(), [&](int k) {
      const int apart = std::abs(t - k) % kFineTurns;
      return t / kFineTurns == k / kFineTurns && std::min(apart, kFineTurns - apart) < kPeakWidth;
    });
    if (!beside) kept.push_back(t);
  }
  std::vector<Rigid3> out;
  for (const int t : kept) out.push_back(fine[t]);
  return out;
}

AspectSceneView ViewLinks::ViewOf(int v, const PinholeCamera& camera, const Rigid3& pose) const {
  const AspectViewPrior& prior = in_.priors[v];
  return {camera, pose, std::log(prior.camera.focal_px), prior.log_focal_sigma};
}

double ViewLinks::Agreement(const AspectSceneView& view,
                            const Rigid3& expected,
                            const AspectHypothesis& h) const {
  const AspectPart& part = PartOf(h);
  const Eigen::Vector3d center = part.object->mesh.center.cast<double>();
  const Eigen::Vector3d x = expected * center;
  if (x.z() <= 0) return 0.0;
  const double size = view.camera.focal_px * part.object->mesh.diameter_m / x.z();
  const double reach = options_.same_pose_share * size;
  const Eigen::Vector2d there = Project(h.camera, h.camera_from_object * center);
  if ((Project(view.camera, x) - there).norm() > reach) return 0.0;
  const double off = PoseDistancePx(part, view.camera, expected, h.camera, h.camera_from_object);
  return off < reach ? 1.0 - 0.5 * off / reach : 0.0;
}

std::pair<int, double> ViewLinks::BestAgreeing(int v,
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

GrownScene ViewLinks::LinkPair(int a, int b, int i, int j, const Rigid3& turn) const {
  const AspectHypothesis &h = hypotheses_[a][i], &g = hypotheses_[b][j];
  GrownScene out;
  out.views.resize(in_.images.size());
  out.views[a] = ViewOf(a, h.camera, h.camera_from_object);
  out.views[b] = ViewOf(b, g.camera, g.camera_from_object * turn);
  GrownObject first;
  first.placed = {h.object, Rigid3{}};
  first.hypothesis.assign(in_.images.size(), -1);
  first.hypothesis[a] = i;
  first.hypothesis[b] = j;
  out.objects.push_back(first);
  out.support = Support(weights_[a][i], weights_[b][j]);
  const Rigid3 scene_from_a = out.views[a]->camera_from_scene.Inverse();
  std::vector<Eigen::Vector3d> places = {meshes_[h.object]->center.cast<double>()};
  std::vector<double> sizes = {meshes_[h.object]->diameter_m};
  for (std::size_t k = 0; k < hypotheses_[a].size(); ++k) {
    const AspectHypothesis& other = hypotheses_[a][k];
    if (static_cast<int>(k) == i || weights_[a][k] <= kLeastWeight) continue;
    if (out.objects.size() >= kSeedObjects) break;
    const Rigid3 placed =
        scene_from_a *
        WithFocal(other.camera_from_object, other.camera.focal_px, h.camera.focal_px);
    const Eigen::Vector3d center = placed * meshes_[other.object]->center.cast<double>();
    if (!IsApart(center, meshes_[other.object]->diameter_m, places, sizes)) continue;
    const auto [match, value] =
        BestAgreeing(b, *out.views[b], other.object, out.views[b]->camera_from_scene * placed);
    if (match < 0) continue;
    GrownObject object;
    object.placed = {other.object, placed};
    object.hypothesis.assign(in_.images.size(), -1);
    object.hypothesis[a] = static_cast<int>(k);
    object.hypothesis[b] = match;
    out.objects.push_back(std::move(object));
    out.support += Support(weights_[a][k], value);
    places.push_back(center);
    sizes.push_back(meshes_[other.object]->diameter_m);
  }
  return out;
}

double ViewLinks::CarriedSupport(const AspectSceneView& view_from,
                                 const AspectSceneView& view_to,
                                 int from,
                                 int to,
                                 const std::vector<int>& known) const {
  double sum = 0.0;
  const Rigid3 to_from_from = view_to.camera_from_scene * view_from.camera_from_scene.Inverse();
  for (std::size_t k = 0; k < points_[from].size(); ++k) {
    const AspectHypothesis& h = hypotheses_[from][k];
    if (weights_[from][k] <= kLeastWeight ||
        std::find(known.begin(), known.end(), static_cast<int>(k)) != known.end()) {
      continue;
    }
    const Rigid3 pose =
        to_from_from *
        WithFocal(h.camera_from_object, h.camera.focal_px, view_from.camera.focal_px);
    sum += weights_[from][k] * Found(to, h.object, points_[from][k], view_to.camera, pose);
  }
  return sum;
}

double ViewLinks::Found(int v,
                        int object,
                        const std::vector<ModelEdgePoint>& points,
                        const PinholeCamera& camera,
                        const Rigid3& pose) const {
  const double depth = (pose * meshes_[object]->center.cast<double>()).z();
  if (depth < kNearM) return 0.0;
  const double size =
      camera.focal_px * meshes_[object]->diameter_m / depth * in_.images[v].working_from_image;
  const double reach = std::clamp(kCarriedReach * size, kCarriedReachPx[0], kCarriedReachPx[1]);
  const double found = PointSupport(in_.images[v], points, camera, pose, kFreeChance, reach);
  return std::max(0.0, found - kCarriedChance) / (1.0 - kCarriedChance);
}

std::vector<int> ViewLinks::HypothesesOf(const GrownScene& scene, int v) {
  std::vector<int> out;
  for (const GrownObject& o : scene.objects) out.push_back(o.hypothesis[v]);
  return out;
}

void ViewLinks::RenderBest() {
  points_.assign(in_.images.size(), {});
  PoseEdgeOptions edges;
  edges.max_points = kCarriedPoints;
  edges.render_px = options_.quick_render_px;
  ParallelFor(static_cast<int>(points_.size()), options_.threads, [&](int v) {
    for (std::size_t k = 0; k < hypotheses_[v].size() && k < kCarriedHypotheses; ++k) {
      const AspectHypothesis& h = hypotheses_[v][k];
      points_[v].push_back(
          RenderedEdgePoints(*meshes_[h.object], h.camera, h.camera_from_object, edges));
    }
  });
}

bool ViewLinks::IsApart(const Eigen::Vector3d& center,
                        double diameter,
                        const std::vector<Eigen::Vector3d>& places,
                        const std::vector<double>& sizes) const {
  for (std::size_t p = 0; p < places.size(); ++p) {
    if ((center - places[p]).norm() < options_.apart_share * std::min(diameter, sizes[p]))
      return false;
  }
  return true;
}

std::vector<GrownScene> ViewLinks::Seeds() const {
  const int views = static_cast<int>(in_.images.size());
  if (views == 1) return SingleViewSeeds();
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) pairs.emplace_back(a, b);
  }
  std::vector<std::vector<GrownScene>> of_pair(pairs.size());
  ParallelFor(static_cast<int>(pairs.size()), options_.threads, [&](int p) {
    of_pair[p] = PairSeeds(pairs[p].first, pairs[p].second);
  });
  std::vector<GrownScene> all;
  for (auto& found : of_pair) {
    for (GrownScene& s : found) all.push_back(std::move(s));
  }
  KeepBest(all.size(), &all);
  return all;
}

std::vector<GrownScene> ViewLinks::PairSeeds(int a, int b) const {
  std::vector<GrownScene> found;
  for (std::size_t i = 0; i < hypotheses_[a].size(); ++i) {
    if (IsStopRequested(stop_)) return found;
    for (std::size_t j = 0; j < hypotheses_[b].size(); ++j) {
      const AspectHypothesis &h = hypotheses_[a][i], &g = hypotheses_[b][j];
      if (h.object != g.object || std::max(weights_[a][i], weights_[b][j]) <= kLeastWeight) {
        continue;
      }
      const std::vector<int> here = {static_cast<int>(i)}, there = {static_cast<int>(j)};
      const auto support = [&](const Rigid3& turn) {
        const AspectSceneView from = ViewOf(a, h.camera, h.camera_from_object);
        const AspectSceneView to = ViewOf(b, g.camera, g.camera_from_object * turn);
        return CarriedSupport(from, to, a, b, here) + CarriedSupport(to, from, b, a, there);
      };
      // Of one link the best turns.
      std::vector<GrownScene> turned;
      for (const Rigid3& turn : LinkTurns(h.object, support))
        turned.push_back(LinkPair(a, b, here.front(), there.front(), turn));
      KeepBest(kLinkTurns, &turned);
      for (GrownScene& s : turned) found.push_back(std::move(s));
    }
  }
  KeepBest(static_cast<std::size_t>(options_.pair_seeds), &found);
  for (GrownScene& s : found) {
    s.support += CarriedSupport(*s.views[a], *s.views[b], a, b, HypothesesOf(s, a)) +
                 CarriedSupport(*s.views[b], *s.views[a], b, a, HypothesesOf(s, b));
  }
  KeepBest(found.size(), &found);
  std::vector<GrownScene> apart;
  for (GrownScene& s : found) {
    if (static_cast<int>(apart.size()) >= options_.links_per_pair) break;
    const bool known = std::any_of(apart.begin(), apart.end(), [&](const GrownScene& other) {
      return IsSameLink(s, other, a, b);
    });
    if (!known) apart.push_back(std::move(s));
  }
  return apart;
}

bool ViewLinks::IsSameLink(const GrownScene& s, const GrownScene& other, int a, int b) const {
  const auto relative = [&](const GrownScene& scene) {
    return scene.views[b]->camera_from_scene * scene.views[a]->camera_from_scene.Inverse();
  };
  const Rigid3 first = relative(s), second = relative(other);
  const double cosine = 0.5 * ((first.R * second.R.transpose()).trace() - 1.0);
  return cosine > std::cos(kSameLinkRad) &&
         (first.t - second.t).norm() < kSameLinkShare * std::max(first.t.norm(), second.t.norm());
}

std::vector<GrownScene> ViewLinks::SingleViewSeeds() const {
  std::vector<GrownScene> out;
  for (std::size_t i = 0; i < hypotheses_[0].size() && i < 4; ++i) {
    const AspectHypothesis& h = hypotheses_[0][i];
    GrownScene scene;
    scene.views.push_back(ViewOf(0, h.camera, h.camera_from_object));
    scene.objects.push_back({{h.object, Rigid3{}}, {static_cast<int>(i)}});
    scene.support = h.score;
    out.push_back(std::move(scene));
  }
  return out;
}

void ViewLinks::KeepBest(std::size_t count, std::vector<GrownScene>* scenes) {
  std::stable_sort(scenes->begin(), scenes->end(), [](const GrownScene& a, const GrownScene& b) {
    return a.support > b.support;
  });
  if (scenes->size() > count) scenes->resize(count);
}

int ViewLinks::Grow(const std::vector<bool>& wanted, GrownScene* scene) const {
  const std::vector<std::vector<ModelEdgePoint>> points = PointsOf(*scene);
  const int count = static_cast<int>(scene->views.size());
  std::vector<std::pair<double, AspectSceneView>> best(count);
  ParallelFor(count, options_.threads, [&](int v) {
    if (!scene->views[v] && wanted[v]) best[v] = BestView(*scene, points, v);
  });
  const auto most = std::max_element(
      best.begin(), best.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  if (most->first <= 0.0) return -1;
  const int v = static_cast<int>(most - best.begin());
  scene->views[v] = most->second;
  scene->support += most->first;
  for (GrownObject& o : scene->objects) {
    const Rigid3 expected = most->second.camera_from_scene * o.placed.scene_from_object;
    o.hypothesis[v] = BestAgreeing(v, most->second, o.placed.object, expected).first;
  }
  return v;
}

std::pair<double, AspectSceneView> ViewLinks::BestView(
    const GrownScene& scene, const std::vector<std::vector<ModelEdgePoint>>& points, int v) const {
  std::pair<double, AspectSceneView> best{0.0, {}};
  for (const GrownObject& o : scene.objects) {
    for (const AspectHypothesis& h : hypotheses_[v]) {
      if (h.object != o.placed.object) continue;
      const auto view_of = [&](const Rigid3& turn) {
        return ViewOf(
            v, h.camera, h.camera_from_object * turn * o.placed.scene_from_object.Inverse());
      };
      const auto support = [&](const Rigid3& turn) {
        return SupportOfView(scene, points, v, view_of(turn), &o) +
               SupportInOthers(scene, v, view_of(turn), h);
      };
      for (const Rigid3& turn : LinkTurns(h.object, support)) {
        const AspectSceneView view = view_of(turn);
        const double sum =
            SupportOfView(scene, points, v, view, nullptr) + SupportInOthers(scene, v, view, h);
        if (sum > best.first) best = {sum, view};
      }
    }
  }
  return best;
}

double ViewLinks::SupportOfView(const GrownScene& scene,
                                const std::vector<std::vector<ModelEdgePoint>>& points,
                                int v,
                                const AspectSceneView& view,
                                const GrownObject* linking) const {
  double sum = 0.0;
  for (std::size_t o = 0; o < scene.objects.size(); ++o) {
    if (&scene.objects[o] == linking) continue;
    const AspectSceneObject& placed = scene.objects[o].placed;
    const Rigid3 expected = view.camera_from_scene * placed.scene_from_object;
    sum += std::max(BestAgreeing(v, view, placed.object, expected).second,
                    kCarriedShare * Found(v, placed.object, points[o], view.camera, expected));
  }
  return sum;
}

double ViewLinks::SupportInOthers(const GrownScene& scene,
                                  int v,
                                  const AspectSceneView& view,
                                  const AspectHypothesis& linking) const {
  int nearest = -1;
  for (int w = 0; w < static_cast<int>(scene.views.size()); ++w) {
    if (scene.views[w] && (nearest < 0 || std::abs(w - v) < std::abs(nearest - v))) nearest = w;
  }
  std::vector<int> known;
  for (std::size_t k = 0; k < points_[v].size(); ++k) {
    const AspectHypothesis& h = hypotheses_[v][k];
    const bool placed =
        std::any_of(scene.objects.begin(), scene.objects.end(), [&](const GrownObject& o) {
          return o.placed.object == h.object;
        });
    if (&h == &linking || placed) known.push_back(static_cast<int>(k));
  }
  return CarriedSupport(view, *scene.views[nearest], v, nearest, known);
}

std::vector<std::vector<ModelEdgePoint>> ViewLinks::PointsOf(const GrownScene& scene) const {
  PoseEdgeOptions edges;
  edges.max_points = kCarriedPoints;
  edges.render_px = options_.quick_render_px;
  const auto view = std::find_if(
      scene.views.begin(), scene.views.end(), [](const auto& v) { return v.has_value(); });
  std::vector<std::vector<ModelEdgePoint>> out;
  for (const GrownObject& o : scene.objects) {
    out.push_back(RenderedEdgePoints(*meshes_[o.placed.object],
                                     (*view)->camera,
                                     (*view)->camera_from_scene * o.placed.scene_from_object,
                                     edges));
  }
  return out;
}

void ViewLinks::AdjustToHypotheses(const GrownScene& grown, AspectScene* scene) const {
  std::vector<SceneRow> rows;
  for (std::size_t o = 0; o < grown.objects.size(); ++o) {
    const int object = grown.objects[o].placed.object;
    const auto corners = BoxCorners(*meshes_[object]);
    for (std::size_t v = 0; v < grown.views.size(); ++v) {
      const int i = grown.objects[o].hypothesis[v];
      if (i < 0 || !grown.views[v]) continue;
      const AspectHypothesis& h = hypotheses_[v][i];
      const Rigid3 expected =
          grown.views[v]->camera_from_scene * grown.objects[o].placed.scene_from_object;
      Rigid3 nearest = h.camera_from_object;
      double least = 1e18;
      for (const Rigid3& turn : Turns(object)) {
        const Rigid3 pose = h.camera_from_object * turn;
        double off = 0.0;
        for (const Eigen::Vector3d& c : corners)
          off +=
              (Project(h.camera, pose * c) - Project(grown.views[v]->camera, expected * c)).norm();
        if (off < least) least = off, nearest = pose;
      }
      for (const Eigen::Vector3d& c : corners) {
        const Eigen::Vector2d target = Project(h.camera, nearest * c);
        for (const Eigen::Vector2d& axis : {Eigen::Vector2d(1, 0), Eigen::Vector2d(0, 1)})
          rows.push_back({static_cast<int>(v), static_cast<int>(o), c, target, axis, h.score});
      }
    }
  }
  AdjustToRows(rows, kVirtualSteps, kVirtualSigmaPx, scene);
}

}  // namespace horopter
