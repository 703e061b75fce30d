// The features stage beside OpenCV's detectors on the same image in the same run.
//
// The image is rendered: 60 random polygons with noise sigma 2. HOROPTER_BENCH_IMAGE names another
// one. One thread.
#include <benchmark/benchmark.h>

#include <cstdlib>
#include <fstream>
#include <opencv2/core/utility.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/ximgproc.hpp>
#include <string>

#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/edge_linking.h"
#include "server/vision/features/feature_graph.h"
#include "server/vision/features/features.h"
#include "tests/server/vision/features/rendered_shapes.h"

namespace horopter {
namespace {

cv::Mat RenderClutter(int width, int height) {
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  cv::Mat image(height, width, CV_8UC3, cv::Scalar(90, 95, 100));
  for (int k = 0; k < 60; ++k) {
    const cv::Point2d center(width * u(rng), height * u(rng));
    std::vector<cv::Point> polygon;
    for (int v = 0; v < 5; ++v) {
      const double angle = 2.0 * CV_PI * (v + u(rng)) / 5.0;
      const double radius = height * (0.03 + 0.1 * u(rng));
      polygon.emplace_back(center.x + radius * std::cos(angle),
                           center.y + radius * std::sin(angle));
    }
    cv::fillPoly(image,
                 std::vector<std::vector<cv::Point>>{polygon},
                 cv::Scalar(255 * u(rng), 255 * u(rng), 255 * u(rng)),
                 cv::LINE_AA);
  }
  cv::GaussianBlur(image, image, cv::Size(), 0.7);
  cv::Mat noise(image.size(), CV_16SC3), wide;
  cv::theRNG().state = 1;
  cv::randn(noise, cv::Scalar::all(0), cv::Scalar::all(2));
  image.convertTo(wide, CV_16SC3);
  wide += noise;
  wide.convertTo(image, CV_8UC3);
  return image;
}

cv::Mat BenchImage(int width, int height) {
  cv::setNumThreads(1);
  const char* file = std::getenv("HOROPTER_BENCH_IMAGE");
  cv::Mat image = file ? cv::imread(file, cv::IMREAD_COLOR) : cv::Mat();
  if (image.empty()) {
    return RenderClutter(width, height);
  }
  cv::resize(image, image, cv::Size(width, height), 0, 0, cv::INTER_AREA);
  return image;
}

cv::Mat Grey(const cv::Mat& image) {
  cv::Mat grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

void BM_DetectFeaturesColour(benchmark::State& state) {
  const cv::Mat image =
      BenchImage(static_cast<int>(state.range(0)), static_cast<int>(state.range(0) * 3 / 4));
  for (auto _ : state) {
    const auto features = DetectFeatures(image, {});
    state.counters["segments"] = static_cast<double>(features->segments.size());
    state.counters["junctions"] = static_cast<double>(features->junctions.size());
  }
}

void BM_DetectFeaturesGrey(benchmark::State& state) {
  const cv::Mat image =
      Grey(BenchImage(static_cast<int>(state.range(0)), static_cast<int>(state.range(0) * 3 / 4)));
  for (auto _ : state) {
    const auto features = DetectFeatures(image, {});
    state.counters["segments"] = static_cast<double>(features->segments.size());
    state.counters["junctions"] = static_cast<double>(features->junctions.size());
  }
}

// Beside BM_OpenCvCanny, whose result is a bitmap: here ordered sub-pixel chains.
void BM_EdgeChainsGrey(benchmark::State& state) {
  const cv::Mat image = Grey(BenchImage(640, 480));
  for (auto _ : state) {
    size_t points = 0;
    for (const GradientField& field : MakeGradientFields(image, GradientOptions())) {
      for (const EdgeChain& chain : LinkEdges(field, LinkingOptions())) {
        points += chain.points.size();
      }
    }
    state.counters["points"] = static_cast<double>(points);
  }
}

void BM_FeaturesAndGraphGrey(benchmark::State& state) {
  const cv::Mat image = Grey(BenchImage(640, 480));
  for (auto _ : state) {
    const auto features = DetectFeatures(image, {});
    const FeatureGraph graph = BuildFeatureGraph(*features, FeatureGraphOptions());
    state.counters["edges"] = static_cast<double>(graph.EdgeCount());
  }
}

void BM_FeatureGraph(benchmark::State& state) {
  const auto features = DetectFeatures(
      BenchImage(static_cast<int>(state.range(0)), static_cast<int>(state.range(0) * 3 / 4)), {});
  for (auto _ : state) {
    const FeatureGraph graph = BuildFeatureGraph(*features, FeatureGraphOptions());
    state.counters["nodes"] = graph.NodeCount();
    state.counters["bytes"] = static_cast<double>(graph.Bytes());
  }
}

double PeakBytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) return 1024.0 * std::atof(line.c_str() + 6);
  }
  return 0.0;
}

// Growth of the resident peak over what is there before the call.
void BM_MemoryColour4096(benchmark::State& state) {
  const cv::Mat image = BenchImage(4096, 3072);
  for (auto _ : state) {
    std::ofstream("/proc/self/clear_refs") << "5";  // the peak starts from here
    const double before = PeakBytes();
    const auto features = DetectFeatures(image, {});
    benchmark::DoNotOptimize(features);
    state.counters["bytes_per_pixel"] = (PeakBytes() - before) / static_cast<double>(image.total());
  }
}

void BM_DetectFeaturesPureNoise(benchmark::State& state) {
  cv::Mat image(480, 640, CV_8UC3);
  cv::theRNG().state = 2;
  cv::randu(image, cv::Scalar::all(0), cv::Scalar::all(255));
  for (auto _ : state) {
    const auto features = DetectFeatures(image, {});
    state.counters["segments"] = static_cast<double>(features->segments.size());
  }
}

void BM_OpenCvEdgeDrawing(benchmark::State& state) {
  const cv::Mat grey = Grey(BenchImage(640, 480));
  for (auto _ : state) {
    const auto detector = cv::ximgproc::createEdgeDrawing();
    detector->detectEdges(grey);
    std::vector<cv::Vec4f> lines;
    std::vector<cv::Vec6d> ellipses;
    detector->detectLines(lines);
    detector->detectEllipses(ellipses);
    state.counters["segments"] = static_cast<double>(lines.size());
  }
}

void BM_OpenCvLineSegmentDetector(benchmark::State& state) {
  const cv::Mat grey = Grey(BenchImage(640, 480));
  for (auto _ : state) {
    std::vector<cv::Vec4f> lines;
    cv::createLineSegmentDetector()->detect(grey, lines);
    state.counters["segments"] = static_cast<double>(lines.size());
  }
}

void BM_OpenCvFastLineDetector(benchmark::State& state) {
  const cv::Mat grey = Grey(BenchImage(640, 480));
  for (auto _ : state) {
    std::vector<cv::Vec4f> lines;
    cv::ximgproc::createFastLineDetector()->detect(grey, lines);
    state.counters["segments"] = static_cast<double>(lines.size());
  }
}

void BM_OpenCvCanny(benchmark::State& state) {
  const cv::Mat grey = Grey(BenchImage(640, 480));
  for (auto _ : state) {
    cv::Mat edges;
    cv::Canny(grey, edges, 40, 100);
    benchmark::DoNotOptimize(edges.data);
  }
}

BENCHMARK(BM_MemoryColour4096)->Unit(benchmark::kMillisecond)->Iterations(1);
BENCHMARK(BM_DetectFeaturesColour)
    ->Arg(640)
    ->Arg(1280)
    ->Arg(2560)
    ->Arg(4096)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BM_DetectFeaturesGrey)->Arg(640)->Arg(4096)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_EdgeChainsGrey)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_FeaturesAndGraphGrey)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_FeatureGraph)->Arg(640)->Arg(2560)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_DetectFeaturesPureNoise)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OpenCvEdgeDrawing)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OpenCvLineSegmentDetector)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OpenCvFastLineDetector)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OpenCvCanny)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
