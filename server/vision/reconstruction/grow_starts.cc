#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/geometry/trifocal_tensor.h"
#include "server/vision/reconstruction/grow_steps.h"

namespace horopter {
namespace {

constexpr double kStartGate2 = 64.0;   // 8 sigma: a linear start is rough
constexpr int kMinStartFeatures = 7;   // seen by all views of a start
constexpr int kTripleIterations = 60;  // draws of a start from three views; for time
constexpr int kTripleEquations = 26;   // of the 26 free numbers of a trifocal tensor

double PointSquared(const GrowContext& c, const ProjectiveScene& scene, int k) {
  const PointObservation& o = c.tracks.point_observations[k];
  return PointResidual(*scene.cameras[o.view], *scene.points[o.point], o).squaredNorm();
}

double LineSquared(const GrowContext& c, const ProjectiveScene& scene, int k) {
  const LineObservation& o = c.tracks.line_observations[k];
  return LineResidual(*scene.cameras[o.view], *scene.lines[o.line], o).squaredNorm();
}

Triplet LineTriplet(const MultiviewTracks& tracks, const std::array<int, 3>& observations) {
  Triplet out;
  for (int v = 0; v < 3; ++v) {
    const LineObservation& o = tracks.line_observations[observations[v]];
    out[v] = o.start.homogeneous().cross(o.end.homogeneous()).normalized();
  }
  return out;
}

// Observations of each feature in all three views; features without are left out.
template <typename Observation>
std::vector<std::array<int, 3>> InAllThree(const std::vector<std::vector<int>>& of_feature,
                                           const std::vector<Observation>& observations,
                                           const std::vector<bool>& inlier,
                                           const std::array<int, 3>& views) {
  std::vector<std::array<int, 3>> out;
  for (const std::vector<int>& list : of_feature) {
    std::array<int, 3> found{-1, -1, -1};
    for (const int k : list) {
      for (int v = 0; v < 3; ++v) {
        if (inlier[k] && observations[k].view == views[v]) found[v] = k;
      }
    }
    if (*std::min_element(found.begin(), found.end()) >= 0) out.push_back(found);
  }
  return out;
}

// As many as determine a trifocal tensor, of points and lines alike.
void DrawTriplets(const std::vector<Triplet>& x,
                  const std::vector<Triplet>& l,
                  std::mt19937* rng,
                  std::vector<Triplet>* some_x,
                  std::vector<Triplet>* some_l) {
  const auto n = static_cast<unsigned>(x.size() + l.size());
  some_x->clear();
  some_l->clear();
  for (unsigned draw = 0;
       draw < 4 * n && 4 * some_x->size() + 2 * some_l->size() < kTripleEquations + 2;
       ++draw) {
    const size_t k = (*rng)() % n;
    if (k < x.size()) {
      some_x->push_back(x[k]);
    } else {
      some_l->push_back(l[k - x.size()]);
    }
  }
}

// A few sweeps over all its features.
void Settle(const GrowContext& c, ProjectiveScene* scene) {
  AlternationOptions few = c.options.alternation;
  few.max_sweeps = 10;
  Alternate(c.tracks, c.index, few, scene);
}

}  // namespace

std::optional<ProjectiveScene> StartFromPair(const GrowContext& c,
                                             const ProjectiveScene& screened,
                                             const ViewPair& pair) {
  ProjectiveScene scene = screened;
  const auto P = CamerasFromFundamental(pair.F);
  scene.cameras[pair.view_a] = P[0] / P[0].norm();
  scene.cameras[pair.view_b] = P[1] / P[1].norm();
  int known = 0;
  for (size_t m = 0; m < pair.matches.size(); ++m) {
    if (!pair.inlier[m]) continue;
    const int j = c.tracks.point_observations[pair.matches[m][0]].point;
    scene.points[j] = TriangulatePoint(c.tracks, pair.matches[m], scene, 2);
    known += scene.points[j].has_value();
  }
  if (known < kMinStartFeatures) return std::nullopt;
  for (int j = 0; j < c.tracks.lines; ++j) {
    scene.lines[j] = TriangulateLine(c.tracks, c.index.of_line[j], scene, 2);
  }
  BalanceGauge(&scene);
  return scene;
}

std::vector<std::array<int, 3>> RankTriples(const GrowContext& c, int keep) {
  const int n = static_cast<int>(c.tracks.sizes.size());
  std::vector<std::pair<int, std::array<int, 3>>> ranked;
  const std::vector<bool> points(c.tracks.point_observations.size(), true);
  const std::vector<bool> lines(c.tracks.line_observations.size(), true);
  constexpr int kMaxTriples = 200;  // of many views: neighbours first
  for (int gap = 2; gap < n; ++gap) {
    for (int a = 0; a + gap < n && static_cast<int>(ranked.size()) < kMaxTriples; ++a) {
      const std::array<int, 3> views{a, a + gap / 2, a + gap};
      const auto p = InAllThree(c.index.of_point, c.tracks.point_observations, points, views);
      const auto l = InAllThree(c.index.of_line, c.tracks.line_observations, lines, views);
      const int equations = static_cast<int>(4 * p.size() + 2 * l.size());
      if (equations >= kTripleEquations) ranked.push_back({equations, views});
    }
  }
  std::stable_sort(
      ranked.begin(), ranked.end(), [](const auto& x, const auto& y) { return x.first > y.first; });
  std::vector<std::array<int, 3>> out;
  for (const auto& [equations, views] : ranked) {
    if (static_cast<int>(out.size()) < keep) out.push_back(views);
  }
  return out;
}

std::optional<ProjectiveScene> StartFromTriple(const GrowContext& c,
                                               const ProjectiveScene& screened,
                                               const std::array<int, 3>& views) {
  const auto points =
      InAllThree(c.index.of_point, c.tracks.point_observations, screened.point_inlier, views);
  const auto lines =
      InAllThree(c.index.of_line, c.tracks.line_observations, screened.line_inlier, views);
  std::vector<Triplet> x, l;
  for (const auto& p : points) {
    Triplet t;
    for (int v = 0; v < 3; ++v) t[v] = c.tracks.point_observations[p[v]].pixel.homogeneous();
    x.push_back(t);
  }
  for (const auto& line : lines) l.push_back(LineTriplet(c.tracks, line));
  const int n = static_cast<int>(x.size() + l.size());
  if (n == 0) return std::nullopt;
  std::mt19937 rng(c.options.seed);
  std::optional<ProjectiveScene> best;
  int best_fitting = kMinStartFeatures - 1;
  for (int trial = 0; trial < kTripleIterations && best_fitting < 0.9 * n; ++trial) {
    if (IsStopRequested(c.stop)) return std::nullopt;
    std::vector<Triplet> some_x = x, some_l = l;
    if (trial > 0) DrawTriplets(x, l, &rng, &some_x, &some_l);  // all of them first
    const auto T = EstimateTrifocal(some_x, some_l);
    const auto P = T ? CamerasFromTrifocal(*T) : std::nullopt;
    if (!P) continue;
    ProjectiveScene scene = screened;
    for (int v = 0; v < 3; ++v) scene.cameras[views[v]] = (*P)[v] / (*P)[v].norm();
    int fitting = 0;
    for (const auto& p : points) {
      const int j = c.tracks.point_observations[p[0]].point;
      scene.points[j] = TriangulatePoint(c.tracks, p, scene, 3);
      bool fits = scene.points[j].has_value();
      for (int v = 0; v < 3 && fits; ++v) {
        fits = PointSquared(c, scene, p[v]) < kStartGate2;
      }
      fitting += fits;
      if (!fits) scene.points[j].reset();
    }
    for (const auto& line : lines) {
      const int j = c.tracks.line_observations[line[0]].line;
      scene.lines[j] = TriangulateLine(c.tracks, line, scene, 3);
      bool fits = scene.lines[j].has_value();
      for (int v = 0; v < 3 && fits; ++v) {
        fits = LineSquared(c, scene, line[v]) < kStartGate2;
      }
      fitting += fits;
      if (!fits) scene.lines[j].reset();
    }
    if (fitting > best_fitting) {
      best_fitting = fitting;
      BalanceGauge(&scene);
      best = std::move(scene);
    }
  }
  if (best) Settle(c, &*best);
  return best;
}

}  // namespace horopter
