// How long it takes from a cancellation until the processor is free: cancels recognition,
// enrolment, loading and verification at random moments.
//
//   cancel_report CATALOG.db DATASET SPLIT [--scenes 1,2] [--tries 200] [--seed 1] [--where MS]
//   cancel_report CATALOG.db DATASET SPLIT [--scenes 1,2] --looks MS
//
// CATALOG.db as horopterd left it, of the data set's objects; no server may have it open. Wall time
// is until the last thread is done, processor time that of all threads from the cancellation on,
// which other programs on the machine do not change. --where prints the stack of a thread that is
// still at work so many milliseconds after the cancellation (addresses for addr2line).
//
// --large adds one image as large as a server takes.
//
// --looks cancels nothing: it measures the processor time of a thread between two looks at the stop
// flag, and lists those above MS with the stack of the later look.
#include <execinfo.h>
#include <pthread.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <mutex>
#include <random>
#include <sstream>
#include <thread>

#include "client/bop_dataset.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"
#include "server/pipeline/process_cores.h"
#include "server/service/catalog_store.h"
#include "server/service/convert.h"
#include "tests/support/look_clock.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

double CpuMs() {
  timespec now = {};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

double MsSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

void PrintStack(int) {
  void* frames[40];
  const int count = ::backtrace(frames, 40);
  ::backtrace_symbols_fd(frames, count, STDERR_FILENO);
}

struct Sample {
  bool cancelled = false;  // false: it was done before
  double wall_ms = 0.0, cpu_ms = 0.0;
};

using Work = std::function<absl::Status(const StopRequested&)>;

// Cancels the work after so long.
Sample CancelAfter(const Work& work, double after_ms, double where_ms) {
  std::atomic<bool> stop{false};
  std::mutex mutex;
  std::condition_variable done;
  bool finished = false;
  absl::Status status;
  std::thread thread([&] {
    const StopRequested asked = [&] { return stop.load(); };
    absl::Status result = CatchExceptions([&] { return work(asked); });
    const std::lock_guard lock(mutex);
    status = std::move(result);
    finished = true;
    done.notify_one();
  });
  Sample sample;
  {
    std::unique_lock lock(mutex);
    const auto is_done = [&] { return finished; };
    const std::chrono::duration<double, std::milli> after(after_ms);
    if (!done.wait_for(lock, after, is_done)) {
      const auto start = Clock::now();
      const double cpu = CpuMs();
      stop = true;
      const std::chrono::duration<double, std::milli> patience(where_ms);
      if (where_ms > 0 && !done.wait_for(lock, patience, is_done)) {
        ::pthread_kill(thread.native_handle(), SIGUSR2);
      }
      done.wait(lock, is_done);
      sample = {true, MsSince(start), CpuMs() - cpu};
    }
  }
  thread.join();
  if (!sample.cancelled && !status.ok()) {
    std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  }
  return sample;
}

double At(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(share * static_cast<double>(values.size() - 1) + 0.5)];
}

void ReportLooks(const char* name, const std::vector<Work>& works, double above_ms) {
  LookClock clock(above_ms, [](double gap_ms) {
    std::fprintf(stderr, "%.0f ms without a look before:\n", gap_ms);
    PrintStack(0);
  });
  const StopRequested look = [&clock] { return clock(); };
  for (size_t i = 0; i < works.size(); ++i) {
    clock.Next();
    look();
    const absl::Status status = CatchExceptions([&] { return works[i](look); });
    look();
    if (!status.ok()) std::fprintf(stderr, "%s: %s\n", name, status.ToString().c_str());
  }
  std::printf("| %s | %zu | %lld | %.1f |\n",
              name,
              works.size(),
              static_cast<long long>(clock.looks()),
              clock.longest_ms());
  std::fflush(stdout);
}

// One row: the work cancelled `tries` times between its begin and the end of an undisturbed run.
void Report(const char* name,
            const std::vector<Work>& works,
            int tries,
            double where_ms,
            std::mt19937_64& random) {
  if (works.empty()) return;
  std::vector<double> whole_ms;
  for (const Work& work : works) {
    const auto start = Clock::now();
    const absl::Status status = CatchExceptions([&] { return work([] { return false; }); });
    if (!status.ok()) std::fprintf(stderr, "%s: %s\n", name, status.ToString().c_str());
    whole_ms.push_back(MsSince(start));
  }
  std::vector<double> wall, cpu;
  for (int i = 0; i < tries; ++i) {
    const size_t which = random() % works.size();
    const double after = std::uniform_real_distribution<double>(0.0, whole_ms[which])(random);
    const Sample sample = CancelAfter(works[which], after, where_ms);
    if (!sample.cancelled) continue;
    wall.push_back(sample.wall_ms);
    cpu.push_back(sample.cpu_ms);
    if (where_ms > 0 && sample.wall_ms > where_ms) {
      std::fprintf(
          stderr, "%s: %.0f ms after the cancellation at %.0f ms\n", name, sample.wall_ms, after);
    }
  }
  std::printf("| %s | %.0f | %zu | %.1f / %.1f / %.1f | %.1f / %.1f / %.1f |\n",
              name,
              At(whole_ms, 0.5),
              wall.size(),
              At(wall, 0.5),
              At(wall, 0.99),
              At(wall, 1.0),
              At(cpu, 0.5),
              At(cpu, 0.99),
              At(cpu, 1.0));
  std::fflush(stdout);
}

// The largest image that a server takes by itself, dense with edges.
Work LargeImage(const CatalogSnapshot& catalog) {
  constexpr int kWidth = 8160, kHeight = 6120, kBlock = 24;
  v1::RecognizeSceneRequest request;
  v1::RawFrame* frame = request.add_images()->mutable_raw();
  frame->set_format(v1::RawFrame::PIXEL_FORMAT_BGR8);
  frame->set_width_px(kWidth);
  frame->set_height_px(kHeight);
  std::mt19937_64 random(1);
  std::string row(size_t{3} * kWidth, '\0'), pixels;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; y % kBlock == 0 && x < 3 * kWidth; x += 3 * kBlock) {
      std::fill_n(row.begin() + x, 3 * kBlock, static_cast<char>(random()));
    }
    pixels += row;
  }
  frame->set_data(std::move(pixels));
  return [request = std::move(request), &catalog](const StopRequested& stop) {
    const StopScope scope(stop);
    const auto scene_request = SceneRequestFromProto(request, ImageLimits(), 2, stop);
    if (!scene_request.ok()) return scene_request.status();
    return RecognizeScene(*scene_request, catalog, PipelineOptions(), stop).status();
  };
}

std::vector<Work> Recognitions(const BopDataset& dataset,
                               const std::string& split,
                               const std::vector<int>& scenes,
                               const CatalogSnapshot& catalog) {
  std::vector<Work> works;
  std::vector<int> wanted = scenes;
  if (wanted.empty()) wanted = ListBopScenes(dataset.folder, split).value_or(scenes);
  for (const int id : wanted) {
    const auto scene = ReadBopScene(dataset.folder, split, id);
    if (!scene.ok()) continue;
    v1::RecognizeSceneRequest request;
    for (const BopImage& image : scene->images) {
      std::ostringstream bytes;
      bytes << std::ifstream(image.path, std::ios::binary).rdbuf();
      request.add_images()->set_content(bytes.str());
    }
    works.push_back([request = std::move(request), &catalog](const StopRequested& stop) {
      const StopScope scope(stop);
      const auto scene_request = SceneRequestFromProto(request, ImageLimits(), 2, stop);
      if (!scene_request.ok()) return scene_request.status();
      return RecognizeScene(*scene_request, catalog, PipelineOptions(), stop).status();
    });
  }
  return works;
}

int Main(int argc, char** argv) {
  CLI::App app("cancel_report");
  std::string file, folder, split;
  std::vector<int> scenes;
  int tries = 200;
  uint64_t seed = 1;
  double where_ms = 0.0, looks_ms = 0.0;
  bool large = false;
  app.add_option("CATALOG", file)->required();
  app.add_option("DATASET", folder)->required();
  app.add_option("SPLIT", split)->required();
  app.add_option("--scenes", scenes)->delimiter(',');
  app.add_option("--tries", tries);
  app.add_option("--seed", seed);
  app.add_option("--where", where_ms);
  app.add_option("--looks", looks_ms);
  app.add_flag("--large", large);
  CLI11_PARSE(app, argc, argv);
  ::signal(SIGUSR2, PrintStack);
  SetProcessCores(2);
  std::mt19937_64 random(seed);
  const auto dataset = ReadBopDataset(folder);
  if (!dataset.ok()) return std::fprintf(stderr, "%s\n", dataset.status().ToString().c_str()), 1;
  const auto open = [&](const StopRequested& stop) {
    return CatalogStore::Load(
        *Catalog::Open(file), CatalogPreparer(), {.threads = 2, .stop = stop});
  };
  if (looks_ms <= 0.0) std::printf("seed %llu\n", static_cast<unsigned long long>(seed));
  std::printf(looks_ms > 0.0 ? "| work | of them | looks | longest ms between two |\n"
                               "|---|---|---|---|\n"
                             : "| work | whole, ms | cancelled | wall ms p50 / p99 / most | CPU ms "
                               "|\n|---|---|---|---|---|\n");
  const auto report = [&](const char* name, const std::vector<Work>& works) {
    looks_ms > 0.0 ? ReportLooks(name, works, looks_ms)
                   : Report(name, works, tries, where_ms, random);
  };
  report("catalog load", {[&](const StopRequested& stop) { return open(stop).status(); }});
  auto store = open({});
  if (!store.ok()) return std::fprintf(stderr, "%s\n", store.status().ToString().c_str()), 1;
  const auto published = (*store)->Published();
  report("verification",
         {[&](const StopRequested& stop) { return (*store)->catalog().Verify(stop).status(); }});
  std::vector<Work> enrolments;
  for (const auto& object : published->snapshot.objects) {
    enrolments.push_back([&, model = (*store)->ModelOf(*object)](const StopRequested& stop) {
      const StopScope scope(stop);
      return CatalogPreparer().prepare(model).status();
    });
  }
  if (enrolments.size() > 5) enrolments.resize(5);
  report("enrolment", enrolments);
  if (large) report("recognition of 50 million pixels", {LargeImage(published->snapshot)});
  report("recognition", Recognitions(*dataset, split, scenes, published->snapshot));
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
