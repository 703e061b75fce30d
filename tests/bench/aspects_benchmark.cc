// What searches for aspects spend their time in: renderings of a part with its visible edges, and
// fragments looked up by their keys. "per_scan" is the time as a share of a linear scan's over the
// same keys in the same run.
#include <benchmark/benchmark.h>

#include <ctime>

#include "server/vision/recognition/aspects/fragment_index.h"
#include "server/vision/recognition/aspects/visible_edges.h"
#include "tests/support/part_photos.h"
#include "tests/support/random.h"

namespace horopter {
namespace {

constexpr float kRadius = 0.51f;  // of the votes: 0.18 rad an angle

double ProcessorSeconds() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Parts {
  std::vector<PhotoPart> parts = AngleBlockCylinder({0.04, 0.025, 0.012}, 0.02, 0.035);
  std::vector<AspectModel> models;
  FragmentIndex grid;
  std::vector<FragmentKey> keys;  // asked for: of the parts, a little off
  double scan_s = 0.0;            // of one key

  Parts() {
    for (const PhotoPart& p : parts)
      models.push_back({&p.object, &p.fragments, p.model.symmetries});
    grid = BuildFragmentIndex(models);
    Random random(1);
    for (std::size_t i = 0; i < grid.keys.size(); i += 40) {
      keys.push_back(UnpackKey(grid.keys[i]));
      for (float& angle : keys.back()) angle += static_cast<float>(0.05 * random.Normal());
    }
    const double start = ProcessorSeconds();
    std::size_t near = 0;
    const int limit = static_cast<int>(kRadius * kRadius * kKeyScale * kKeyScale);
    for (const FragmentKey& key : keys) {
      const PackedFragmentKey packed = PackKey(key);
      for (const PackedFragmentKey& other : grid.keys)
        near += SquaredSteps(packed, other) <= limit ? 1 : 0;
    }
    benchmark::DoNotOptimize(near);
    scan_s = (ProcessorSeconds() - start) / static_cast<double>(keys.size());
  }
};

const Parts& Made() {
  static const Parts parts;
  return parts;
}

template <typename Find>
void TimeFind(benchmark::State& state, const Find& find) {
  const Parts& made = Made();
  std::vector<std::uint32_t> found;
  std::size_t asked = 0, all = 0;
  const double start = ProcessorSeconds();
  for (auto _ : state) {
    found.clear();
    find(made.keys[asked++ % made.keys.size()], &found);
    all += found.size();
  }
  const double each = (ProcessorSeconds() - start) / static_cast<double>(asked);
  state.counters["per_scan"] = each / made.scan_s;
  state.counters["found"] = static_cast<double>(all) / static_cast<double>(asked);
}

void BM_FindNearest(benchmark::State& state) {
  TimeFind(state, [](const FragmentKey& key, std::vector<std::uint32_t>* found) {
    Made().grid.FindNearest(key, kRadius, 120, {}, found);
  });
}
BENCHMARK(BM_FindNearest)->Unit(benchmark::kMicrosecond);

void BM_FindWithinRadius(benchmark::State& state) {
  TimeFind(state, [](const FragmentKey& key, std::vector<std::uint32_t>* found) {
    Made().grid.FindNearest(key, kRadius, Made().grid.fragments.size(), {}, found);
  });
}
BENCHMARK(BM_FindWithinRadius)->Unit(benchmark::kMicrosecond);

// Of random poses of all parts; the argument is the size of the diameter in the rendering.
void BM_FindVisibleEdges(benchmark::State& state) {
  const Parts& made = Made();
  const PinholeCamera camera = CenteredCamera(640, 480, 700.0);
  VisibleEdgeOptions options;
  options.render_px = static_cast<double>(state.range(0));
  Random random(2);
  std::size_t points = 0, turn = 0;
  for (auto _ : state) {
    const RenderMesh& mesh = made.parts[turn++ % made.parts.size()].object.mesh;
    Rigid3 pose =
        Turn(Eigen::Vector3d(random.Normal(), random.Normal(), random.Normal()).normalized(),
             random.Uniform(0.0, 2.0 * M_PI));
    pose.t = Eigen::Vector3d(0.0, 0.0, 0.25) - pose.R * mesh.center.cast<double>();
    points += FindVisibleEdges(mesh, camera, pose, options).points.size();
  }
  state.counters["points"] = static_cast<double>(points) / static_cast<double>(turn);
}
BENCHMARK(BM_FindVisibleEdges)->Arg(110)->Arg(200)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
