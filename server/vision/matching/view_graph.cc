#include "server/vision/matching/view_graph.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <set>

#include "server/vision/features/image_strips.h"

namespace horopter {
namespace {

constexpr int kSketchWidth = 160;        // pixels
constexpr int kKeypoints = 200;          // of a sketch
constexpr double kContrast = 5.0;        // times MatchingOptions::sift_contrast: the strong ones
constexpr double kVoteRatio = 0.8;       // Lowe's
constexpr size_t kJunctions = 150;       // of an image's sketch; for time
constexpr float kMinSimilarity = 0.75f;  // of two junctions' low frequencies

std::vector<int> NearestOf(const std::vector<JunctionPatch::Code>& from,
                           const std::vector<JunctionPatch::Code>& to) {
  std::vector<int> nearest;
  for (const JunctionPatch::Code& a : from) {
    int best = -1;
    float highest = kMinSimilarity;
    for (size_t j = 0; j < to.size(); ++j) {
      const float similarity = a.dot(to[j]);
      if (similarity <= highest) continue;
      highest = similarity;
      best = static_cast<int>(j);
    }
    nearest.push_back(best);
  }
  return nearest;
}

}  // namespace

OverlapSketch SketchForOverlap(const cv::Mat& image,
                               std::span<const JunctionPatch> patches,
                               const MatchingOptions& options) {
  OverlapSketch sketch;
  const cv::Mat grey =
      image.channels() == 3 ? RecolourInStrips(image, cv::COLOR_BGR2GRAY, 1) : image;
  const double scale = std::min(1.0, static_cast<double>(kSketchWidth) / grey.cols);
  cv::Mat normalized = NormalizeLocalContrast(grey), small;
  const int factor = StripFactor(normalized.size(), scale);
  if (factor > 1) normalized = ShrinkInStrips(normalized, factor);
  cv::resize(normalized, small, cv::Size(), factor * scale, factor * scale, cv::INTER_AREA);
  MatchingOptions few = options;
  few.max_keypoints = kKeypoints;
  few.sift_contrast *= kContrast;
  sketch.keypoints = DetectPlaneKeypoints(small, scale, few);
  for (const JunctionPatch& patch : patches) {
    if (sketch.junctions.size() >= kJunctions) break;
    if (!patch.empty) sketch.junctions.push_back(patch.code);
  }
  return sketch;
}

int CountOverlapVotes(const OverlapSketch& a, const OverlapSketch& b) {
  int votes = static_cast<int>(MatchKeypoints(a.keypoints, b.keypoints, kVoteRatio).size());
  const std::vector<int> of_a = NearestOf(a.junctions, b.junctions);
  const std::vector<int> of_b = NearestOf(b.junctions, a.junctions);
  for (size_t i = 0; i < of_a.size(); ++i)
    votes += of_a[i] >= 0 && of_b[of_a[i]] == static_cast<int>(i);
  return votes;
}

std::vector<std::pair<int, int>> ChooseViewPairs(int views,
                                                 std::span<const ViewOverlap> overlaps,
                                                 const ViewGraphOptions& options) {
  std::vector<ViewOverlap> ranked;
  std::vector<int> index(static_cast<size_t>(views) * views, -1);
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      index[static_cast<size_t>(a) * views + b] = static_cast<int>(ranked.size());
      ranked.push_back({a, b, 0.0});
    }
  }
  for (const ViewOverlap& o : overlaps) {
    const auto [a, b] = std::minmax(o.view_a, o.view_b);
    if (a < 0 || b >= views || a == b || !std::isfinite(o.score)) continue;
    ranked[index[static_cast<size_t>(a) * views + b]].score = o.score;
  }
  std::stable_sort(ranked.begin(), ranked.end(), [](const ViewOverlap& x, const ViewOverlap& y) {
    return x.score != y.score ? x.score > y.score : x.view_b - x.view_a < y.view_b - y.view_a;
  });
  std::vector<int> root(views), partners(views, 0);
  std::iota(root.begin(), root.end(), 0);
  const auto root_of = [&](int v) {
    while (root[v] != v) v = root[v] = root[root[v]];
    return v;
  };
  std::set<std::pair<int, int>> chosen;
  for (const ViewOverlap& o : ranked) {
    const int a = root_of(o.view_a), b = root_of(o.view_b);
    if (a == b) continue;
    root[a] = b;
    chosen.insert({o.view_a, o.view_b});
  }
  // By rank: the first `best` of a view are its partners of highest score.
  for (const ViewOverlap& o : ranked) {
    const bool wanted = partners[o.view_a] < options.best || partners[o.view_b] < options.best;
    if (!wanted && views > options.all_up_to) continue;
    chosen.insert({o.view_a, o.view_b});
    ++partners[o.view_a];
    ++partners[o.view_b];
  }
  return {chosen.begin(), chosen.end()};
}

}  // namespace horopter
