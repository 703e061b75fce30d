// The metric refinement: time beside accuracy, six images and four objects, and what it is made of.
#include <benchmark/benchmark.h>

#include <algorithm>

#include "server/vision/euclidean/euclidean.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

const MetricSceneTruth& Scene(int views, int objects) {
  static const std::vector<std::shared_ptr<const PreparedObject>> parts = {
      PrepareObject(LBracket()).value(),
      PrepareObject(Wedge()).value(),
      PrepareObject(Prism("profile", {{0, 0}, {0.06, 0}, {0.05, 0.03}, {0.01, 0.045}}, 0.03))
          .value(),
      PrepareObject(Prism("step", {{0, 0}, {0.05, 0}, {0.05, 0.04}, {0.02, 0.055}}, 0.06)).value()};
  static std::map<std::pair<int, int>, MetricSceneTruth> scenes;
  auto& scene = scenes[{views, objects}];
  if (scene.objects.empty()) {
    MetricSceneOptions options;
    options.views = views;
    options.parts.assign(parts.begin(), parts.begin() + objects);
    scene = MakeMetricScene(options);
  }
  return scene;
}

// range: views, objects, threads
void BM_RefineMetricScene(benchmark::State& state) {
  const MetricSceneTruth& scene =
      Scene(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)));
  EuclideanOptions options;
  options.threads = static_cast<int>(state.range(2));
  double worst_mm = 0.0;
  for (auto _ : state) {
    const auto metric = RefineMetricScene(scene.Input(), scene.recognition, options);
    if (!metric.ok()) {
      state.SkipWithError("refused");
      break;
    }
    for (std::size_t k = 1; k < metric->objects.size(); ++k) {
      const Rigid3 truth = scene.world_from_object[0].Inverse() * scene.world_from_object[k];
      const Eigen::Vector3d c = scene.objects[k]->center;
      worst_mm =
          std::max(worst_mm, 1e3 * (metric->objects[k].scene_from_object * c - truth * c).norm());
    }
  }
  state.counters["worst_mm"] = worst_mm;
}
BENCHMARK(BM_RefineMetricScene)
    ->Args({6, 4, 1})
    ->Args({6, 4, 2})
    ->Args({3, 1, 2})
    ->MeasureProcessCPUTime()
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

// What the cells of edge points are compared with: distance maps of whole images.
void BM_EdgeGrids(benchmark::State& state) {
  const MetricSceneTruth& scene = Scene(6, 4);
  for (auto _ : state) {
    for (const ImageFeatures& f : scene.features) benchmark::DoNotOptimize(EdgeGrid(f));
  }
}
BENCHMARK(BM_EdgeGrids)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
