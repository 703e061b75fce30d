// The X-tree beside its peers: uniform, clustered and our own keys, d = 2, 3, 6, 8, 16, n = 10^4 to
// 10^6, point, box, 10-NN and ellipsoid queries. Names are data/d/n/query/peer, so that
// --benchmark_filter picks any part; "per_scan" is the CPU time as a share of the linear scan's in
// the same run. A peer whose answers differ from the X-tree's is reported as an error.
//
//   index_benchmark [--keys FILE]... [--table] [benchmark flags]
//     --keys    invariant keys, written by key_data
//     --table   afterwards one line per query with all peers, as in results.md
#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "tests/bench/index_peers.h"

namespace horopter {
namespace {

using MakePeer = IndexPeer (*)(const IndexData&);
// The scan goes first: the others are put into relation to it.
constexpr MakePeer kPeers[] = {MakeEigenScan,
                               MakeXTreePeer,
                               MakeBoostPacked,
                               MakeBoostRStar,
                               MakeNanoflann,
                               MakeLibspatialindex};
constexpr const char* kPeerNames[] = {
    "scan", "x-tree", "boost_packed", "boost_rstar", "nanoflann", "libspatialindex"};
constexpr int kPeerCount = 6;
constexpr int kXTree = 1;
// Dynamic insertion of more takes minutes.
constexpr int kLargestRStar = 100000;

struct DataChoice {
  std::string name;  // or the path of a file of keys
  int dimensions = 0;
  int count = 0;
  bool file = false;
  bool boxes = false;
};

// Data and peers of one choice at a time: benchmarks run in the order in which they are registered.
struct Bench {
  std::string key;
  IndexData data;
  std::array<std::optional<IndexPeer>, kPeerCount> peers;
};

Bench& BenchFor(const DataChoice& choice) {
  static std::unique_ptr<Bench> bench;
  const std::string key =
      choice.name + std::to_string(choice.dimensions) + "/" + std::to_string(choice.count);
  if (bench == nullptr || bench->key != key) {
    bench = std::make_unique<Bench>();
    bench->key = key;
    bench->data = choice.file ? ReadIndexKeys(choice.name)
                              : GenerateIndexData(choice.name, choice.dimensions, choice.count, 1);
    AddIndexQueries(bench->data, 200, 17);
  }
  return *bench;
}

const IndexPeer& PeerOf(Bench& bench, int peer) {
  if (!bench.peers[peer]) bench.peers[peer] = kPeers[peer](bench.data);
  return *bench.peers[peer];
}

std::vector<int64_t> Answer(const IndexPeer& peer, const IndexQuery& query, QueryKind kind) {
  std::vector<int64_t> found;
  peer.run(query, kind, found);
  std::sort(found.begin(), found.end());
  return found;
}

// Many catalog keys are equal: which of equally distant neighbours is returned is each peer's
// choice, the distances are not.
bool Agree(Bench& bench, const IndexPeer& a, const IndexPeer& b, QueryKind kind) {
  const size_t checked = std::min<size_t>(bench.data.queries.size(), 20);
  for (size_t q = 0; q < checked; ++q) {
    const IndexQuery& query = bench.data.queries[q];
    const std::vector<int64_t> x = Answer(a, query, kind), y = Answer(b, query, kind);
    if (x == y) continue;
    if (kind != QueryKind::kNeighbors || y.size() < x.size()) return false;
    const auto farthest = [&](const std::vector<int64_t>& ids) {
      double most = 0.0;
      for (const int64_t id : ids) {
        double squared = 0.0;
        for (int d = 0; d < bench.data.dimensions; ++d) {
          const double step = bench.data.Row(static_cast<int>(id))[d] - query.center[d];
          squared += step * step;
        }
        most = std::max(most, squared);
      }
      return most;
    };
    if (std::abs(farthest(x) - farthest(y)) > 1e-12 * (1.0 + farthest(x))) return false;
  }
  return true;
}

// Of this thread: other programs on the machine do not count.
double CpuSeconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

std::map<std::string, std::array<double, kPeerCount>>& Times() {
  static std::map<std::string, std::array<double, kPeerCount>> times;
  return times;
}
std::vector<std::string>& TableOrder() {
  static std::vector<std::string> order;
  return order;
}

void RunQueries(benchmark::State& state,
                const DataChoice& choice,
                const std::string& row,
                QueryKind kind,
                int number) {
  Bench& bench = BenchFor(choice);
  const IndexPeer& peer = PeerOf(bench, number);
  if (number != kXTree && !Agree(bench, PeerOf(bench, kXTree), peer, kind)) {
    state.SkipWithError("answers differ from the X-tree's");
    return;
  }
  std::vector<int64_t> found;
  size_t next = 0, answers = 0;
  const double start = CpuSeconds();
  for (auto _ : state) {
    found.clear();
    peer.run(bench.data.queries[next], kind, found);
    benchmark::DoNotOptimize(found.data());
    answers += found.size();
    next = (next + 1) % bench.data.queries.size();
  }
  const double seconds = CpuSeconds() - start;
  const double iterations = static_cast<double>(state.iterations());
  const double us = 1e6 * seconds / iterations;
  auto [at, is_new] = Times().try_emplace(row);
  if (is_new) TableOrder().push_back(row);
  at->second[number] = us;
  state.counters["answers"] = static_cast<double>(answers) / iterations;
  if (at->second[0] > 0.0) state.counters["per_scan"] = us / at->second[0];
}

void Register(const DataChoice& choice) {
  const std::string data =
      choice.file ? choice.name.substr(choice.name.rfind('/') + 1) : choice.name;
  for (const QueryKind kind : kQueryKinds) {
    if (choice.boxes && kind != QueryKind::kPoint && kind != QueryKind::kBox) continue;
    const std::string row = data + "/" + std::to_string(choice.dimensions) + "/" +
                            std::to_string(choice.count) + "/" + NameOf(kind);
    for (int peer = 0; peer < kPeerCount; ++peer) {
      if (kPeers[peer] == MakeBoostRStar && choice.count > kLargestRStar && !choice.file) continue;
      if (kPeers[peer] == MakeNanoflann && choice.boxes) continue;
      benchmark::RegisterBenchmark(
          (row + "/" + kPeerNames[peer]).c_str(),
          [=](benchmark::State& state) { RunQueries(state, choice, row, kind, peer); })
          ->Unit(benchmark::kMicrosecond);
    }
  }
}

void PrintTable() {
  std::printf("\n| data/d/n/query, us |");
  for (const char* name : kPeerNames) std::printf(" %s |", name);
  std::printf(" fastest |\n|---|---|---|---|---|---|---|---|\n");
  for (const std::string& row : TableOrder()) {
    const std::array<double, kPeerCount>& times = Times()[row];
    int best = -1;
    std::printf("| %s |", row.c_str());
    for (int p = 0; p < kPeerCount; ++p) {
      if (times[p] > 0.0 && (best < 0 || times[p] < times[best])) best = p;
      times[p] > 0.0 ? std::printf(" %.3g |", times[p]) : std::printf(" |");
    }
    std::printf(" %s |\n", best < 0 ? "" : kPeerNames[best]);
  }
}

int Main(int argc, char** argv) {
  bool table = false;
  std::vector<char*> rest{argv[0]};
  std::vector<std::string> keys;
  for (int i = 1; i < argc; ++i) {
    const std::string arg = argv[i];
    if (arg == "--table") {
      table = true;
    } else if (arg == "--keys" && i + 1 < argc) {
      keys.push_back(argv[++i]);
    } else {
      rest.push_back(argv[i]);
    }
  }
  for (const std::string& path : keys) {
    const IndexData data = ReadIndexKeys(path);
    if (data.count == 0 || !IsComparedDimension(data.dimensions) ||
        data.boxes() != (data.dimensions == 4)) {
      std::fprintf(stderr, "%s: no keys of a dimension that is compared\n", path.c_str());
      return 1;
    }
    Register({path, data.dimensions, data.count, true, data.boxes()});
  }
  for (const char* name : {"uniform", "clustered"}) {
    for (const int d : {2, 3, 6, 8, 16}) {
      for (const int n : {10000, 100000, 1000000}) Register({name, d, n, false});
    }
  }
  int count = static_cast<int>(rest.size());
  benchmark::Initialize(&count, rest.data());
  if (benchmark::ReportUnrecognizedArguments(count, rest.data())) return 2;
  benchmark::RunSpecifiedBenchmarks();
  if (table) PrintTable();
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
