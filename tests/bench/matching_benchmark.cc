// The supporting plane's homographies of several views beside OpenCV's full-size SIFT with MAGSAC
// on the same rendered images in the same run.
//
// The views are rendered: a faint texture (deviation 6 grey levels) seen from an arc, 17 degrees
// apart, 640x480, noise sigma 1. One thread each.
#include <benchmark/benchmark.h>

#include <Eigen/Dense>
#include <algorithm>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/features2d.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "server/vision/matching/plane_chain.h"
#include "server/vision/matching/plane_homography.h"
#include "server/vision/matching/plane_links.h"
#include "server/vision/matching/plane_patches.h"
#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

constexpr double kContrast = 6.0;
constexpr double kNoise = 1.0;
constexpr double kStepRad = 0.3;
constexpr double kRightPx = 2.0;

struct Views {
  SyntheticScene scene;
  std::vector<cv::Mat> images;
  std::vector<std::pair<int, int>> pairs;
};

Views Render(int count, double contrast) {
  cv::setNumThreads(1);
  SyntheticSceneOptions options;
  options.views = count;
  options.arc_rad = kStepRad * (count - 1);
  Views views{MakeSyntheticScene(options), {}, {}};
  const cv::Mat texture = PlaneTexture(1, contrast);
  for (int v = 0; v < count; ++v) {
    views.images.push_back(RenderPlane(views.scene, v, texture, kNoise));
    for (int u = 0; u < v; ++u) views.pairs.emplace_back(u, v);
  }
  return views;
}

// How many of the pairs of views that `planes` join are right, found one by one or through others.
void CountRight(const Views& views,
                const std::vector<PlaneHomography>& planes,
                benchmark::State* state) {
  const PlaneChain chain = ChainPlanes(planes, static_cast<int>(views.images.size()), 4.0);
  int right = 0;
  for (const auto& [a, b] : views.pairs) {
    if (chain.component[a] < 0 || chain.component[a] != chain.component[b]) continue;
    const Eigen::Matrix3d H = chain.view_from_plane[b] * chain.view_from_plane[a].inverse();
    right += WorstTransfer(views.scene, a, b, H) < kRightPx;
  }
  state->counters["pairs"] = static_cast<double>(views.pairs.size());
  state->counters["right"] = right;
}

void BM_FindPlanes(benchmark::State& state) {
  const Views views = Render(static_cast<int>(state.range(0)), kContrast);
  MatchingOptions options;
  options.threads = 1;
  std::vector<PlaneHomography> planes;
  for (auto _ : state) planes = FindPlanes(views.images, views.pairs, options, {}).planes;
  CountRight(views, planes, &state);
}

void BM_FindPlanesOfBlankViews(benchmark::State& state) {
  const Views views = Render(static_cast<int>(state.range(0)), 0.0);
  MatchingOptions options;
  options.threads = 1;
  std::vector<PlaneHomography> planes;
  for (auto _ : state) planes = FindPlanes(views.images, views.pairs, options, {}).planes;
  state.counters["pairs"] = static_cast<double>(views.pairs.size());
  state.counters["found"] = static_cast<double>(planes.size());
}

std::optional<PlaneHomography> OpenCvHomography(const std::vector<cv::KeyPoint>& points_a,
                                                const cv::Mat& descriptors_a,
                                                const std::vector<cv::KeyPoint>& points_b,
                                                const cv::Mat& descriptors_b) {
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(cv::NORM_L2).knnMatch(descriptors_a, descriptors_b, matches, 2);
  std::vector<cv::Point2f> a, b;
  for (const std::vector<cv::DMatch>& m : matches) {
    if (m.size() < 2 || m[0].distance > 0.87f * m[1].distance) continue;
    a.push_back(points_a[m[0].queryIdx].pt);
    b.push_back(points_b[m[0].trainIdx].pt);
  }
  if (a.size() < 8) return std::nullopt;
  cv::Mat mask;
  const cv::Mat H = cv::findHomography(a, b, cv::USAC_MAGSAC, 2.0, mask, 5000, 0.999);
  if (H.empty() || cv::countNonZero(mask) < 14) return std::nullopt;
  PlaneHomography plane;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) plane.b_from_a(r, c) = H.at<double>(r, c);
  }
  for (size_t i = 0; i < a.size(); ++i) {
    if (!mask.at<unsigned char>(static_cast<int>(i))) continue;
    plane.inliers_a.emplace_back(a[i].x, a[i].y);
    plane.inliers_b.emplace_back(b[i].x, b[i].y);
  }
  return plane;
}

// The same locally normalised images: on the raw ones OpenCV's default finds next to nothing.
void BM_OpenCvSiftMagsac(benchmark::State& state) {
  const Views views = Render(static_cast<int>(state.range(0)), kContrast);
  std::vector<PlaneHomography> planes;
  for (auto _ : state) {
    planes.clear();
    std::vector<std::vector<cv::KeyPoint>> points(views.images.size());
    std::vector<cv::Mat> descriptors(views.images.size());
    for (size_t v = 0; v < views.images.size(); ++v) {
      cv::SIFT::create(2000)->detectAndCompute(
          NormalizeLocalContrast(views.images[v]), {}, points[v], descriptors[v]);
    }
    for (const auto& [a, b] : views.pairs) {
      auto plane = OpenCvHomography(points[a], descriptors[a], points[b], descriptors[b]);
      if (!plane) continue;
      plane->view_a = a;
      plane->view_b = b;
      planes.push_back(*std::move(plane));
    }
  }
  CountRight(views, planes, &state);
}

void BM_NormalizeLocalContrast(benchmark::State& state) {
  const Views views = Render(1, kContrast);
  for (auto _ : state) benchmark::DoNotOptimize(NormalizeLocalContrast(views.images[0]));
}

void BM_PreparePatches(benchmark::State& state) {
  const Views views = Render(1, kContrast);
  for (auto _ : state) benchmark::DoNotOptimize(PreparePatches(views.images[0]));
}

void BM_QuickKeypoints(benchmark::State& state) {
  const PatchImage image = PreparePatches(Render(1, kContrast).images[0]);
  MatchingOptions options;
  options.max_keypoints = 500;
  options.sift_contrast = 0.02;
  for (auto _ : state) {
    const KeypointSet set = DetectPlaneKeypoints(image.normalized_quarter, 0.25, options);
    state.counters["keypoints"] = set.size();
  }
}

void BM_AlignPlane(benchmark::State& state) {
  const Views views = Render(2, kContrast);
  const PatchImage a = PreparePatches(views.images[0]), b = PreparePatches(views.images[1]);
  const Eigen::Matrix3d start = views.scene.PlaneHomographyOf(0, 1);
  AlignOptions options;
  options.start_is_aligned = state.range(0) != 0;
  for (auto _ : state) {
    const PlaneAlignment aligned = AlignPlane(a, b, start, options);
    state.counters["inliers"] = static_cast<double>(aligned.estimate.inliers.size());
  }
}

BENCHMARK(BM_FindPlanes)
    ->ArgName("views")
    ->Arg(2)
    ->Arg(4)
    ->Arg(6)
    ->Arg(8)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OpenCvSiftMagsac)
    ->ArgName("views")
    ->Arg(2)
    ->Arg(4)
    ->Arg(6)
    ->Arg(8)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BM_FindPlanesOfBlankViews)
    ->ArgName("views")
    ->Arg(2)
    ->Arg(6)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BM_NormalizeLocalContrast)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_PreparePatches)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_QuickKeypoints)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_AlignPlane)->ArgName("aligned")->Arg(0)->Arg(1)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
