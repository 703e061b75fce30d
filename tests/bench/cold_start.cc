// Start of a server on a large catalog, until objects that a request names can be searched for.
//
//   cold_start CATALOG [CANDIDATE...] [--cache FOLDER]
//     CATALOG: a file, which is opened as a server opens it, or the address of a database. Prints
//     the time and the resident memory after opening, after loading, with the candidates at hand,
//     with the segments of all keys, and of a search for look-alikes of the first candidate.
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include "db/catalog.h"
#include "server/pipeline/select_objects.h"
#include "server/service/catalog_store.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

class Report {
 public:
  void Line(const std::string& what) const {
    std::printf("%-60s %7.2f s  %6.2f s CPU  %6.0f MB\n",
                what.c_str(),
                std::chrono::duration<double>(Clock::now() - start_).count(),
                static_cast<double>(std::clock()) / CLOCKS_PER_SEC,
                ResidentMb());
    std::fflush(stdout);
  }

 private:
  static double ResidentMb() {
    std::ifstream statm("/proc/self/statm");
    double pages = 0.0;
    statm >> pages >> pages;
    return pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
  }
  const Clock::time_point start_ = Clock::now();
};

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return 1;
}

int Main(int argc, char** argv) {
  std::vector<std::string> words(argv + 1, argv + argc), candidates;
  StoreOptions options{.threads = 2, .prepare_beside = true};
  for (size_t i = 1; i < words.size(); ++i) {
    if (words[i] == "--cache" && i + 1 < words.size()) {
      options.derived_cache = words[++i];
    } else {
      candidates.push_back(words[i]);
    }
  }
  if (words.empty()) {
    std::fprintf(stderr, "usage: cold_start CATALOG [CANDIDATE...] [--cache FOLDER]\n");
    return 2;
  }
  const Report report;
  auto catalog = Catalog::Open(words[0]);
  if (!catalog.ok()) return Fail(catalog.status());
  report.Line("opened and checked");
  auto loaded = CatalogStore::Load(*std::move(catalog), CatalogPreparer(), options);
  if (!loaded.ok()) return Fail(loaded.status());
  CatalogStore& store = **loaded;
  const auto published = store.Published();
  report.Line("loaded " + std::to_string(published->ids.size()) + " objects, " +
              std::to_string(published->pending.size()) + " to be prepared");
  if (candidates.empty()) return 0;
  SceneRequest request;
  request.candidates = candidates;
  const auto selected = SelectObjects(request, published->snapshot, 5000);
  if (!selected.ok()) return Fail(selected.status());
  report.Line(std::to_string(selected->objects.size()) + " candidates at hand");
  for (const char* which : {"first", "second"}) {
    const auto alike = store.LookAlikeCandidates(*published, candidates[0], 500);
    if (!alike.ok()) return Fail(alike.status());
    report.Line(std::string(which) + " look-alikes, " + std::to_string(alike->size()));
  }
  const KeySegments::Figures figures = store.segment_figures();
  std::printf(
      "%d segments, %d in files, %.1f MB, %lld shapes, %d loose; cache: %lld hits, %lld "
      "misses\n",
      figures.segments,
      figures.files,
      static_cast<double>(figures.bytes) / 1e6,
      static_cast<long long>(figures.members),
      figures.loose,
      static_cast<long long>(store.cache_figures().hits),
      static_cast<long long>(store.cache_figures().misses));
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
