// Matching methods side by side on a data set in BOP layout:
//   matching_variants DATASET SPLIT [SCENE...]
// Neighbouring views. Matches of known parts: precision over matches of which one side at least is
// an edge or corner of a known part; recall over the features of view a whose counterpart was
// detected in view b. F right: at least 95 % of the parts' vertices within 2 px.
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <string>
#include <vector>

#include "server/base/status_macros.h"
#include "server/vision/matching/match_features.h"
#include "tests/bench/true_pairs.h"

namespace horopter {
namespace {

struct Tally {
  int pairs = 0, f_right = 0;
  int judged[2] = {0, 0}, right[2] = {0, 0};  // matches of known parts; [0] junctions, [1] segments
  int shared[2] = {0, 0}, found[2] = {0, 0};
  double seconds = 0.0;
};

using Points = std::vector<cv::Point2d>;

std::optional<Eigen::Matrix3d> RobustF(const Points& a, const Points& b) {
  if (a.size() < 8) return std::nullopt;
  cv::Mat mask, F;
  try {
    F = cv::findFundamentalMat(a, b, cv::USAC_MAGSAC, 1.5, 0.999, 5000, mask);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  if (F.rows != 3 || F.cols != 3) return std::nullopt;
  Eigen::Matrix3d f;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) f(r, c) = F.at<double>(r, c);
  }
  return f;
}

void Count(const std::vector<FeatureLabel>& a,
           const std::vector<FeatureLabel>& b,
           const std::vector<FeatureMatch>& matches,
           FeatureKind kind,
           int slot,
           Tally* tally) {
  std::vector<char> right_a(a.size(), 0);
  for (const FeatureMatch& m : matches) {
    if (m.kind != kind) continue;
    if (a[m.a] == kUnknownFeature && b[m.b] == kUnknownFeature) continue;
    ++tally->judged[slot];
    tally->right[slot] += a[m.a] == b[m.b];
    right_a[m.a] = a[m.a] == b[m.b];
  }
  // Pieces of one edge share a label: as many can be matched as the poorer view has.
  std::map<FeatureLabel, int> in_a, in_b, found;
  for (size_t i = 0; i < a.size(); ++i) {
    ++in_a[a[i]];
    found[a[i]] += right_a[i];
  }
  for (FeatureLabel l : b) ++in_b[l];
  for (const auto& [label, n] : in_a) {
    if (label == kUnknownFeature || !in_b.count(label)) continue;
    const int possible = std::min(n, in_b[label]);
    tally->shared[slot] += possible;
    tally->found[slot] += std::min(possible, found[label]);
  }
}

void CountKeypoints(const TruePair& pair,
                    const cv::Ptr<cv::Feature2D>& detector,
                    const TrueModels& models,
                    Tally* tally) {
  const cv::Mat* images[2] = {&pair.scene->images[pair.view_a], pair.image_b};
  std::vector<cv::KeyPoint> keypoints[2];
  cv::Mat descriptors[2];
  for (int k = 0; k < 2; ++k) {
    cv::Mat grey;
    cv::cvtColor(*images[k], grey, cv::COLOR_BGR2GRAY);
    detector->detectAndCompute(grey, cv::noArray(), keypoints[k], descriptors[k]);
  }
  ++tally->pairs;
  if (keypoints[0].size() < 2 || keypoints[1].size() < 2) return;
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(detector->defaultNorm()).knnMatch(descriptors[0], descriptors[1], matches, 2);
  Points a, b;
  for (const auto& m : matches) {
    if (m.size() < 2 || m[0].distance > 0.8f * m[1].distance) continue;
    const Eigen::Vector2d x_a(keypoints[0][m[0].queryIdx].pt.x, keypoints[0][m[0].queryIdx].pt.y);
    const Eigen::Vector2d x_b(keypoints[1][m[0].trainIdx].pt.x, keypoints[1][m[0].trainIdx].pt.y);
    ++tally->judged[0];
    tally->right[0] += EpipolarDistance(pair.F_true, x_a, x_b) < 2.0;
    a.emplace_back(x_a.x(), x_a.y());
    b.emplace_back(x_b.x(), x_b.y());
  }
  const auto F = RobustF(a, b);
  tally->f_right += F && ShareOfVertices(pair, models, *F) >= 0.95;
}

enum class Known { kNothing, kPlane, kPlaneAndF, kF };

struct Variant {
  std::string name;
  Known known = Known::kNothing;
  FeatureMatchOptions options;
};

std::vector<Variant> Variants() {
  std::vector<Variant> variants;
  const std::pair<const char*, Known> contexts[] = {{"", Known::kNothing},
                                                    {", plane known", Known::kPlane},
                                                    {", plane and F known", Known::kPlaneAndF},
                                                    {", F known", Known::kF}};
  for (const auto& [suffix, known] : contexts) {
    Variant v;
    v.known = known;
    v.options.assignment.method = AssignmentMethod::kGreedy;
    v.options.similarity.correlation = false;
    const auto add = [&](const char* name) {
      v.name = std::string(name) + suffix;
      variants.push_back(v);
    };
    add("parameters");
    v.options.similarity.correlation = true;
    add("+ correlation");
    v.options.assignment.method = AssignmentMethod::kRandomWalks;
    v.options.transformations = false;
    add("+ neighbours");
    v.options.transformations = true;
    add("+ transformations (walks)");
    v.options.assignment.method = AssignmentMethod::kSpectral;
    add("... spectral");
  }
  return variants;
}

void CountVariant(const TruePair& pair,
                  const Variant& variant,
                  const TrueModels& models,
                  Tally* tally) {
  PairPrior prior;
  if (variant.known == Known::kPlane || variant.known == Known::kPlaneAndF)
    prior.b_from_a = pair.b_from_a;
  if (variant.known == Known::kF || variant.known == Known::kPlaneAndF) prior.F = pair.F_true;
  const auto begin = std::chrono::steady_clock::now();
  const PairComparison compare(*pair.a, *pair.b, WarpedPatches(*pair.b, prior), prior);
  const std::vector<FeatureMatch> matches = MatchFeatures(compare, variant.options);
  tally->seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  Count(pair.labels_a->junctions,
        pair.labels_b->junctions,
        matches,
        FeatureKind::kJunction,
        0,
        tally);
  Count(pair.labels_a->segments, pair.labels_b->segments, matches, FeatureKind::kSegment, 1, tally);
  Points a, b;
  for (const FeatureMatch& m : matches) {
    if (m.kind != FeatureKind::kJunction) continue;
    const Eigen::Vector2d& x = pair.a->features->junctions[m.a].point;
    const Eigen::Vector2d& y = pair.b->features->junctions[m.b].point;
    a.emplace_back(x.x(), x.y());
    b.emplace_back(y.x(), y.y());
  }
  ++tally->pairs;
  const auto F = RobustF(a, b);
  tally->f_right += F && ShareOfVertices(pair, models, *F) >= 0.95;
}

void Print(const std::string& name, const std::map<std::string, Tally>& tallies) {
  std::printf("%-42s", name.c_str());
  for (const auto& [tier, t] : tallies) {
    const auto share = [](int part, int whole) {
      return whole > 0 ? static_cast<double>(part) / whole : NAN;
    };
    std::printf(" | %s F %2d/%2d J %.2f %.2f S %.2f %.2f %5.1f ms",
                tier.c_str(),
                t.f_right,
                t.pairs,
                share(t.right[0], t.judged[0]),
                share(t.found[0], t.shared[0]),
                share(t.right[1], t.judged[1]),
                share(t.found[1], t.shared[1]),
                1e3 * t.seconds / std::max(1, t.pairs));
  }
  std::printf("\n");
}

absl::Status Run(const std::string& dataset, const std::string& split, std::vector<int> scenes) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset bop, ReadBopDataset(dataset));
  HOROPTER_ASSIGN_OR_RETURN(const TrueModels models, ReadTrueModels(bop));
  const std::vector<Variant> variants = Variants();
  std::vector<std::map<std::string, Tally>> tallies(variants.size() + 2);
  const cv::Ptr<cv::Feature2D> sift = cv::SIFT::create(0, 3, 0.01), akaze = cv::AKAZE::create();
  HOROPTER_RETURN_IF_ERROR(
      ForEachTruePair(dataset, split, std::move(scenes), [&](const TruePair& pair) {
        if (pair.view_b != pair.view_a + 1) return;
        const std::string& tier = pair.scene->tier;
        CountKeypoints(pair, sift, models, &tallies[0][tier]);
        CountKeypoints(pair, akaze, models, &tallies[1][tier]);
        for (size_t v = 0; v < variants.size(); ++v)
          CountVariant(pair, variants[v], models, &tallies[v + 2][tier]);
      }));
  std::printf(
      "F right / pairs; junctions (keypoints) J and segments S: precision, recall; time of one "
      "pair\n");
  Print("SIFT, contrast 0.01, ratio 0.8", tallies[0]);
  Print("AKAZE, ratio 0.8", tallies[1]);
  for (size_t v = 0; v < variants.size(); ++v) Print(variants[v].name, tallies[v + 2]);
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: matching_variants DATASET SPLIT [SCENE...]\n");
    return 2;
  }
  std::vector<int> scenes;
  for (int i = 3; i < argc; ++i) scenes.push_back(std::atoi(argv[i]));
  const absl::Status status = horopter::Run(argv[1], argv[2], std::move(scenes));
  if (status.ok()) return 0;
  std::fprintf(stderr, "matching_variants: %s\n", std::string(status.message()).c_str());
  return 1;
}
