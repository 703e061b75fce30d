#include "server/vision/matching/texture_matching.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "server/base/parallel_for.h"
#include "server/vision/features/image_strips.h"
#include "server/vision/matching/feature_tracks.h"
#include "server/vision/matching/keypoint_matching.h"
#include "server/vision/matching/usac.h"
#include "server/vision/matching/view_graph.h"

namespace horopter {
namespace {

// Of a keypoint's coordinates in the image it was found in.
constexpr double kKeypointSigmaPx = 0.6;
constexpr double kReferenceWidth = 640.0;  // of the image that thresholds are given for

// A matching so far: the points of a match in both images.
struct Correspondences {
  std::vector<std::pair<int, int>> matches;
  std::vector<cv::Point2d> a, b;
};

// Keypoints in pixels of the full image; `scale`: of the image that was searched.
KeypointSet DetectTexture(const cv::Mat& image, double scale, const TextureOptions& options) {
  cv::Mat grey = image.channels() == 3 ? RecolourInStrips(image, cv::COLOR_BGR2GRAY, 1) : image;
  if (scale < 1.0) cv::resize(grey, grey, cv::Size(), scale, scale, cv::INTER_AREA);
  KeypointSet set = DetectKeypoints(
      grey,
      {},
      {.max_keypoints = options.max_keypoints, .contrast = options.contrast, .root = true});
  const Eigen::Array2d factor(static_cast<double>(image.cols) / grey.cols,
                              static_cast<double>(image.rows) / grey.rows);
  for (Eigen::Vector2d& x : set.points) x = ((x.array() + 0.5) * factor - 0.5).matrix();
  return set;
}

cv::UsacParams Usac(double threshold_px, unsigned seed) {
  return Magsac(threshold_px, 0.9999, 10000, seed);
}

// One match of those whose keypoints lie at one place (a keypoint of two orientations).
Correspondences Distinct(const KeypointSet& a,
                         const KeypointSet& b,
                         const std::vector<std::pair<int, int>>& matches) {
  Correspondences out;
  const auto same = [](const cv::Point2d& p, const Eigen::Vector2d& q) {
    return std::abs(p.x - q.x()) < 0.5 && std::abs(p.y - q.y()) < 0.5;
  };
  for (const auto& [i, j] : matches) {
    bool repeated = false;
    for (size_t k = 0; k < out.matches.size() && !repeated; ++k)
      repeated = same(out.a[k], a.points[i]) || same(out.b[k], b.points[j]);
    if (repeated) continue;
    out.matches.emplace_back(i, j);
    out.a.emplace_back(a.points[i].x(), a.points[i].y());
    out.b.emplace_back(b.points[j].x(), b.points[j].y());
  }
  return out;
}

int CountMarked(const cv::Mat& mask) {
  return mask.empty() ? 0 : cv::countNonZero(mask);
}

// Without the matches that stand still, where enough others do not.
Correspondences Moving(const Correspondences& all, double still_px, int min_moving, int* still) {
  Correspondences moving;
  for (size_t k = 0; k < all.matches.size(); ++k) {
    if (std::hypot(all.a[k].x - all.b[k].x, all.a[k].y - all.b[k].y) <= still_px) continue;
    moving.matches.push_back(all.matches[k]);
    moving.a.push_back(all.a[k]);
    moving.b.push_back(all.b[k]);
  }
  const int n = static_cast<int>(all.matches.size() - moving.matches.size());
  *still = 0;
  if (n == 0 || std::ssize(moving.matches) < min_moving) return all;
  *still = n;
  return moving;
}

std::optional<TexturePair> EstimatePair(const Correspondences& all,
                                        double px_factor,
                                        const TextureOptions& options) {
  const int n = static_cast<int>(all.matches.size());
  if (n < options.min_inliers) return std::nullopt;
  cv::Mat estimate, mask;
  try {
    estimate = cv::findFundamentalMat(
        all.a, all.b, mask, Usac(options.inlier_px * px_factor, options.seed));
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  const int inliers = CountMarked(mask);
  if (estimate.rows != 3 || estimate.cols != 3 || inliers < options.min_inliers ||
      inliers - 7 < options.min_share * n) {
    return std::nullopt;
  }
  TexturePair pair;
  std::vector<cv::Point2d> in_a, in_b;
  for (int k = 0; k < n; ++k) {
    if (mask.at<uchar>(k) == 0) continue;
    pair.matches.push_back(all.matches[k]);
    in_a.push_back(all.a[k]);
    in_b.push_back(all.b[k]);
  }
  try {
    cv::Mat on_plane;
    cv::findHomography(in_a, in_b, on_plane, Usac(options.homography_px * px_factor, options.seed));
    pair.on_homography = CountMarked(on_plane);
  } catch (const cv::Exception&) {
    pair.on_homography = 0;
  }
  return pair;
}

// No pair where too few agree. What moves goes before what stands still.
std::optional<TexturePair> MatchPair(const KeypointSet& a,
                                     const KeypointSet& b,
                                     double px_factor,
                                     const TextureOptions& options) {
  const Correspondences all = Distinct(a, b, MatchKeypointIndices(a, b, options.ratio));
  int still = 0;
  const Correspondences moving =
      Moving(all, options.still_px * px_factor, options.min_inliers, &still);
  std::optional<TexturePair> pair = EstimatePair(moving, px_factor, options);
  if (pair) {
    pair->still = still;
    return pair;
  }
  return still > 0 ? EstimatePair(all, px_factor, options) : std::nullopt;
}

// The strongest keypoints.
KeypointSet Strongest(const KeypointSet& set, int keep) {
  KeypointSet few = set;
  if (set.size() <= keep) return few;
  few.points.resize(keep);
  few.descriptors.resize(static_cast<size_t>(keep) * kDescriptorLength);
  few.squared_norms.resize(keep);
  return few;
}

// Few views: all pairs; more: by how many of the strongest keypoints match.
std::vector<std::pair<int, int>> TexturePairsToCompare(const std::vector<KeypointSet>& keypoints,
                                                       const TextureOptions& options,
                                                       const ViewGraphOptions& graph,
                                                       int threads) {
  const int views = static_cast<int>(keypoints.size());
  std::vector<ViewOverlap> overlaps;
  if (views > graph.all_up_to) {
    std::vector<KeypointSet> few;
    for (const KeypointSet& set : keypoints) few.push_back(Strongest(set, options.vote_keypoints));
    for (int a = 0; a < views; ++a) {
      for (int b = a + 1; b < views; ++b) overlaps.push_back({a, b, 0.0});
    }
    ParallelFor(static_cast<int>(overlaps.size()), threads, [&](int k) {
      ViewOverlap& o = overlaps[k];
      o.score = static_cast<double>(
          MatchKeypointIndices(few[o.view_a], few[o.view_b], options.vote_ratio).size());
    });
  }
  std::vector<std::pair<int, int>> pairs = ChooseViewPairs(views, overlaps, graph);
  if (views <= graph.all_up_to) return pairs;
  // Views most alike have the least parallax: some far apart in the given order join them.
  for (int v = 0; v < views; ++v) {
    const int other = v + views / 3;
    if (other < views) pairs.emplace_back(v, other);
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  return pairs;
}

std::vector<FeatureTrack> JoinPairs(const std::vector<TexturePair>& pairs) {
  std::vector<TrackLink> links;
  for (const TexturePair& pair : pairs) {
    // Matches of pairs on which more agree come first, in each the likeliest.
    const double n = static_cast<double>(pair.matches.size());
    for (size_t k = 0; k < pair.matches.size(); ++k) {
      links.push_back({pair.view_a,
                       pair.matches[k].first,
                       pair.view_b,
                       pair.matches[k].second,
                       n - static_cast<double>(k)});
    }
  }
  return JoinTracks(std::move(links));
}

}  // namespace

TextureMatching MatchTexture(std::span<const cv::Mat> images,
                             const TextureOptions& options,
                             const ViewGraphOptions& graph,
                             int threads,
                             const StopRequested& stop) {
  const int views = static_cast<int>(images.size());
  TextureMatching out;
  out.keypoints.resize(views);
  out.sigma_px.resize(views);
  ParallelFor(views, threads, [&](int v) {
    const double scale = std::min(
        1.0, std::sqrt(options.max_pixels / std::max(1.0, static_cast<double>(images[v].total()))));
    out.sigma_px[v] = kKeypointSigmaPx / scale;
    if (!IsStopRequested(stop)) out.keypoints[v] = DetectTexture(images[v], scale, options);
  });
  if (IsStopRequested(stop)) return out;
  const std::vector<std::pair<int, int>> compared =
      TexturePairsToCompare(out.keypoints, options, graph, threads);
  std::vector<std::optional<TexturePair>> pairs(compared.size());
  ParallelFor(static_cast<int>(compared.size()), threads, [&](int k) {
    const auto [a, b] = compared[k];
    if (IsStopRequested(stop)) return;
    const double factor = std::max(1.0, std::max(images[a].cols, images[b].cols) / kReferenceWidth);
    pairs[k] = MatchPair(out.keypoints[a], out.keypoints[b], factor, options);
    if (!pairs[k]) return;
    pairs[k]->view_a = a;
    pairs[k]->view_b = b;
  });
  double points = 0.0;
  for (const KeypointSet& set : out.keypoints) points += set.size();
  double still = 0.0;
  for (std::optional<TexturePair>& pair : pairs) {
    if (!pair) continue;
    still += pair->still;
    out.pairs.push_back(*std::move(pair));
  }
  if (!IsStopRequested(stop)) out.tracks = JoinPairs(out.pairs);
  out.counts["texture_still"] = still;
  out.counts["texture_points"] = points;
  out.counts["texture_pairs"] = static_cast<double>(out.pairs.size());
  out.counts["texture_tracks"] = static_cast<double>(out.tracks.size());
  return out;
}

}  // namespace horopter
