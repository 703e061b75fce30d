#include "server/vision/recognition/aspects/aspect_linking.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspects/aspect_score.h"
#include "server/vision/recognition/aspects/standing_search.h"

namespace horopter {
namespace {

constexpr double kChanceScore = 0.4;     // what a wrong pose reaches in one image
constexpr double kFineRenderPx = 200.0;  // of the scores that are answered
constexpr double kLeastWeight = 0.003;   // of a hypothesis that is no better than chance
constexpr double kLeastChance = 0.25;    // of a wrong pose's score in an image
constexpr double kMostChance = 0.5;
constexpr std::size_t kLongList = 12;  // hypotheses of which a fifth may be right
constexpr double kShownScore = 0.35;   // of the best object in a view whose camera is right
constexpr int kSeedObjects = 8;
constexpr int kCompleted = 3;            // drafts, of those that explain ...
constexpr double kNearlyBest = 0.6;      // ... this share of what the best does
constexpr int kRescues = 2;              // rounds in which doubtful views are looked at again
constexpr double kDoubtfulShare = 0.5;   // of what the middle view shows: looked at again
constexpr double kPoorShare = 0.4;       // ... and left out when that did not help
constexpr double kBetterScore = 0.06;    // of another pose of an object in one view
constexpr double kOtherPoseShare = 0.1;  // of the size: poses farther apart are others
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
constexpr int kCoarsePoints = 120;
constexpr int kDraftCarried = 8;               // hypotheses carried over before all views are there
constexpr std::size_t kCarriedHypotheses = 8;  // of a view, by their edges in the other one
constexpr int kCarriedPoints = 48;
constexpr double kCarriedChance = 0.35;  // support of edges in a wrong place
constexpr double kTurnedScore = 0.01;    // by which another turn must be better
constexpr double kOverlapShare = 0.35;   // of the smaller size: centres nearer in all views overlap
constexpr std::size_t kFewObjects = 2;   // a scene with more is sure of its views by agreement
constexpr int kSwept = 2;                // parts that are looked for at all places of a view
constexpr float kSweptSize[] = {0.7f, 1.45f};  // of their sizes in other views
constexpr int kVirtualSteps = 12;
constexpr double kVirtualSigmaPx = 6.0;

// A placed object and the hypotheses of views that say so.
struct GrownObject {
  AspectSceneObject placed;
  std::vector<int> hypothesis;  // of each view, -1: none
};

struct GrownScene {
  std::vector<std::optional<AspectSceneView>> views;
  std::vector<GrownObject> objects;
  double support = 0.0;
};

class Linker {
 public:
  Linker(const AspectLinkInput& input, const AspectLinkOptions& options, const StopRequested& stop)
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
  }

  LinkedScene Run() {
    RenderBest();
    LinkedScene best;
    for (const Draft& draft : Drafts(Seeds())) {
      if (IsStopRequested(stop_) && !best.objects.empty()) break;
      LinkedScene scene = Completed(draft.scene);
      if (scene.score > best.score) best = std::move(scene);
    }
    if (best.views.empty()) best.views.resize(in_.images.size());
    searched_again_.assign(best.views.size(), false);
    if (!best.objects.empty() && best.objects.size() <= kFewObjects && best.registered() > 1)
      SearchAgain(best, std::vector<bool>(best.views.size(), true));
    Rescue(&best);
    if (AddStanding(&best)) {
      // What was added may settle views that the others left in doubt.
      searched_again_.assign(best.views.size(), false);
      Rescue(&best);
    }
    if (!best.objects.empty()) DropPoorViews(&best);
    if (LinkedScene turned = best; ChooseTurns(&turned)) {
      turned = Finish(SceneOf(turned));
      if (turned.score > best.score) best = std::move(turned);
    }
    if (!best.objects.empty()) FindRunnersUp(&best);
    return best;
  }

 private:
  const AspectPart& PartOf(const AspectHypothesis& h) const { return in_.parts[h.object]; }

  // What hypotheses score above what chance gives wrong poses in their image: most of a long list
  // is wrong.
  static std::vector<double> Weights(const std::vector<AspectHypothesis>& kept) {
    double chance = kLeastChance;
    if (kept.size() >= kLongList)
      chance = std::clamp(kept[kept.size() / 5].score, kLeastChance, kMostChance);
    std::vector<double> weights;
    for (const AspectHypothesis& h : kept)
      weights.push_back(std::max(kLeastWeight, h.score - chance));
    return weights;
  }

  // Of a part seen in two views: as good as in the worse one, both count.
  static double Support(double a, double b) { return 2.0 * std::sqrt(a * b); }

  // The identity, the symmetries of a part and what is nearly one, at most max_symmetries of each,
  // spread over all of them: those of a surface of revolution are listed turn by turn.
  std::vector<Rigid3> Turns(int object) const {
    std::vector<Rigid3> turns = {Rigid3{}};
    AppendSpread(in_.parts[object].symmetries, &turns);
    AppendSpread(in_.parts[object].near_turns, &turns);
    return turns;
  }

  void AppendSpread(std::span<const Rigid3> all, std::vector<Rigid3>* turns) const {
    const std::size_t most = static_cast<std::size_t>(std::max(1, options_.max_symmetries));
    const std::size_t count = std::min(all.size(), most);
    for (std::size_t i = 0; i < count; ++i) turns->push_back(all[i * all.size() / count]);
  }

  // Turns of a round part in steps of three degrees, both ways up when that looks the same.
  static std::vector<Rigid3> FineTurns(const AspectPart& part) {
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

  // The turns by which hypotheses of one part may link two views: of a round part those that the
  // edges of other parts bear out, `support` says how well.
  template <typename SupportOfTurn>
  std::vector<Rigid3> LinkTurns(int object, const SupportOfTurn& support) const {
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

  AspectSceneView ViewOf(int v, const PinholeCamera& camera, const Rigid3& pose) const {
    const AspectViewPrior& prior = in_.priors[v];
    return {camera, pose, std::log(prior.camera.focal_px), prior.log_focal_sigma};
  }

  // Whether a placed object of hypothesis h is where the view expects it.
  double Agreement(const AspectSceneView& view,
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

  // The hypothesis of view v that agrees best with an object placed at `expected` (camera frame).
  std::pair<int, double> BestAgreeing(int v,
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

  // Two views linked by one hypothesis of each, and the other parts that agree.
  GrownScene LinkPair(int a, int b, int i, int j, const Rigid3& turn) const {
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

  // What the edges of view `from`'s best hypotheses find where a link of two views shows them in
  // view `to`: settles which of a symmetric part's turns links them. `known` needs no telling.
  double CarriedSupport(const AspectSceneView& view_from,
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

  // Support of a part's edge points above what a wrong place gives, 0 .. 1; its pose is not exact.
  double Found(int v,
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

  static std::vector<int> HypothesesOf(const GrownScene& scene, int v) {
    std::vector<int> out;
    for (const GrownObject& o : scene.objects) out.push_back(o.hypothesis[v]);
    return out;
  }

  // Edge points of the best hypotheses of each view.
  void RenderBest() {
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

  // Of an object that is nearly symmetric the turn which the images of all views bear out best.
  // Returns whether any was turned.
  bool ChooseTurns(LinkedScene* scene) const {
    bool turned = false;
    for (LinkedObject& o : scene->objects) {
      std::vector<Rigid3> turns;
      AppendSpread(in_.parts[o.object].near_turns, &turns);
      if (turns.empty()) continue;
      turns.insert(turns.begin(), Rigid3{});
      std::vector<double> scores(turns.size());
      ParallelFor(static_cast<int>(turns.size()), options_.threads, [&](int t) {
        scores[t] = JudgeOne(scene->views, {o.object, o.scene_from_object * turns[t]}).score;
      });
      const auto best = std::max_element(scores.begin(), scores.end());
      if (*best < scores.front() + kTurnedScore) continue;
      o.scene_from_object = o.scene_from_object * turns[best - scores.begin()];
      turned = true;
    }
    return turned;
  }

  bool IsApart(const Eigen::Vector3d& center,
               double diameter,
               const std::vector<Eigen::Vector3d>& places,
               const std::vector<double>& sizes) const {
    for (std::size_t p = 0; p < places.size(); ++p) {
      if ((center - places[p]).norm() < options_.apart_share * std::min(diameter, sizes[p]))
        return false;
    }
    return true;
  }

  // Links of pairs of views, best first, of each pair only a few.
  std::vector<GrownScene> Seeds() const {
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

  std::vector<GrownScene> PairSeeds(int a, int b) const {
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

  // Whether two links of views say nearly the same: where b's camera stands and looks from a's.
  bool IsSameLink(const GrownScene& s, const GrownScene& other, int a, int b) const {
    const auto relative = [&](const GrownScene& scene) {
      return scene.views[b]->camera_from_scene * scene.views[a]->camera_from_scene.Inverse();
    };
    const Rigid3 first = relative(s), second = relative(other);
    const double cosine = 0.5 * ((first.R * second.R.transpose()).trace() - 1.0);
    return cosine > std::cos(kSameLinkRad) &&
           (first.t - second.t).norm() < kSameLinkShare * std::max(first.t.norm(), second.t.norm());
  }

  std::vector<GrownScene> SingleViewSeeds() const {
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

  static void KeepBest(std::size_t count, std::vector<GrownScene>* scenes) {
    std::stable_sort(scenes->begin(), scenes->end(), [](const GrownScene& a, const GrownScene& b) {
      return a.support > b.support;
    });
    if (scenes->size() > count) scenes->resize(count);
  }

  // Adds the view that the placed objects explain best, by the camera under which most of them are
  // where its hypotheses or its edges say. Returns it, -1: none of `wanted`.
  int Grow(const std::vector<bool>& wanted, GrownScene* scene) const {
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

  std::pair<double, AspectSceneView> BestView(
      const GrownScene& scene,
      const std::vector<std::vector<ModelEdgePoint>>& points,
      int v) const {
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

  // What a view under this camera says of the scene's objects: by its hypotheses, or else by its
  // edges. Of all but `linking`.
  double SupportOfView(const GrownScene& scene,
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

  // What the edges of the registered view nearest in number bear out of the view's own hypotheses.
  double SupportInOthers(const GrownScene& scene,
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

  // Visible edges of the scene's objects, each as the first view that is registered sees it.
  std::vector<std::vector<ModelEdgePoint>> PointsOf(const GrownScene& scene) const {
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

  // Cameras and poses that agree best with what the views say of the objects: their hypotheses as
  // points, each part's symmetry chosen by what is nearest.
  void AdjustToHypotheses(const GrownScene& grown, AspectScene* scene) const {
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
            off += (Project(h.camera, pose * c) - Project(grown.views[v]->camera, expected * c))
                       .norm();
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

  // A seed's scene before other hypotheses are carried over, and what it explains.
  struct Draft {
    AspectScene scene;
    double score = 0.0;
  };

  // The best links adjusted first to what their views say, then to the images, with what both views
  // show of other objects; those that explain nearly as much as the best, best first.
  std::vector<Draft> Drafts(const std::vector<GrownScene>& seeds) const {
    std::vector<Draft> drafts;
    for (const GrownScene& seed : seeds) {
      if (static_cast<int>(drafts.size()) >= options_.adjusted_seeds || IsStopRequested(stop_))
        break;
      Draft draft;
      draft.scene.views = seed.views;
      for (const GrownObject& o : seed.objects) draft.scene.objects.push_back(o.placed);
      AdjustToHypotheses(seed, &draft.scene);
      AdjustCoarsely(&draft.scene);
      if (Sift(&draft.scene) > 0.0) CarryOver(kDraftCarried, &draft.scene);
      draft.score = Sift(&draft.scene);
      drafts.push_back(std::move(draft));
    }
    std::stable_sort(drafts.begin(), drafts.end(), [](const Draft& a, const Draft& b) {
      return a.score > b.score;
    });
    while (static_cast<int>(drafts.size()) > kCompleted ||
           (!drafts.empty() && drafts.back().score < kNearlyBest * drafts.front().score)) {
      drafts.pop_back();
    }
    return drafts;
  }

  void AdjustCoarsely(AspectScene* scene) const {
    AspectAdjustmentOptions coarse = options_.adjustment;
    coarse.render_px = options_.quick_render_px;
    coarse.search_px = {8.0, 5.0, 3.0};
    coarse.max_points = kCoarsePoints;
    AdjustToEdges(in_.images, meshes_, coarse, options_.threads, scene);
  }

  // A draft with the other views added one by one, each held against the images before the next.
  LinkedScene Completed(AspectScene scene) const {
    AddViews(&scene);
    return Finish(&scene);
  }

  void AddViews(AspectScene* scene) const {
    std::vector<bool> wanted(scene->views.size(), true);
    while (!scene->objects.empty() && !IsStopRequested(stop_)) {
      GrownScene grown;
      grown.views = scene->views;
      for (const AspectSceneObject& o : scene->objects)
        grown.objects.push_back({o, std::vector<int>(scene->views.size(), -1)});
      const int v = Grow(wanted, &grown);
      if (v < 0) break;
      wanted[v] = false;
      AspectScene more;
      more.views = grown.views;
      more.objects = scene->objects;
      AdjustCoarsely(&more);
      Sift(&more);
      CarryOver(kDraftCarried, &more);
      Sift(&more);
      if (more.objects.empty() || !more.views[v]) continue;
      *scene = std::move(more);
    }
  }

  // Views that show much less of the objects than the others do: of three and more.
  std::vector<bool> PoorViews(const LinkedScene& scene, double share) const {
    std::vector<bool> poor(scene.views.size(), false);
    if (scene.registered() < 3) return poor;
    std::vector<double> shows;
    std::vector<double> of_view(scene.views.size(), 0.0);
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      if (!scene.views[v]) continue;
      for (const LinkedObject& o : scene.objects)
        of_view[v] += o.shown[v] ? std::max(0.0, o.views[v].score - kLeastChance) : 0.0;
      shows.push_back(of_view[v]);
    }
    const auto middle = shows.begin() + static_cast<std::ptrdiff_t>(shows.size() / 2);
    std::nth_element(shows.begin(), middle, shows.end());
    for (std::size_t v = 0; v < scene.views.size(); ++v)
      poor[v] = scene.views[v].has_value() && of_view[v] < share * *middle;
    return poor;
  }

  // Poor ones, and those whose own hypothesis of an object, elsewhere in pose, explains more: these
  // may hang on a wrong hypothesis.
  LinkedScene WithoutDoubtfulViews(const LinkedScene& scene) const {
    LinkedScene out = scene;
    const std::vector<bool> poor = PoorViews(scene, kDoubtfulShare);
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      if (!scene.views[v] || out.registered() < 3) continue;
      if (poor[v] || IsContradicted(scene, static_cast<int>(v))) out.views[v].reset();
    }
    return out;
  }

  // A view that stays poor has a wrong camera: better none. The rest is adjusted without it.
  void DropPoorViews(LinkedScene* scene) const {
    const std::vector<bool> poor = PoorViews(*scene, kPoorShare);
    if (std::none_of(poor.begin(), poor.end(), [](bool p) { return p; })) return;
    AspectScene rest = SceneOf(*scene);
    for (std::size_t v = 0; v < poor.size(); ++v) {
      if (poor[v]) rest.views[v].reset();
    }
    LinkedScene out = Finish(&rest);
    if (!out.objects.empty()) *scene = std::move(out);
  }

  bool IsContradicted(const LinkedScene& scene, int v) const {
    const AspectSceneView& view = *scene.views[v];
    for (const LinkedObject& o : scene.objects) {
      if (!o.shown[v]) continue;
      const Rigid3 expected = view.camera_from_scene * o.scene_from_object;
      const Eigen::Vector3d center = meshes_[o.object]->center.cast<double>();
      const double size = view.camera.focal_px * meshes_[o.object]->diameter_m /
                          std::max((expected * center).z(), kNearM);
      for (const AspectHypothesis& h : hypotheses_[v]) {
        if (h.object != o.object || h.score < o.views[v].score + kBetterScore) continue;
        const Eigen::Vector2d there = Project(h.camera, h.camera_from_object * center);
        if ((Project(view.camera, expected * center) - there).norm() > 0.5 * size) continue;
        const double off =
            PoseDistancePx(PartOf(h), view.camera, expected, h.camera, h.camera_from_object);
        if (off > kOtherPoseShare * size) return true;
      }
    }
    return false;
  }

  // Drops what the images contradict, carries the other hypotheses over, adjusts and judges, while
  // objects are added.
  LinkedScene Finish(AspectScene scene) const { return Finish(&scene); }

  static AspectScene SceneOf(const LinkedScene& linked) {
    AspectScene scene;
    scene.views = linked.views;
    for (const LinkedObject& o : linked.objects)
      scene.objects.push_back({o.object, o.scene_from_object});
    return scene;
  }

  LinkedScene Finish(AspectScene* scene) const {
    Sift(scene);
    for (int round = 0; round < 2; ++round) {
      const std::size_t before = scene->objects.size();
      if (before == 0 || IsStopRequested(stop_)) break;
      CarryOver(options_.carried, scene);
      if (round == 0 || scene->objects.size() > before)
        AdjustToEdges(in_.images, meshes_, options_.adjustment, options_.threads, scene);
      Sift(scene);
      if (scene->objects.size() <= before) break;
    }
    return Result(*scene);
  }

  // Views that show no object are no views, objects that explain too little are none. Returns what
  // the rest explains above chance.
  double Sift(AspectScene* scene) const {
    std::vector<LinkedObject> judged = Judge(*scene, options_.quick_render_px);
    bool dropped = false;
    for (std::size_t v = 0; v < scene->views.size(); ++v) {
      if (!scene->views[v]) continue;
      double best = 0.0;
      for (const LinkedObject& o : judged) {
        if (o.shown[v]) best = std::max(best, o.views[v].score);
      }
      if (best >= kShownScore) continue;
      scene->views[v].reset();
      dropped = true;
    }
    if (dropped) judged = Judge(*scene, options_.quick_render_px);
    return Keep(judged, scene);
  }

  static double AboveChance(const LinkedObject& o) {
    double sum = 0.0;
    for (std::size_t v = 0; v < o.views.size(); ++v) {
      if (o.shown[v]) sum += std::max(0.0, o.views[v].score - kChanceScore);
    }
    return sum;
  }

  SceneJudgementOptions Judging(double render_px) const {
    SceneJudgementOptions out;
    out.render_px = render_px;
    out.layer_px = options_.quick_render_px;
    out.shown_share = options_.shown_share;
    return out;
  }

  std::vector<LinkedObject> Judge(const AspectScene& scene, double render_px) const {
    SceneJudgementOptions judging = Judging(render_px);
    judging.threads = options_.threads;
    return JudgeScene(in_.images, meshes_, scene, judging);
  }

  // One object, rendered quickly.
  LinkedObject JudgeOne(const std::vector<std::optional<AspectSceneView>>& views,
                        const AspectSceneObject& placed,
                        std::span<const std::vector<PartLayer>* const> others = {}) const {
    return JudgeInViews(in_.images,
                        *meshes_[placed.object],
                        views,
                        placed,
                        Judging(options_.quick_render_px),
                        others);
  }

  // Leaves out what explains too little; the frame goes to the best. Returns what is explained.
  double Keep(const std::vector<LinkedObject>& judged, AspectScene* scene) const {
    std::vector<int> order(judged.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
      return judged[a].score > judged[b].score;
    });
    std::vector<AspectSceneObject> kept;
    double explained = 0.0;
    for (const int i : order) {
      if (judged[i].score < options_.min_joint) break;
      if (!IsFree(scene->views, kept, scene->objects[i])) continue;
      kept.push_back(scene->objects[i]);
      explained += AboveChance(judged[i]);
    }
    scene->objects = std::move(kept);
    return explained;
  }

  Eigen::Vector3d CenterOf(const AspectSceneObject& o) const {
    return o.scene_from_object * meshes_[o.object]->center.cast<double>();
  }

  // Whether no object of the scene is in this one's place: not in space, and not in the images of
  // all views, where wrong cameras may show one object as two.
  bool IsFree(const std::vector<std::optional<AspectSceneView>>& views,
              const std::vector<AspectSceneObject>& taken,
              const AspectSceneObject& o) const {
    const double diameter = meshes_[o.object]->diameter_m;
    return std::none_of(taken.begin(), taken.end(), [&](const AspectSceneObject& other) {
      const double smaller = std::min(diameter, meshes_[other.object]->diameter_m);
      const Eigen::Vector3d here = CenterOf(o), there = CenterOf(other);
      if ((here - there).norm() < options_.apart_share * smaller) return true;
      int seen = 0;
      for (const auto& view : views) {
        if (!view) continue;
        const Eigen::Vector3d a = view->camera_from_scene * here,
                              b = view->camera_from_scene * there;
        if (a.z() < kNearM || b.z() < kNearM) return false;
        const double size = view->camera.focal_px * smaller / std::max(a.z(), b.z());
        if ((Project(view->camera, a) - Project(view->camera, b)).norm() > kOverlapShare * size) {
          return false;
        }
        ++seen;
      }
      return seen > 1;
    });
  }

  // Hypotheses of all views in the scene's cameras, those that most views confirm.
  void CarryOver(int most, AspectScene* scene) const {
    std::vector<std::pair<double, AspectSceneObject>> carried;
    for (std::size_t v = 0; v < scene->views.size(); ++v) {
      if (!scene->views[v]) continue;
      const Rigid3 scene_from_camera = scene->views[v]->camera_from_scene.Inverse();
      for (const AspectHypothesis& h : hypotheses_[v]) {
        carried.emplace_back(
            h.score,
            AspectSceneObject{h.object,
                              scene_from_camera * WithFocal(h.camera_from_object,
                                                            h.camera.focal_px,
                                                            scene->views[v]->camera.focal_px)});
      }
    }
    std::stable_sort(carried.begin(), carried.end(), [](const auto& a, const auto& b) {
      return a.first > b.first;
    });
    std::erase_if(carried, [&](const std::pair<double, AspectSceneObject>& c) {
      return !IsFree(scene->views, scene->objects, c.second);
    });
    if (static_cast<int>(carried.size()) > most) carried.resize(most);
    std::vector<AspectSceneObject> candidates;
    for (auto& [score, object] : carried) candidates.push_back(object);
    Place(std::move(candidates), scene);
  }

  // Candidates adjusted alone and added where the images bear them out and nothing else is.
  void Place(std::vector<AspectSceneObject> candidates, AspectScene* scene) const {
    std::vector<LinkedObject> there(scene->objects.size());
    ParallelFor(static_cast<int>(there.size()), options_.threads, [&](int i) {
      there[i] = JudgeOne(scene->views, scene->objects[i]);
    });
    SceneJudgementOptions judging = Judging(options_.quick_render_px);
    judging.threads = options_.threads;
    const SceneLayers layers = MakeSceneLayers(in_.images, meshes_, *scene, there, judging);
    std::vector<const std::vector<PartLayer>*> others;
    for (const std::vector<PartLayer>& object : layers) others.push_back(&object);
    std::vector<LinkedObject> judged(candidates.size());
    ParallelFor(static_cast<int>(candidates.size()), options_.threads, [&](int i) {
      if (IsStopRequested(stop_)) return;
      // Its depth is the least certain: the other views set it.
      candidates[i] = Settled(scene->views, candidates[i]);
      judged[i] = JudgeOne(scene->views, candidates[i], others);
    });
    std::vector<int> order(judged.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
      return judged[a].score > judged[b].score;
    });
    for (const int i : order) {
      if (judged[i].score < options_.min_quick) break;
      if (IsFree(scene->views, scene->objects, candidates[i]))
        scene->objects.push_back(candidates[i]);
    }
  }

  // Parts on the plane under those found which no single image showed well enough.
  // Returns whether any was added.
  bool AddStanding(LinkedScene* best) const {
    if (options_.standing <= 0 || best->registered() < 2 || IsStopRequested(stop_)) return false;
    AspectScene scene = SceneOf(*best);
    const auto plane = PlaneUnder(scene.objects, in_.parts, scene.views);
    if (!plane) return false;
    StandingSearchOptions search;
    search.threads = options_.threads;
    std::vector<AspectSceneObject> candidates;
    for (const StandingCandidate& c :
         FindStanding(in_.images, scene.views, in_.parts, *plane, scene.objects, search, stop_)) {
      if (static_cast<int>(candidates.size()) >= options_.standing) break;
      if (IsFree(scene.views, scene.objects, c.placed)) candidates.push_back(c.placed);
    }
    const std::size_t before = scene.objects.size();
    Place(std::move(candidates), &scene);
    if (scene.objects.size() == before) return false;
    LinkedScene more = Finish(&scene);
    if (more.score <= best->score) return false;
    *best = std::move(more);
    return true;
  }

  // An object adjusted alone, cameras held.
  AspectSceneObject Settled(const std::vector<std::optional<AspectSceneView>>& views,
                            AspectSceneObject out) const {
    const RenderMesh& mesh = *meshes_[out.object];
    for (const double search : {8.0, 5.0, 3.0}) {
      PoseEdgeOptions edges;
      edges.search_px = search;
      edges.max_points = 120;
      edges.render_px = options_.quick_render_px;
      std::vector<std::vector<ModelEdgePoint>> points(views.size());
      for (std::size_t v = 0; v < views.size(); ++v) {
        if (!views[v]) continue;
        points[v] = RenderedEdgePoints(
            mesh, views[v]->camera, views[v]->camera_from_scene * out.scene_from_object, edges);
      }
      for (int step = 0; step < 3; ++step) {
        std::vector<SceneRow> rows;
        for (std::size_t v = 0; v < views.size(); ++v) {
          if (points[v].empty()) continue;
          for (const PoseEdgeMatch& m :
               MatchPoseEdges(in_.images[v],
                              points[v],
                              views[v]->camera,
                              views[v]->camera_from_scene * out.scene_from_object,
                              edges)) {
            rows.push_back({static_cast<int>(v), 0, m.point, m.matched, m.normal, m.weight});
          }
        }
        out.scene_from_object = AdjustObjectToRows(rows, views, out.scene_from_object);
      }
    }
    return out;
  }

  LinkedScene Result(const AspectScene& scene) const {
    LinkedScene out;
    out.views = scene.views;
    if (scene.objects.empty()) {
      out.views.assign(scene.views.size(), std::nullopt);
      return out;
    }
    for (LinkedObject& o : Judge(scene, kFineRenderPx)) {
      if (o.score < options_.min_joint) continue;
      out.score += AboveChance(o);
      out.objects.push_back(std::move(o));
    }
    std::stable_sort(out.objects.begin(), out.objects.end(), [](const auto& a, const auto& b) {
      return a.score > b.score;
    });
    return out;
  }

  // What the other views say of the parts, `objects` in the order of an index of them, in view v.
  std::vector<AspectExpectation> Expected(const LinkedScene& found,
                                          const std::vector<int>& objects,
                                          int v) const {
    std::vector<AspectExpectation> out;
    for (const LinkedObject& o : found.objects) {
      if (static_cast<int>(out.size()) >= kSwept) break;
      AspectExpectation e;
      e.part =
          static_cast<int>(std::find(objects.begin(), objects.end(), o.object) - objects.begin());
      if (std::any_of(out.begin(), out.end(), [&](const auto& x) { return x.part == e.part; }))
        continue;
      for (std::size_t w = 0; w < found.views.size(); ++w) {
        if (!found.views[w] || !o.shown[w] || static_cast<int>(w) == v) continue;
        const Rigid3 pose = found.views[w]->camera_from_scene * o.scene_from_object;
        const Eigen::Vector3d center = pose * meshes_[o.object]->center.cast<double>();
        const float size =
            static_cast<float>(found.views[w]->camera.focal_px * meshes_[o.object]->diameter_m /
                               center.z() * in_.images[w].working_from_image);
        // Seen along the axis of the camera, as aspects are.
        const Eigen::Matrix3d ahead =
            Eigen::Quaterniond::FromTwoVectors(center, Eigen::Vector3d::UnitZ()).toRotationMatrix();
        e.rotations.push_back((ahead * pose.R).cast<float>());
        e.min_size_px = e.rotations.size() == 1 ? size : std::min(e.min_size_px, size);
        e.max_size_px = std::max(e.max_size_px, size);
      }
      if (e.rotations.empty()) continue;
      e.min_size_px *= kSweptSize[0];
      e.max_size_px *= kSweptSize[1];
      out.push_back(std::move(e));
    }
    return out;
  }

  // Hypotheses of the scene's parts, and only of them, in the wanted views: much further down the
  // list than a search of the catalog goes. Adds to what is known of these views.
  void SearchAgain(const LinkedScene& found, const std::vector<bool>& wanted) {
    std::vector<int> objects;
    std::vector<AspectPart> parts;
    for (const LinkedObject& o : found.objects) {
      if (std::find(objects.begin(), objects.end(), o.object) != objects.end()) continue;
      objects.push_back(o.object);
      parts.push_back(in_.parts[o.object]);
    }
    const auto index = BuildFragmentIndex(parts);
    if (!index.ok()) return;
    FindAspectOptions deep;
    deep.coarse_per_part = options_.rescue_per_part;
    deep.fine_per_part = options_.rescue_per_part / 4;
    deep.fine_share = 0.5;
    deep.threads = deep.votes.threads = options_.threads;
    for (std::size_t v = 0; v < wanted.size(); ++v) {
      if (!wanted[v] || searched_again_[v] || IsStopRequested(stop_)) continue;
      searched_again_[v] = true;
      deep.expected = Expected(found, objects, static_cast<int>(v));
      std::vector<AspectHypothesis> list =
          FindAspectHypotheses(in_.images[v], *index, deep, nullptr, stop_).hypotheses;
      for (AspectHypothesis& h : list) h.object = objects[h.object];
      list.insert(list.end(), hypotheses_[v].begin(), hypotheses_[v].end());
      std::stable_sort(
          list.begin(), list.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
      weights_[v] = Weights(list);
      hypotheses_[v] = std::move(list);
    }
  }

  // Looks again at the views that have no camera or a doubtful one, while that explains more.
  void Rescue(LinkedScene* best) {
    for (int round = 0; round < kRescues && !best->objects.empty(); ++round) {
      const LinkedScene trusted = WithoutDoubtfulViews(*best);
      if (trusted.registered() == static_cast<int>(best->views.size()) || IsStopRequested(stop_))
        return;
      std::vector<bool> missing;
      for (const auto& view : trusted.views) missing.push_back(!view);
      SearchAgain(trusted, missing);
      LinkedScene more = Completed(SceneOf(trusted));
      if (more.score <= best->score) return;
      *best = std::move(more);
    }
  }

  // Whether the scene has this object in this place.
  bool IsAccepted(const LinkedScene& scene, int object, const Eigen::Vector3d& center) const {
    return std::any_of(scene.objects.begin(), scene.objects.end(), [&](const LinkedObject& o) {
      const RenderMesh& mesh = *meshes_[o.object];
      return o.object == object &&
             (o.scene_from_object * mesh.center.cast<double>() - center).norm() <
                 options_.apart_share * mesh.diameter_m;
    });
  }

  // Best score that another part's hypothesis has in the place of each object.
  void FindRunnersUp(LinkedScene* scene) const {
    for (LinkedObject& o : scene->objects) {
      const Eigen::Vector3d center = o.scene_from_object * meshes_[o.object]->center.cast<double>();
      std::vector<double> best(in_.parts.size(), 0.0);
      std::vector<AspectSceneObject> candidates(in_.parts.size());
      for (std::size_t v = 0; v < scene->views.size(); ++v) {
        if (!scene->views[v]) continue;
        const Rigid3 scene_from_camera = scene->views[v]->camera_from_scene.Inverse();
        for (const AspectHypothesis& h : hypotheses_[v]) {
          if (h.object == o.object || h.score <= best[h.object]) continue;
          const Rigid3 placed =
              scene_from_camera *
              WithFocal(h.camera_from_object, h.camera.focal_px, scene->views[v]->camera.focal_px);
          const Eigen::Vector3d there = placed * meshes_[h.object]->center.cast<double>();
          const double size =
              std::min(meshes_[h.object]->diameter_m, meshes_[o.object]->diameter_m);
          if ((there - center).norm() > size || IsAccepted(*scene, h.object, there)) continue;
          best[h.object] = h.score;
          candidates[h.object] = {h.object, placed};
        }
      }
      std::vector<int> order(best.size());
      std::iota(order.begin(), order.end(), 0);
      std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return best[a] > best[b]; });
      constexpr int kJudged = 4;
      std::array<double, kJudged> scores{};
      ParallelFor(kJudged, options_.threads, [&](int k) {
        if (k >= static_cast<int>(order.size()) || best[order[k]] <= 0.0) return;
        const AspectSceneObject settled = Settled(scene->views, candidates[order[k]]);
        scores[k] = JudgeOne(scene->views, settled).score;
      });
      const auto most = std::max_element(scores.begin(), scores.end());
      if (*most <= 0.0) continue;
      o.runner_up = *most;
      o.runner_up_object = order[most - scores.begin()];
    }
  }

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  std::vector<std::vector<double>> weights_;  // score above chance, of each hypothesis
  std::vector<const RenderMesh*> meshes_;
  // Of each view its best hypotheses' visible edges.
  std::vector<std::vector<std::vector<ModelEdgePoint>>> points_;
  std::vector<bool> searched_again_;             // of each view
  std::vector<std::vector<Rigid3>> fine_turns_;  // of each part; empty: it is not round
};

}  // namespace

int LinkedScene::registered() const {
  return static_cast<int>(
      std::count_if(views.begin(), views.end(), [](const auto& v) { return v.has_value(); }));
}

LinkedScene LinkAspects(const AspectLinkInput& input,
                        const AspectLinkOptions& options,
                        const StopRequested& stop) {
  return Linker(input, options, stop).Run();
}

}  // namespace horopter
