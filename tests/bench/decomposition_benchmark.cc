// Collineations into rigid transforms: the thesis's methods side by side, accuracy beside time.
//   3 parts, 6 views, 0.5 px, 40 scenes: median and 90 % of the error between two parts.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>

#include "tests/support/collineated_scene.h"

namespace horopter {
namespace {

const std::vector<CollineatedScene>& Scenes() {
  static const std::vector<CollineatedScene> scenes = [] {
    std::vector<CollineatedScene> out;
    for (unsigned seed = 1; out.size() < 40 && seed < 80; ++seed) {
      if (auto scene = MakeCollineatedScene(seed, 3, 6, 0.5)) out.push_back(*std::move(scene));
    }
    return out;
  }();
  return scenes;
}

double Quantile(std::vector<double> v, double q) {
  if (v.empty()) return NAN;
  std::sort(v.begin(), v.end());
  return v[std::min(v.size() - 1, static_cast<std::size_t>(q * static_cast<double>(v.size())))];
}

template <typename Method>
void Run(benchmark::State& state, const Method& method) {
  std::vector<double> shift, turn;
  int failed = 0;
  for (auto _ : state) {
    shift.clear();
    turn.clear();
    failed = 0;
    for (const CollineatedScene& scene : Scenes()) {
      const auto poses = method(scene);
      if (!poses.ok()) {
        ++failed;
        continue;
      }
      for (int k = 1; k < 3; ++k) {
        const BetweenError e = ErrorBetween(scene, *poses, k);
        shift.push_back(1e3 * e.shift_m);
        turn.push_back(e.turn_rad * 180.0 / M_PI);
      }
    }
  }
  state.counters["mm"] = Quantile(shift, 0.5);
  state.counters["mm_90"] = Quantile(shift, 0.9);
  state.counters["deg"] = Quantile(turn, 0.5);
  state.counters["deg_90"] = Quantile(turn, 0.9);
  state.counters["failed"] = failed;
}

using Poses = absl::StatusOr<std::vector<Rigid3>>;

Poses PosesOf(const absl::StatusOr<Decomposition>& d) {
  if (!d.ok()) return d.status();
  return d->metric_from_object;
}

absl::StatusOr<Decomposition> Alternative(const CollineatedScene& s) {
  const auto start = DecomposeCommon(s.objects);
  return start.ok() ? RefineDecomposition(s.objects, *start) : start;
}

absl::StatusOr<Decomposition> InImages(const CollineatedScene& s) {
  const auto start = DecomposeCommon(s.objects);
  return start.ok() ? RefineInImages(s.objects, s.cameras, s.observations, *start) : start;
}

Poses Joint(const CollineatedScene& s, std::span<const ObjectEdgeObservation> edges) {
  const auto start = InImages(s);
  if (!start.ok()) return start.status();
  const auto joint = AdjustJointly(s.cameras, s.sizes, s.observations, edges, *start, 0.5);
  if (!joint.ok()) return joint.status();
  return joint->metric_from_object;
}

void BM_PolarPerObject(benchmark::State& state) {
  Run(state, [](const CollineatedScene& s) { return PosesOf(DecomposePerObject(s.objects)); });
}
void BM_CommonUpgrade(benchmark::State& state) {
  Run(state, [](const CollineatedScene& s) { return PosesOf(DecomposeCommon(s.objects)); });
}
void BM_AlternativeNonlinear(benchmark::State& state) {
  Run(state, [](const CollineatedScene& s) { return PosesOf(Alternative(s)); });
}
void BM_NonlinearInImages(benchmark::State& state) {
  Run(state, [](const CollineatedScene& s) { return PosesOf(InImages(s)); });
}
void BM_JointAdjustmentOfPoints(benchmark::State& state) {
  Run(state, [](const CollineatedScene& s) { return Joint(s, {}); });
}
void BM_JointAdjustment(benchmark::State& state) {
  Run(state, [](const CollineatedScene& s) { return Joint(s, s.edge_observations); });
}

BENCHMARK(BM_PolarPerObject)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_CommonUpgrade)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_AlternativeNonlinear)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_NonlinearInImages)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_JointAdjustmentOfPoints)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_JointAdjustment)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
