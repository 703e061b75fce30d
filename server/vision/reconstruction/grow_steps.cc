#include "server/vision/reconstruction/grow_steps.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/base/stop_scope.h"
#include "server/vision/reconstruction/intersection_resection.h"

namespace horopter {
namespace {

constexpr double kRegisterGate2 = 64.0;   // 8 sigma: structure of two views is still rough
constexpr int kRegisterIterations = 200;  // draws at most for one camera; fewer where most fit
constexpr int kMinimalFeatures = 6;       // 12 equations for a camera's 11 unknowns
constexpr int kMinRegistered = 7;         // one more than minimal, or nothing is checked
// Sweeps after each view: the first ones decide what the others are registered to.
constexpr int kEarlySweeps = 3, kLateSweeps = 1, kEarlyViews = 4;
constexpr int kFinalRounds = 4;
constexpr double kRoughGate = 3.0;  // chi^2 of the first round, before any adjustment
// Fewer marks changed than this: another adjustment would find the same optimum.
constexpr double kSettledShare = 0.005;
constexpr int kMaxSubsets = 15;  // pairs of views tried for a feature with outliers

// A known feature as a view sees it.
struct Sighting {
  bool is_point = true;
  int observation = -1;
};

std::vector<Sighting> KnownFeatures(const GrowContext& c, const ProjectiveScene& scene, int view) {
  std::vector<Sighting> out;
  for (const int k : c.index.points_in_view[view]) {
    if (scene.point_inlier[k] && scene.points[c.tracks.point_observations[k].point]) {
      out.push_back({true, k});
    }
  }
  for (const int k : c.index.lines_in_view[view]) {
    if (scene.line_inlier[k] && scene.lines[c.tracks.line_observations[k].line]) {
      out.push_back({false, k});
    }
  }
  return out;
}

double Squared(const GrowContext& c,
               const ProjectiveScene& scene,
               const Sighting& s,
               const CameraMatrix& P) {
  if (s.is_point) {
    const PointObservation& o = c.tracks.point_observations[s.observation];
    return PointResidual(P, *scene.points[o.point], o).squaredNorm();
  }
  const LineObservation& o = c.tracks.line_observations[s.observation];
  return LineResidual(P, *scene.lines[o.line], o).squaredNorm();
}

template <typename Sightings>
std::optional<CameraMatrix> ResectView(const GrowContext& c,
                                       const ProjectiveScene& scene,
                                       const Sightings& sightings,
                                       const std::optional<CameraMatrix>& previous) {
  std::vector<WeightedPoint> points;
  std::vector<WeightedLine> lines;
  for (const Sighting& s : sightings) {
    if (s.is_point) {
      const PointObservation& o = c.tracks.point_observations[s.observation];
      points.push_back({&o, CameraMatrix::Zero(), *scene.points[o.point], 1.0});
    } else {
      const LineObservation& o = c.tracks.line_observations[s.observation];
      lines.push_back({&o, CameraMatrix::Zero(), *scene.lines[o.line], 1.0});
    }
  }
  return ResectCamera(points, lines, previous);
}

std::vector<Sighting> Fitting(const GrowContext& c,
                              const ProjectiveScene& scene,
                              const std::vector<Sighting>& all,
                              const CameraMatrix& P) {
  std::vector<Sighting> out;
  for (const Sighting& s : all) {
    if (Squared(c, scene, s, P) < kRegisterGate2) out.push_back(s);
  }
  return out;
}

// RANSAC over minimal sets of points and lines; refits on the inliers.
std::optional<CameraMatrix> ResectRobustly(const GrowContext& c,
                                           const ProjectiveScene& scene,
                                           const std::vector<Sighting>& all,
                                           std::mt19937* rng) {
  const int n = static_cast<int>(all.size());
  if (n < kMinRegistered) return std::nullopt;
  std::optional<CameraMatrix> best;
  std::vector<Sighting> best_fitting;
  double needed = kRegisterIterations;
  const auto consider = [&](const std::optional<CameraMatrix>& start) {
    std::optional<CameraMatrix> P = start;
    for (int refit = 0; P; ++refit) {
      std::vector<Sighting> fitting = Fitting(c, scene, all, *P);
      if (fitting.size() <= best_fitting.size()) break;
      best = P;
      best_fitting = std::move(fitting);
      if (refit == 3 || static_cast<int>(best_fitting.size()) < kMinRegistered) break;
      P = ResectView(c, scene, best_fitting, P);
    }
    const double share = static_cast<double>(best_fitting.size()) / n;
    const double miss = std::log1p(-std::pow(share, kMinimalFeatures));
    if (miss < 0.0) needed = std::min<double>(kRegisterIterations, std::log(1e-3) / miss);
  };
  // All at once first: without outliers nothing is better.
  std::optional<CameraMatrix> P = ResectView(c, scene, all, std::nullopt);
  for (int i = 0; i < 2 && P; ++i) P = ResectView(c, scene, all, P);
  consider(P);
  std::array<Sighting, kMinimalFeatures> sample;
  for (int i = 0; i < needed; ++i) {
    std::array<int, kMinimalFeatures> chosen{};
    for (int k = 0; k < kMinimalFeatures; ++k) {
      do {
        chosen[k] = static_cast<int>((*rng)() % static_cast<unsigned>(n));
      } while (std::find(chosen.begin(), chosen.begin() + k, chosen[k]) != chosen.begin() + k);
      sample[k] = all[chosen[k]];
    }
    consider(ResectView(c, scene, sample, std::nullopt));
  }
  if (static_cast<int>(best_fitting.size()) < kMinRegistered ||
      static_cast<double>(best_fitting.size()) < c.options.min_inlier_share * n) {
    return std::nullopt;
  }
  return best;
}

AlternationOptions Sweeps(AlternationOptions options, int count, double start_scale) {
  options.max_sweeps = count;
  options.start_scale = start_scale;
  return options;
}

// The feature that most of its observations support: the present one, which the adjustment has
// seen, unless another has more; that is found from pairs of views and refined on all that fit.
template <typename Feature, typename Triangulate, typename Fits>
std::optional<Feature> ConsensusFeature(const std::vector<int>& observations,
                                        const std::optional<Feature>& present,
                                        size_t minimal,
                                        const Triangulate& triangulate,
                                        const Fits& fits) {
  std::optional<Feature> best;
  size_t most = minimal - 1;
  const auto fitting_of = [&](const Feature& x) {
    std::vector<int> fitting;
    for (const int k : observations) {
      if (fits(x, k)) fitting.push_back(k);
    }
    return fitting;
  };
  if (present) {
    const size_t fitting = fitting_of(*present).size();
    if (fitting >= minimal) {
      best = present;
      most = fitting;
    }
  }
  const auto consider = [&](std::vector<int> subset) {
    std::optional<Feature> x = triangulate(subset);
    if (!x) return;
    subset = fitting_of(*x);
    if (subset.size() <= most) return;
    most = subset.size();
    best = x;
    const std::optional<Feature> refined = triangulate(subset);
    if (!refined) return;
    const size_t fitting = fitting_of(*refined).size();
    if (fitting < most) return;
    most = fitting;
    best = refined;
  };
  consider(observations);
  int tried = 0;
  for (size_t i = 0; i < observations.size() && most < observations.size(); ++i) {
    for (size_t j = i + 1; j < observations.size() && tried < kMaxSubsets; ++j, ++tried) {
      consider({observations[i], observations[j]});
    }
  }
  return best;
}

std::vector<int> InKnownViews(const std::vector<int>& observations,
                              const ProjectiveScene& scene,
                              const auto& list) {
  std::vector<int> out;
  for (const int k : observations) {
    if (scene.cameras[list[k].view]) out.push_back(k);
  }
  return out;
}

// chi^2 gate: the test's bound times the variance that the median residual suggests.
double OutlierGate(const GrowContext& c, const ProjectiveScene& scene) {
  std::vector<double> squared;
  for (size_t k = 0; k < scene.point_inlier.size(); ++k) {
    const PointObservation& o = c.tracks.point_observations[k];
    if (!scene.point_inlier[k] || !scene.cameras[o.view] || !scene.points[o.point]) continue;
    squared.push_back(
        PointResidual(*scene.cameras[o.view], *scene.points[o.point], o).squaredNorm());
  }
  for (size_t k = 0; k < scene.line_inlier.size(); ++k) {
    const LineObservation& o = c.tracks.line_observations[k];
    if (!scene.line_inlier[k] || !scene.cameras[o.view] || !scene.lines[o.line]) continue;
    squared.push_back(LineResidual(*scene.cameras[o.view], *scene.lines[o.line], o).squaredNorm());
  }
  if (squared.empty()) return c.options.outlier_chi2;
  std::nth_element(squared.begin(), squared.begin() + squared.size() / 2, squared.end());
  constexpr double kMedianChi2 = 1.386;  // of two degrees of freedom
  return c.options.outlier_chi2 * std::max(1.0, squared[squared.size() / 2] / kMedianChi2);
}

// Every feature again from the observations that agree on it; marks all of them. `widening` of the
// gate: above 1 while cameras are still rough.
void Reclassify(const GrowContext& c, double widening, ProjectiveScene* scene) {
  const double gate = widening * OutlierGate(c, *scene);
  ProjectiveScene all = *scene;  // with every observation allowed
  all.point_inlier.assign(all.point_inlier.size(), true);
  all.line_inlier.assign(all.line_inlier.size(), true);
  for (int j = 0; j < c.tracks.points; ++j) {
    const auto seen = InKnownViews(c.index.of_point[j], *scene, c.tracks.point_observations);
    for (const int k : c.index.of_point[j]) scene->point_inlier[k] = false;
    const auto fits = [&](const Eigen::Vector4d& X, int k) {
      const PointObservation& o = c.tracks.point_observations[k];
      return PointResidual(*scene->cameras[o.view], X, o).squaredNorm() < gate;
    };
    std::optional<Eigen::Vector4d>& X = scene->points[j];
    if (!X || !std::all_of(seen.begin(), seen.end(), [&](int k) { return fits(*X, k); })) {
      // Where something is wrong, two of three views agree too easily: an epipolar line is long.
      const std::optional<Eigen::Vector4d> before = X;
      X = ConsensusFeature<Eigen::Vector4d>(
          seen,
          before,
          3,
          [&](const std::vector<int>& subset) {
            return TriangulatePoint(c.tracks, subset, all, 2);
          },
          fits);
    }
    for (const int k : seen) scene->point_inlier[k] = X && fits(*X, k);
  }
  for (int j = 0; j < c.tracks.lines; ++j) {
    const auto seen = InKnownViews(c.index.of_line[j], *scene, c.tracks.line_observations);
    for (const int k : c.index.of_line[j]) scene->line_inlier[k] = false;
    const auto fits = [&](const PluckerLine& L, int k) {
      const LineObservation& o = c.tracks.line_observations[k];
      return LineResidual(*scene->cameras[o.view], L, o).squaredNorm() < gate;
    };
    std::optional<PluckerLine>& L = scene->lines[j];
    if (!L || !std::all_of(seen.begin(), seen.end(), [&](int k) { return fits(*L, k); })) {
      // Two views of a line always agree, so three must.
      const std::optional<PluckerLine> before = L;
      L = ConsensusFeature<PluckerLine>(
          seen,
          before,
          3,
          [&](const std::vector<int>& subset) { return TriangulateLine(c.tracks, subset, all, 2); },
          fits);
    }
    for (const int k : seen) scene->line_inlier[k] = L && fits(*L, k);
  }
}

int Changes(const std::vector<bool>& before, const std::vector<bool>& after) {
  int changed = 0;
  for (size_t k = 0; k < before.size(); ++k) changed += before[k] != after[k];
  return changed;
}

}  // namespace

int KnownCameras(const ProjectiveScene& scene) {
  return static_cast<int>(std::count_if(
      scene.cameras.begin(), scene.cameras.end(), [](const auto& P) { return P.has_value(); }));
}

void RegisterViews(const GrowContext& c, std::mt19937* rng, ProjectiveScene* scene) {
  const int views = static_cast<int>(c.tracks.sizes.size());
  std::vector<bool> failed(views, false);
  while (!IsStopRequested(c.stop)) {
    int next = -1;
    std::vector<Sighting> features;
    for (int v = 0; v < views; ++v) {
      if (scene->cameras[v] || failed[v]) continue;
      std::vector<Sighting> known = KnownFeatures(c, *scene, v);
      if (next < 0 || known.size() > features.size()) {
        next = v;
        features = std::move(known);
      }
    }
    if (next < 0) return;
    const auto P = ResectRobustly(c, *scene, features, rng);
    if (!P) {
      failed[next] = true;
      continue;
    }
    scene->cameras[next] = P;
    failed.assign(views, false);  // more is known now
    const int sweeps = KnownCameras(*scene) <= kEarlyViews ? kEarlySweeps : kLateSweeps;
    Alternate(c.tracks, c.index, Sweeps(c.options.alternation, sweeps, 4.0), scene);
  }
}

double InlierShare(const GrowContext& c, const ProjectiveScene& scene, int view) {
  int fit = 0, all = 0;
  const auto count = [&](const auto& of_feature, const auto& list, const auto& inlier) {
    for (const std::vector<int>& observations : of_feature) {
      const std::vector<int> seen = InKnownViews(observations, scene, list);
      if (seen.size() < 2) continue;
      for (const int k : seen) {
        if (view >= 0 && list[k].view != view) continue;
        ++all;
        fit += inlier[k];
      }
    }
  };
  count(c.index.of_point, c.tracks.point_observations, scene.point_inlier);
  // Lines of two views prove nothing and count as neither.
  for (const std::vector<int>& observations : c.index.of_line) {
    const std::vector<int> seen = InKnownViews(observations, scene, c.tracks.line_observations);
    if (seen.size() < 3) continue;
    for (const int k : seen) {
      if (view >= 0 && c.tracks.line_observations[k].view != view) continue;
      ++all;
      fit += scene.line_inlier[k];
    }
  }
  return all > 0 ? static_cast<double>(fit) / all : 0.0;
}

bool Finish(const GrowContext& c, ProjectiveScene* scene) {
  for (int round = 0; round < kFinalRounds; ++round) {
    if (IsStopRequested(c.stop) || KnownCameras(*scene) < 2) return false;
    if (!c.options.bundle_adjust) {
      Alternate(c.tracks,
                c.index,
                Sweeps(c.options.alternation, round == 0 ? 12 : 25, round == 0 ? 3.0 : 1.0),
                scene);
    } else {
      const ProjectiveBundleOptions& ba = round == 0 ? c.options.rough : c.options.bundle;
      if (!AdjustProjective(c.tracks, ba, scene).usable) return false;
    }
    LeaveIfStopped();
    const std::vector<bool> points = scene->point_inlier, lines = scene->line_inlier;
    Reclassify(c, round == 0 ? kRoughGate : 1.0, scene);
    LeaveIfStopped();
    bool dropped = false;
    for (size_t v = 0; v < scene->cameras.size(); ++v) {
      if (!scene->cameras[v]) continue;
      if (InlierShare(c, *scene, static_cast<int>(v)) >= c.options.min_inlier_share) continue;
      scene->cameras[v].reset();
      dropped = true;
    }
    const int changed = Changes(points, scene->point_inlier) + Changes(lines, scene->line_inlier);
    const double share = changed / std::max(1.0, static_cast<double>(points.size() + lines.size()));
    if (round > 0 && !dropped && share < kSettledShare) break;
  }
  return KnownCameras(*scene) >= 2;
}

}  // namespace horopter
