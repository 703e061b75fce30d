// Start of a catalog and queries of its index while objects are enrolled.
//
//   catalog_report CATALOG.db [SECONDS]
//     Works on a copy beside the file. Prints the time of opening and loading, memory, the CPU time
//     of queries, and the latency of queries with and without a writer, in turn, SECONDS each
//     (default 3; 0: not; negative: the start alone): ten-nearest-sized ellipsoids around keys of
//     the catalog, as recognition asks them.
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "db/catalog.h"
#include "server/service/catalog_store.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

double Seconds(Clock::time_point since) {
  return std::chrono::duration<double>(Clock::now() - since).count();
}

double ProcessCpuSeconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

struct Latencies {
  std::vector<double> us;
  double At(double share) {
    const auto at = us.begin() + static_cast<long>(share * static_cast<double>(us.size() - 1));
    std::nth_element(us.begin(), at, us.end());
    return *at;
  }
};

// Resident memory of this process, MB.
double ResidentMb() {
  std::ifstream statm("/proc/self/statm");
  double pages = 0.0;
  statm >> pages >> pages;
  return pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
}

double ThreadCpuSeconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Keys of the catalog's objects as a query with the uncertainty of a good image has them.
std::vector<InvariantKey> QueriesOf(const CatalogSnapshot& snapshot, int count) {
  constexpr int kObjects = 50;  // few, as of a large catalog each must be read and prepared
  std::mt19937 rng(1);
  std::vector<InvariantKey> queries;
  const ObjectPreparer preparer = CatalogPreparer();
  for (int k = 0; k < kObjects; ++k) {
    const auto object = ObjectAt(snapshot, static_cast<int>(rng() % ObjectCount(snapshot)));
    if (!object.ok()) continue;
    const ObjectKeys& keys = preparer.keys_of(**object);
    for (int q = 0; q < count / kObjects; ++q) {
      if (keys.chains.empty()) continue;
      const auto& values = keys.chains[rng() % keys.chains.size()].values;
      queries.push_back({Eigen::Map<const Eigen::VectorXf>(values.data(), 5).cast<double>(),
                         4e-4 * Eigen::MatrixXd::Identity(5, 5)});
    }
  }
  return queries;
}

// CPU time and answers of each kind of query, for comparing catalogs of different sizes.
void PrintCosts(const CatalogSnapshot& snapshot, const std::vector<InvariantKey>& queries) {
  constexpr double kSeconds =
      2.0;  // each kind: several rounds of cheap queries, a part of dear ones
  const auto measure = [&](const char* name, const std::vector<InvariantKey>& keys, auto find) {
    if (keys.empty()) return;
    std::size_t hits = 0, asked = 0;
    for (std::size_t q = 0; q < keys.size() && q < 100; ++q) find(keys[q]);
    const double start = ThreadCpuSeconds();
    while (ThreadCpuSeconds() - start < kSeconds) hits += find(keys[asked++ % keys.size()]);
    const double n = static_cast<double>(asked);
    const double us = 1e6 * (ThreadCpuSeconds() - start) / n;
    std::printf("%s: %.2f us CPU a query, %.1f answers\n", name, us, static_cast<double>(hits) / n);
  };
  measure("chains, small gate", queries, [&](const InvariantKey& key) {
    InvariantKey sharp = key;
    sharp.covariance *= 1e-4;
    return snapshot.keys.Find(KeyTable::kChains, sharp, 11.07)->size();
  });
  measure("chains", queries, [&](const InvariantKey& key) {
    return snapshot.keys.Find(KeyTable::kChains, key, 11.07)->size();
  });
}

void RunQueries(const CatalogStore& store,
                const std::vector<InvariantKey>& queries,
                double seconds,
                Latencies& latencies,
                int64_t& hits) {
  constexpr double kGate = 11.07;  // 95 % of chi-square with five degrees of freedom
  const Clock::time_point begin = Clock::now();
  for (size_t q = 0; Seconds(begin) < seconds; q = (q + 1) % queries.size()) {
    const Clock::time_point start = Clock::now();
    const auto published = store.Published();
    const auto found = published->snapshot.keys.Find(KeyTable::kChains, queries[q], kGate);
    latencies.us.push_back(1e6 * Seconds(start));
    if (found.ok()) hits += static_cast<int64_t>(found->size());
  }
}

// Enrols and removes the catalog's own objects under new names until it is told to stop.
int EnrolUntil(CatalogStore& store, const std::vector<std::string>& ids, std::atomic<bool>& stop) {
  int writes = 0;
  for (size_t i = 0; !stop; i = (i + 1) % ids.size()) {
    auto record = store.catalog().GetObject(ids[i]);
    if (!record.ok()) return -1;
    record->model.id = "benchmark_object";
    record->source = {};
    if (!store.Create(*record).ok() || !store.Delete(record->model.id).ok()) return -1;
    writes += 2;
  }
  return writes;
}

int RemoveCopy(const std::string& path) {
  for (const char* suffix : {"", "-wal", "-shm"}) std::filesystem::remove(path + suffix);
  return 0;
}

int Main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: catalog_report CATALOG.db [SECONDS]\n");
    return 2;
  }
  const double seconds = argc > 2 ? std::atof(argv[2]) : 3.0;
  const std::string path = std::string(argv[1]) + ".report";
  std::filesystem::copy_file(argv[1], path, std::filesystem::copy_options::overwrite_existing);

  const Clock::time_point start = Clock::now();
  const double cpu = ProcessCpuSeconds();
  auto catalog = Catalog::Open(path);
  if (!catalog.ok()) {
    std::fprintf(stderr, "%s\n", std::string(catalog.status().message()).c_str());
    return 1;
  }
  const double opened = Seconds(start);
  auto loaded = CatalogStore::Load(*std::move(catalog), CatalogPreparer(), {.threads = 2});
  if (!loaded.ok() || (*loaded)->Published()->ids.empty()) return 1;
  CatalogStore& store = **loaded;
  const auto published = store.Published();
  std::printf(
      "%zu objects: opened and checked in %.2f s, all in %.2f s (%.2f s CPU); %d prepared\n",
      published->ids.size(),
      opened,
      Seconds(start),
      ProcessCpuSeconds() - cpu,
      store.load_report().prepared);
  std::printf("index: %lld keys, %.1f MB; resident memory %.0f MB\n",
              static_cast<long long>(published->snapshot.keys.size()),
              static_cast<double>(published->snapshot.keys.bytes()) / 1e6,
              ResidentMb());
  if (seconds < 0.0) return RemoveCopy(path);

  const std::vector<InvariantKey> queries = QueriesOf(published->snapshot, 2000);
  PrintCosts(published->snapshot, queries);
  if (seconds <= 0.0) return RemoveCopy(path);
  Latencies idle, busy;
  int64_t hits = 0;
  int writes = 0;
  constexpr int kRounds = 4;  // in turn, so that other load on the machine meets both
  for (int round = 0; round < kRounds; ++round) {
    RunQueries(store, queries, seconds, idle, hits);
    std::atomic<bool> stop = false;
    int done = 0;
    std::thread writer([&] { done = EnrolUntil(store, published->ids, stop); });
    RunQueries(store, queries, seconds, busy, hits);
    stop = true;
    writer.join();
    if (done < 0) return 1;
    writes += done;
  }
  std::printf("%d writes; %.1f hits a query\n",
              writes,
              static_cast<double>(hits) / static_cast<double>(idle.us.size() + busy.us.size()));
  for (const double share : {0.5, 0.99, 0.999}) {
    const double a = idle.At(share), b = busy.At(share);
    std::printf(
        "p%g: idle %.2f us, while enrolling %.2f us, ratio %.2f\n", 100 * share, a, b, b / a);
  }
  const absl::Status index = store.CheckIndex();
  std::printf("index %s\n", index.ok() ? "equals the objects" : index.ToString().c_str());
  RemoveCopy(path);
  return index.ok() ? 0 : 1;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
