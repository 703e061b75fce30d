// Accuracy and time of the reconstruction from points and lines, swept over noise, features and
// cameras (the thesis's figures 3.2 - 3.6), with the thesis's methods and a points-only adjustment
// beside it. Counters are medians over a fixed set of scenes; plot_reconstruction.py draws them.
//
//     reconstruction_benchmark --benchmark_format=json > reconstruction.json
#include <benchmark/benchmark.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <vector>

#include "server/vision/reconstruction/bundle_adjustment.h"
#include "server/vision/reconstruction/calibrated_bundle.h"
#include "server/vision/reconstruction/self_calibration.h"
#include "tests/support/ceres_bundle.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

constexpr int kScenes = 20;

enum Method { kDepthDecomposition, kAlgebraicDistances, kAlternation, kFull };

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return -1.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(share * static_cast<double>(values.size() - 1))];
}

void NormalizeCameras(const std::vector<ImageSize>& sizes, ProjectiveScene* scene) {
  for (size_t v = 0; v < sizes.size(); ++v) {
    if (!scene->cameras[v]) continue;
    const CameraMatrix P = NormalizedFromPixels(sizes[v]) * *scene->cameras[v];
    scene->cameras[v] = P / P.norm();
  }
}

std::optional<ProjectiveScene> Solve(Method method, const SyntheticTracks& truth) {
  if (method == kFull) {
    const auto r = ReconstructProjective(truth.tracks, {});
    if (!r.ok() || r->outcome != ProjectiveOutcome::kReconstructed) return std::nullopt;
    return r->scene;
  }
  const MultiviewTracks normalized = NormalizeTracks(truth.tracks);
  auto scene = DecomposeDepths(normalized);
  if (!scene) return std::nullopt;
  if (method != kDepthDecomposition) {
    BalanceGauge(&*scene);
    AlternationOptions options;
    options.geometric = method == kAlternation;
    options.loss = method == kAlternation ? RobustLoss::kTukey : RobustLoss::kNone;
    Alternate(normalized, IndexTracks(normalized), options, &*scene);
  }
  CamerasToPixels(truth.tracks.sizes, &*scene);
  return scene;
}

void Sweep(benchmark::State& state,
           Method method,
           const std::function<SyntheticTracks(unsigned)>& make) {
  std::vector<SyntheticTracks> scenes;
  for (unsigned seed = 1; seed <= kScenes; ++seed) scenes.push_back(make(seed));
  std::vector<double> error, rms;
  for (auto _ : state) {
    error.clear();
    rms.clear();
    for (const SyntheticTracks& truth : scenes) {
      const auto scene = Solve(method, truth);
      if (!scene) continue;
      state.PauseTiming();
      error.push_back(1e3 * CompareWithTruth(truth, *scene).rms_m);
      rms.push_back(Summarize(truth.tracks, *scene).rms_px);
      state.ResumeTiming();
    }
  }
  state.counters["answered"] = static_cast<double>(error.size()) / kScenes;
  state.counters["error_mm"] = Quantile(error, 0.5);
  state.counters["error_mm_90"] = Quantile(error, 0.9);
  state.counters["rms_px"] = Quantile(rms, 0.5);
  state.counters["scene_ms"] = benchmark::Counter(
      1e-3 * kScenes, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

// Noise in hundredths of a pixel.
void Noise(benchmark::State& state) {
  Sweep(state, static_cast<Method>(state.range(0)), [&](unsigned seed) {
    return MakeSyntheticTracks({.seed = seed, .points = 50, .lines = 30},
                               {seed, 0.01 * static_cast<double>(state.range(1)), 0.1});
  });
}
void Features(benchmark::State& state) {
  Sweep(state, static_cast<Method>(state.range(0)), [&](unsigned seed) {
    const int n = static_cast<int>(state.range(1));
    return MakeSyntheticTracks({.seed = seed, .points = n, .lines = n / 2}, {seed, 0.5, 0.1});
  });
}
void Cameras(benchmark::State& state) {
  Sweep(state, static_cast<Method>(state.range(0)), [&](unsigned seed) {
    return MakeSyntheticTracks(
        {.seed = seed, .views = static_cast<int>(state.range(1)), .points = 50, .lines = 30},
        {seed, 0.5, 0.1});
  });
}
const std::vector<int64_t> kMethods = {
    kDepthDecomposition, kAlgebraicDistances, kAlternation, kFull};
BENCHMARK(Noise)->ArgsProduct({kMethods, {10, 30, 50, 100, 200}})->Iterations(1);
BENCHMARK(Features)->ArgsProduct({kMethods, {10, 20, 40, 80, 160}})->Iterations(1);
BENCHMARK(Cameras)->ArgsProduct({kMethods, {3, 4, 6, 8, 12}})->Iterations(1);

// Three parts, outliers in hundredths.
void Parts(benchmark::State& state) {
  Sweep(state, kFull, [&](unsigned seed) {
    return MakeSyntheticTracks({.seed = seed},
                               {seed, 0.5, 0.2, 0.01 * static_cast<double>(state.range(0))});
  });
}
BENCHMARK(Parts)->Arg(0)->Arg(5)->Arg(10)->Iterations(1);

// Points and lines, 150 each unless scaled: cost is linear in observations.
void Time(benchmark::State& state) {
  const int n = static_cast<int>(state.range(0));
  Sweep(state, kFull, [&](unsigned seed) {
    return MakeSyntheticTracks({.seed = seed, .points = n, .lines = n}, {seed, 0.5, 0.0});
  });
}
// ... and with self-calibration behind it.
void MetricTime(benchmark::State& state) {
  const int n = static_cast<int>(state.range(0));
  int metric = 0;
  for (auto _ : state) {
    for (unsigned seed = 1; seed <= kScenes; ++seed) {
      state.PauseTiming();
      const SyntheticTracks truth =
          MakeSyntheticTracks({.seed = seed, .points = n, .lines = n}, {seed, 0.5, 0.0});
      state.ResumeTiming();
      const auto r = ReconstructTracks(truth.tracks, {}, {}, {});
      metric += r.ok() && r->metric.outcome == MetricOutcome::kMetric;
    }
  }
  state.counters["metric"] = static_cast<double>(metric) / kScenes;
  state.counters["scene_ms"] = benchmark::Counter(
      1e-3 * kScenes, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}
BENCHMARK(MetricTime)->Arg(150)->Iterations(1)->Unit(benchmark::kMillisecond);

BENCHMARK(Time)->Arg(75)->Arg(150)->Arg(300)->Arg(600)->Iterations(1)->Unit(
    benchmark::kMillisecond);

// Adjustment alone on the same point tracks from the same start: ours, projective, metric and over
// a plane, beside a points-only metric one of COLMAP's kind (Ceres, automatic derivatives, dense
// Schur).
enum Adjuster { kProjective, kCeres, kMetric, kPlane };

void AdjustPoints(benchmark::State& state) {
  const auto adjuster = static_cast<Adjuster>(state.range(0));
  std::vector<double> rms;
  for (auto _ : state) {
    rms.clear();
    for (unsigned seed = 1; seed <= kScenes; ++seed) {
      state.PauseTiming();
      SyntheticTracksOptions options{.seed = seed, .points = 300};
      options.principal_point_sd_px = 0.0;
      const SyntheticTracks truth = MakeSyntheticTracks(options, {seed, 0.5, 0.0});
      std::mt19937 rng(seed);
      const auto jitter = [&] { return 0.005 * (static_cast<double>(rng()) / 2147483648.0 - 1.0); };
      Bundle bundle;
      ProjectiveScene scene = EmptyScene(truth.tracks);
      const ProjectiveScene all = scene;  // every observation is an inlier
      CalibratedScene metric;
      for (int v = 0; v < 6; ++v) {
        BundleView view;
        view.size = truth.tracks.sizes[v];
        view.focal_px = truth.cameras[v].focal_px;
        view.camera_from_world = truth.camera_from_world[v];
        bundle.views.push_back(view);
        const CameraMatrix P = truth.TrueCamera(v);
        scene.cameras[v] = P / P.norm();
        metric.views.push_back(CalibratedView{{truth.cameras[v], truth.camera_from_world[v]}, 0.0});
      }
      bundle.points.resize(truth.points.size());
      for (size_t j = 0; j < truth.points.size(); ++j) {
        const Eigen::Vector3d x = truth.points[j] + Eigen::Vector3d(jitter(), jitter(), jitter());
        bundle.points[j].point_in_world = x;
        scene.points[j] = Eigen::Vector4d(x.homogeneous().normalized());
        metric.points.push_back(x);
      }
      for (const PointObservation& o : truth.tracks.point_observations) {
        bundle.points[o.point].track.observations.push_back({o.view, -1, o.pixel});
      }
      const MultiviewTracks normalized = NormalizeTracks(truth.tracks);
      NormalizeCameras(truth.tracks.sizes, &scene);
      BalanceGauge(&scene);
      CalibratedBundleOptions with_k1;
      with_k1.estimate_k1 = true;
      CalibratedBundleSummary summary;
      state.ResumeTiming();
      if (adjuster == kCeres) AdjustBundleInCeres({}, &bundle);
      if (adjuster == kPlane) AdjustBundle({}, &bundle);
      if (adjuster == kProjective) AdjustProjective(normalized, {}, &scene);
      if (adjuster == kMetric) summary = AdjustCalibrated(truth.tracks, all, {}, with_k1, &metric);
      state.PauseTiming();
      if (adjuster == kCeres || adjuster == kPlane) {
        double squared = 0.0;
        for (const BundlePoint& p : bundle.points) {
          for (const TrackObservation& o : p.track.observations) {
            const auto u = ProjectInto(bundle.views[o.view], p.point_in_world);
            if (u) squared += (*u - o.point).squaredNorm();
          }
        }
        rms.push_back(std::sqrt(
            squared / (2.0 * static_cast<double>(truth.tracks.point_observations.size()))));
      } else if (adjuster == kProjective) {
        CamerasToPixels(truth.tracks.sizes, &scene);
        rms.push_back(Summarize(truth.tracks, scene).rms_px);
      } else {
        rms.push_back(summary.rms_px);
      }
      state.ResumeTiming();
    }
  }
  state.counters["rms_px"] = Quantile(rms, 0.5);
  state.counters["scene_ms"] = benchmark::Counter(
      1e-3 * kScenes, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}
BENCHMARK(AdjustPoints)
    ->Arg(kProjective)
    ->Arg(kCeres)
    ->Arg(kMetric)
    ->Arg(kPlane)
    ->Iterations(3)
    ->Unit(benchmark::kMillisecond);

// rms distance of the points of each part after its own best similarity, millimetres.
std::vector<double> PartErrors(const SyntheticTracks& truth, const CalibratedScene& scene) {
  std::vector<double> out;
  for (int part = 0; part < 3; ++part) {
    std::vector<int> of_model;
    for (size_t j = 0; j < truth.part_of_point.size(); ++j) {
      if (truth.part_of_point[j] == part && scene.points[j])
        of_model.push_back(static_cast<int>(j));
    }
    if (of_model.size() < 6) continue;
    Eigen::Matrix3Xd A(3, of_model.size()), B(3, of_model.size());
    for (size_t k = 0; k < of_model.size(); ++k) {
      A.col(static_cast<Eigen::Index>(k)) = *scene.points[of_model[k]];
      B.col(static_cast<Eigen::Index>(k)) = truth.points[of_model[k]];
    }
    const Eigen::Matrix4d T = Eigen::umeyama(A, B, true);
    const Eigen::Matrix3Xd D =
        ((T.topLeftCorner<3, 3>() * A).colwise() + T.topRightCorner<3, 1>()) - B;
    out.push_back(1e3 * std::sqrt(D.squaredNorm() / static_cast<double>(of_model.size())));
  }
  return out;
}

// Three parts, 0.5 px: focal error (percent), structure of each part (mm), deviation honesty.
void SelfCalibration(benchmark::State& state) {
  std::vector<double> focal, part;
  double squared = 0.0;
  int metric = 0;
  for (auto _ : state) {
    for (unsigned seed = 1; seed <= 2 * kScenes; ++seed) {
      const SyntheticTracks truth = MakeSyntheticTracks(
          {.seed = seed, .views = static_cast<int>(state.range(0))}, {seed, 0.5, 0.2});
      const auto r = ReconstructTracks(truth.tracks, {}, {}, {});
      if (!r.ok() || r->metric.outcome != MetricOutcome::kMetric) continue;
      ++metric;
      for (size_t v = 0; v < truth.cameras.size(); ++v) {
        const auto& view = r->metric.scene.views[v];
        if (!view) continue;
        const double e = std::log(view->camera.focal_px / truth.cameras[v].focal_px);
        focal.push_back(100.0 * std::abs(e));
        squared += e * e / (view->focal_log_sigma * view->focal_log_sigma);
      }
      for (const double e : PartErrors(truth, r->metric.scene)) part.push_back(e);
    }
  }
  state.counters["metric"] = metric / (2.0 * kScenes);
  state.counters["focal_percent"] = Quantile(focal, 0.5);
  state.counters["focal_percent_90"] = Quantile(focal, 0.9);
  state.counters["part_mm"] = Quantile(part, 0.5);
  state.counters["part_mm_90"] = Quantile(part, 0.9);
  state.counters["error_per_sigma"] =
      std::sqrt(squared / std::max<double>(1.0, static_cast<double>(focal.size())));
  state.counters["scene_ms"] = benchmark::Counter(
      2e-3 * kScenes, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}
BENCHMARK(SelfCalibration)->Arg(3)->Arg(4)->Arg(6)->Arg(8)->Iterations(1);

// Six points with and without twenty lines, the latter from the former's optimum.
void LinesHelp(benchmark::State& state) {
  std::vector<double> with, without;
  for (auto _ : state) {
    for (unsigned seed = 1; seed <= kScenes; ++seed) {
      const SyntheticTracks truth =
          MakeSyntheticTracks({.seed = seed, .points = 6, .lines = 20}, {seed, 0.5, 0.0});
      const auto r = ReconstructProjective(truth.tracks, {});
      if (!r.ok() || r->outcome != ProjectiveOutcome::kReconstructed) continue;
      with.push_back(1e3 * CameraCollineationRms(truth, r->scene));
      MultiviewTracks points = NormalizeTracks(truth.tracks);
      points.line_observations.clear();
      ProjectiveScene scene = r->scene;
      NormalizeCameras(truth.tracks.sizes, &scene);
      BalanceGauge(&scene);
      scene.line_inlier.clear();
      scene.point_inlier.assign(points.point_observations.size(), true);
      AdjustProjective(points, {.loss = RobustLoss::kNone}, &scene);
      CamerasToPixels(truth.tracks.sizes, &scene);
      without.push_back(1e3 * CameraCollineationRms(truth, scene));
    }
  }
  state.counters["answered"] = static_cast<double>(with.size()) / kScenes;
  state.counters["with_mm"] = Quantile(with, 0.5);
  state.counters["without_mm"] = Quantile(without, 0.5);
}
BENCHMARK(LinesHelp)->Iterations(1);

// Share of 10,000 points inside their 95 % ellipsoids.
void Coverage(benchmark::State& state) {
  int inside = 0, all = 0;
  for (auto _ : state) {
    for (unsigned seed = 1; all < 10000; ++seed) {
      const SyntheticTracks truth =
          MakeSyntheticTracks({.seed = seed, .points = 100, .lines = 30}, {seed, 0.3, 0.1});
      const auto r = ReconstructProjective(truth.tracks, {});
      if (!r.ok() || r->outcome != ProjectiveOutcome::kReconstructed) continue;
      const CollineationFit fit = CompareWithTruth(truth, r->scene);
      ProjectiveScene scene = r->scene;
      NormalizeCameras(truth.tracks.sizes, &scene);
      const auto covariance = ProjectiveCovariance(NormalizeTracks(truth.tracks), scene);
      if (!covariance) continue;
      const auto ellipsoids = AlignedPointCovariances(*covariance, scene, fit.metric_from_scene);
      for (size_t j = 0; j < truth.points.size(); ++j) {
        if (!scene.points[j] || !(ellipsoids[j].trace() > 0.0)) continue;
        const Eigen::Vector4d y = fit.metric_from_scene * *scene.points[j];
        const Eigen::Vector3d e = y.hnormalized() - truth.points[j];
        inside += e.dot(ellipsoids[j].ldlt().solve(e)) < 7.815;
        ++all;
      }
    }
  }
  state.counters["points"] = all;
  state.counters["inside"] = static_cast<double>(inside) / all;
}
BENCHMARK(Coverage)->Iterations(1);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
