#include "server/vision/recognition/aspect_scenes/pair_links.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr int kPairStarts = 120;         // links of two views that are looked at closer
constexpr int kLinksPerPair = 4;         // different ones that are kept
constexpr int kLinkedObjects = 8;        // of a pair of views
constexpr std::size_t kLinkTurns = 2;    // of one pair of hypotheses
constexpr std::size_t kAlone = 4;        // hypotheses of an image alone
constexpr double kSameLinkRad = 0.07;    // relative poses of two views nearer than this are one
constexpr double kSameLinkShare = 0.12;  // ... and of their distance

// Of a part seen in two views: as good as in the worse one, both count.
double Support(double a, double b) {
  return 2.0 * std::sqrt(a * b);
}

void KeepBest(std::size_t count, std::vector<GrownScene>* scenes) {
  std::stable_sort(scenes->begin(), scenes->end(), [](const GrownScene& a, const GrownScene& b) {
    return a.support > b.support;
  });
  if (scenes->size() > count) scenes->resize(count);
}

std::vector<int> HypothesesOf(const GrownScene& scene, int v) {
  std::vector<int> out;
  for (const GrownObject& o : scene.objects) out.push_back(o.hypothesis[v]);
  return out;
}

// Whether two links of views say nearly the same: where b's camera stands and looks from a's.
bool IsSameLink(const GrownScene& s, const GrownScene& other, int a, int b) {
  const auto relative = [&](const GrownScene& scene) {
    return scene.views[b]->camera_from_scene * scene.views[a]->camera_from_scene.Inverse();
  };
  const Rigid3 first = relative(s), second = relative(other);
  const double cosine = 0.5 * ((first.R * second.R.transpose()).trace() - 1.0);
  return cosine > std::cos(kSameLinkRad) &&
         (first.t - second.t).norm() < kSameLinkShare * std::max(first.t.norm(), second.t.norm());
}

class PairLinks {
 public:
  PairLinks(const AspectLinkInput& input,
            const AspectLinkOptions& options,
            const HypothesisSupport& support,
            const LinkTurns& turns,
            const StopRequested& stop)
      : in_(input), options_(options), support_(support), turns_(turns), stop_(stop) {}

  std::vector<GrownScene> Run() const {
    const int views = static_cast<int>(in_.images.size());
    if (views == 1) return OfOneView();
    std::vector<std::pair<int, int>> pairs;
    for (int a = 0; a < views; ++a) {
      for (int b = a + 1; b < views; ++b) pairs.emplace_back(a, b);
    }
    std::vector<std::vector<GrownScene>> of_pair(pairs.size());
    ParallelFor(static_cast<int>(pairs.size()), options_.threads, [&](int p) {
      of_pair[p] = OfPair(pairs[p].first, pairs[p].second);
    });
    std::vector<GrownScene> all;
    for (auto& found : of_pair) {
      for (GrownScene& s : found) all.push_back(std::move(s));
    }
    KeepBest(all.size(), &all);
    return all;
  }

 private:
  // Of two hypotheses of one object the links by its best turns.
  std::vector<GrownScene> Turned(int a, int b, int i, int j) const {
    const AspectHypothesis &h = support_.Hypotheses(a)[i], &g = support_.Hypotheses(b)[j];
    const std::vector<int> here = {i}, there = {j};
    const auto support = [&](const Rigid3& turn) {
      const AspectSceneView from = support_.ViewOf(a, h.camera, h.camera_from_object);
      const AspectSceneView to = support_.ViewOf(b, g.camera, g.camera_from_object * turn);
      return support_.CarriedSupport(from, to, a, b, here) +
             support_.CarriedSupport(to, from, b, a, there);
    };
    std::vector<GrownScene> turned;
    for (const Rigid3& turn : turns_.Supported(h.object, support))
      turned.push_back(Link(a, b, i, j, turn));
    KeepBest(kLinkTurns, &turned);
    return turned;
  }

  std::vector<GrownScene> OfPair(int a, int b) const {
    std::vector<GrownScene> found;
    for (std::size_t i = 0; i < support_.Hypotheses(a).size(); ++i) {
      if (IsStopRequested(stop_)) return found;
      for (std::size_t j = 0; j < support_.Hypotheses(b).size(); ++j) {
        const AspectHypothesis &h = support_.Hypotheses(a)[i], &g = support_.Hypotheses(b)[j];
        if (h.object != g.object || (support_.IsByChance(a, i) && support_.IsByChance(b, j))) {
          continue;
        }
        for (GrownScene& s : Turned(a, b, static_cast<int>(i), static_cast<int>(j)))
          found.push_back(std::move(s));
      }
    }
    KeepBest(static_cast<std::size_t>(kPairStarts), &found);
    for (GrownScene& s : found) {
      s.support += support_.CarriedSupport(*s.views[a], *s.views[b], a, b, HypothesesOf(s, a)) +
                   support_.CarriedSupport(*s.views[b], *s.views[a], b, a, HypothesesOf(s, b));
    }
    KeepBest(found.size(), &found);
    std::vector<GrownScene> apart;
    for (GrownScene& s : found) {
      if (static_cast<int>(apart.size()) >= kLinksPerPair) break;
      const bool known = std::any_of(apart.begin(), apart.end(), [&](const GrownScene& other) {
        return IsSameLink(s, other, a, b);
      });
      if (!known) apart.push_back(std::move(s));
    }
    return apart;
  }

  // Two views linked by one hypothesis of each, and the other parts that agree.
  GrownScene Link(int a, int b, int i, int j, const Rigid3& turn) const {
    const AspectHypothesis &h = support_.Hypotheses(a)[i], &g = support_.Hypotheses(b)[j];
    GrownScene out;
    out.views.resize(in_.images.size());
    out.views[a] = support_.ViewOf(a, h.camera, h.camera_from_object);
    out.views[b] = support_.ViewOf(b, g.camera, g.camera_from_object * turn);
    GrownObject first;
    first.placed = {h.object, Rigid3{}};
    first.hypothesis.assign(in_.images.size(), -1);
    first.hypothesis[a] = i;
    first.hypothesis[b] = j;
    out.objects.push_back(first);
    out.support = Support(support_.Weight(a, i), support_.Weight(b, j));
    const Rigid3 scene_from_a = out.views[a]->camera_from_scene.Inverse();
    std::vector<Eigen::Vector3d> places = {support_.MeshOf(h.object).center.cast<double>()};
    std::vector<double> sizes = {support_.MeshOf(h.object).diameter_m};
    for (std::size_t k = 0; k < support_.Hypotheses(a).size(); ++k) {
      const AspectHypothesis& other = support_.Hypotheses(a)[k];
      if (static_cast<int>(k) == i || support_.IsByChance(a, k)) continue;
      if (out.objects.size() >= kLinkedObjects) break;
      const Rigid3 placed =
          scene_from_a *
          WithFocal(other.camera_from_object, other.camera.focal_px, h.camera.focal_px);
      const Eigen::Vector3d center = placed * support_.MeshOf(other.object).center.cast<double>();
      if (!IsApart(center, support_.MeshOf(other.object).diameter_m, places, sizes)) continue;
      const auto [match, value] = support_.BestAgreeing(
          b, *out.views[b], other.object, out.views[b]->camera_from_scene * placed);
      if (match < 0) continue;
      GrownObject object;
      object.placed = {other.object, placed};
      object.hypothesis.assign(in_.images.size(), -1);
      object.hypothesis[a] = static_cast<int>(k);
      object.hypothesis[b] = match;
      out.objects.push_back(std::move(object));
      out.support += Support(support_.Weight(a, k), value);
      places.push_back(center);
      sizes.push_back(support_.MeshOf(other.object).diameter_m);
    }
    return out;
  }

  bool IsApart(const Eigen::Vector3d& center,
               double diameter,
               const std::vector<Eigen::Vector3d>& places,
               const std::vector<double>& sizes) const {
    for (std::size_t p = 0; p < places.size(); ++p) {
      if ((center - places[p]).norm() < kOnePlaceShare * std::min(diameter, sizes[p])) return false;
    }
    return true;
  }

  std::vector<GrownScene> OfOneView() const {
    std::vector<GrownScene> out;
    for (std::size_t i = 0; i < support_.Hypotheses(0).size() && i < kAlone; ++i) {
      const AspectHypothesis& h = support_.Hypotheses(0)[i];
      GrownScene scene;
      scene.views.push_back(support_.ViewOf(0, h.camera, h.camera_from_object));
      scene.objects.push_back({{h.object, Rigid3{}}, {static_cast<int>(i)}});
      scene.support = h.score;
      out.push_back(std::move(scene));
    }
    return out;
  }

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const HypothesisSupport& support_;
  const LinkTurns& turns_;
  const StopRequested& stop_;
};

}  // namespace

std::vector<GrownScene> LinkPairs(const AspectLinkInput& input,
                                  const AspectLinkOptions& options,
                                  const HypothesisSupport& support,
                                  const LinkTurns& turns,
                                  const StopRequested& stop) {
  return PairLinks(input, options, support, turns, stop).Run();
}

}  // namespace horopter
