// Learns the log-likelihood ratios of matching's cues from a data set in BOP layout and prints them
// as the tables of server/vision/matching/learnt_constants.h:
//   matching_learning DATASET SPLIT
// A pair of features is the same when both are images of one CAD edge or corner; different when one
// of them is and the other is not. Pairs that fail the cheap tests of PairComparison are left out
// on both sides, as in use.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "server/base/status_macros.h"
#include "server/vision/matching/feature_similarity.h"
#include "server/vision/matching/learnt_constants.h"
#include "server/vision/matching/match_features.h"
#include "tests/bench/true_pairs.h"

namespace horopter {
namespace {

constexpr int kFalseKept = 23;  // one in so many different pairs is kept

struct CueRange {
  const char* name;
  float low, high;
  int bins;
};
constexpr CueRange kSegmentRanges[kSegmentCueCount] = {
    {"turn", 0.0f, 1.2f, 10},
    {"flipped", -0.5f, 1.5f, 2},
    {"length ratio", 0.0f, 1.5f, 8},
    {"better side", 0.0f, 60.0f, 10},
    {"worse side", 0.0f, 120.0f, 10},
    {"contrast ratio", 0.0f, 2.0f, 8},
    {"strip", -0.4f, 1.0f, 10},
    {"shift", 0.0f, 0.20f, 10},
    {"beam", 0.0f, 1.0f, 8},
};
constexpr CueRange kJunctionRanges[kJunctionCueCount] = {
    {"patch", -0.4f, 1.0f, 12},
    {"type pair", -0.5f, 2.5f, 3},
    {"arm turn", 0.0f, 1.2f, 10},
    {"arm count", -0.5f, 2.5f, 3},
    {"point shift", 0.0f, 0.25f, 10},
    {"epipolar", 0.0f, 8.0f, 12},
};

constexpr CueRange kLinkRanges[kMatchRelationCount] = {
    {"segment meets junction", 0.0f, 1.0f, 2},
    {"segments share junction", 0.0f, 1.2f, 8},
    {"segments collinear", 0.0f, 1.2f, 8},
    {"segments parallel", 0.0f, 1.2f, 8},
    {"segments of same region", 0.0f, 1.2f, 8},
    {"junctions of one segment", 0.0f, 1.6f, 8},
};

// Links between candidates that are both right, and the others, by their disagreement.
struct LinkSamples {
  std::vector<double> right[kMatchRelationCount], wrong[kMatchRelationCount];
  size_t right_candidates = 0, wrong_candidates = 0;
};

template <typename Cues>
struct Samples {
  std::vector<Cues> same, different;
};

template <typename Cues>
std::vector<LogRatioTable> Learn(const Samples<Cues>& samples, const CueRange* ranges) {
  const int count = Cues::RowsAtCompileTime;
  std::vector<LogRatioTable> tables(count);
  for (int k = 0; k < count; ++k) {
    LogRatioTable& t = tables[k];
    t.bins = ranges[k].bins;
    t.low = ranges[k].low;
    t.step = (ranges[k].high - ranges[k].low) / static_cast<float>(t.bins);
    t.weight = 1.0f;
    std::vector<double> same(t.bins, 2.0), different(t.bins, 2.0);  // two of each: no bin is sure
    const auto add = [&](const std::vector<Cues>& from, std::vector<double>* to) {
      double total = 2.0 * t.bins;
      for (const Cues& c : from) {
        if (!std::isfinite(c[k])) continue;
        const int bin =
            std::clamp(static_cast<int>(std::floor((c[k] - t.low) / t.step)), 0, t.bins - 1);
        (*to)[bin] += 1.0;
        total += 1.0;
      }
      for (double& v : *to) v /= total;
    };
    add(samples.same, &same);
    add(samples.different, &different);
    for (int b = 0; b < t.bins; ++b)
      t.values[b] = static_cast<float>(std::log(same[b] / different[b]));
  }
  // Logistic regression of the tables' values (Newton): the weights.
  const size_t n = samples.same.size() + samples.different.size();
  Eigen::MatrixXd X(n, count + 1);
  Eigen::VectorXd y(n);
  size_t row = 0;
  const auto fill = [&](const std::vector<Cues>& from, double label) {
    for (const Cues& c : from) {
      for (int k = 0; k < count; ++k) {
        LogRatioTable t = tables[k];
        X(row, k) = TableValue(t, c[k]);
      }
      X(row, count) = 1.0;
      y(row++) = label;
    }
  };
  fill(samples.same, 1.0);
  fill(samples.different, 0.0);
  // Both classes weigh the same, so that 0 stays the even point.
  const double w1 = 0.5 / std::max<size_t>(1, samples.same.size());
  const double w0 = 0.5 / std::max<size_t>(1, samples.different.size());
  Eigen::VectorXd w = Eigen::VectorXd::Zero(count + 1);
  for (int round = 0; round < 25; ++round) {
    Eigen::MatrixXd A = 1e-6 * Eigen::MatrixXd::Identity(count + 1, count + 1);
    Eigen::VectorXd g = -1e-6 * w;
    for (size_t i = 0; i < n; ++i) {
      const double p = 1.0 / (1.0 + std::exp(-X.row(i).dot(w)));
      const double c = y(i) > 0.5 ? w1 : w0;
      g += c * (y(i) - p) * X.row(i).transpose();
      A += c * std::max(1e-6, p * (1 - p)) * X.row(i).transpose() * X.row(i);
    }
    w += A.ldlt().solve(g);
  }
  for (int k = 0; k < count; ++k) tables[k].weight = static_cast<float>(std::max(0.0, w(k)));
  return tables;
}

// What a link says of the two it joins; `weight` is what its existence alone says. Rates are per
// candidate, because a right candidate has more neighbours that are candidates too.
std::vector<LogRatioTable> LearnLinks(const LinkSamples& samples) {
  std::vector<LogRatioTable> tables;
  for (int r = 0; r < kMatchRelationCount; ++r) {
    const CueRange& range = kLinkRanges[r];
    LogRatioTable t{
        range.low, (range.high - range.low) / static_cast<float>(range.bins), range.bins, 0.0f, {}};
    std::vector<double> right(t.bins, 2.0), wrong(t.bins, 2.0);
    const auto count = [&](const std::vector<double>& from, std::vector<double>* to) {
      for (double d : from)
        (*to)[std::clamp(static_cast<int>((d - t.low) / t.step), 0, t.bins - 1)] += 1.0;
    };
    count(samples.right[r], &right);
    count(samples.wrong[r], &wrong);
    const double rate = std::log(static_cast<double>(samples.wrong_candidates) /
                                 static_cast<double>(samples.right_candidates));
    for (int b = 0; b < t.bins; ++b)
      t.values[b] = static_cast<float>(std::log(right[b] / wrong[b]) + rate);
    t.weight = static_cast<float>(std::max(
        0.0, std::log((2.0 + samples.right[r].size()) / (2.0 + samples.wrong[r].size())) + rate));
    tables.push_back(t);
  }
  return tables;
}

void Print(const char* name, const std::vector<LogRatioTable> tables[2], const CueRange* ranges) {
  std::printf("inline constexpr LogRatioTable %s = {\n", name);
  for (int context = 0; context < 2; ++context) {
    std::printf("    {\n");
    for (size_t k = 0; k < tables[context].size(); ++k) {
      const LogRatioTable& t = tables[context][k];
      std::printf("        // %s\n        {%#.4gf, %#.4gf, %d, %.3ff, {",
                  ranges[k].name,
                  t.low,
                  t.step,
                  t.bins,
                  t.weight);
      for (int b = 0; b < t.bins; ++b) std::printf("%s%.3ff", b ? ", " : "", t.values[b]);
      std::printf("}},\n");
    }
    std::printf("    },\n");
  }
  std::printf("};\n");
}

void CollectLinks(const PairComparison& compare, const TruePair& pair, LinkSamples* samples) {
  const CandidateGraph graph = BuildCandidateGraph(compare, FeatureMatchOptions());
  std::vector<int> truth;  // 1 right, 0 wrong, -1 unknown
  for (const FeatureMatch& c : graph.candidates) {
    const bool junction = c.kind == FeatureKind::kJunction;
    const FeatureLabel a = (junction ? pair.labels_a->junctions : pair.labels_a->segments)[c.a];
    const FeatureLabel b = (junction ? pair.labels_b->junctions : pair.labels_b->segments)[c.b];
    truth.push_back(a == kUnknownFeature && b == kUnknownFeature ? -1 : a == b);
    samples->right_candidates += truth.back() == 1;
    samples->wrong_candidates += truth.back() == 0;
  }
  for (const MatchCandidateLink& l : graph.links) {
    if (truth[l.from] < 0 || truth[l.to] < 0) continue;
    const bool right = truth[l.from] == 1 && truth[l.to] == 1;
    (right ? samples->right : samples->wrong)[static_cast<int>(l.relation)].push_back(
        l.disagreement);
  }
}

absl::Status Run(const std::string& dataset, const std::string& split) {
  Samples<SegmentCues> segments[2];
  Samples<JunctionCues> junctions[2];
  LinkSamples links[2];
  size_t seen_segments[2] = {0, 0}, gated_segments[2] = {0, 0}, seen_junctions[2] = {0, 0},
         gated_junctions[2] = {0, 0};
  const auto visit = [&](const TruePair& pair) {
    for (int context = 0; context < 2; ++context) {
      PairPrior prior;
      if (context == 0) {
        if (!pair.b_from_a) continue;
        prior.b_from_a = pair.b_from_a;
      }
      prior.F = pair.F_true;
      PairPrior no_f = prior;
      no_f.F.reset();
      const auto patches = WarpedPatches(*pair.b, prior);
      const PairComparison compare(*pair.a, *pair.b, patches, prior);
      const PairComparison gate(*pair.a, *pair.b, patches, no_f);
      CollectLinks(gate, pair, &links[context]);
      size_t k = 0;
      const auto collect = [&](const std::vector<FeatureLabel>& la,
                               const std::vector<FeatureLabel>& lb,
                               auto may,
                               auto cues,
                               auto* samples,
                               size_t* seen,
                               size_t* gated) {
        for (size_t i = 0; i < la.size(); ++i) {
          for (size_t j = 0; j < lb.size(); ++j) {
            if (la[i] == kUnknownFeature && lb[j] == kUnknownFeature) continue;
            const bool same = la[i] == lb[j];
            if (!same && ++k % kFalseKept != 0) continue;
            if (same) ++*seen;
            if (!may(i, j)) {
              if (same) ++*gated;
              continue;
            }
            (same ? samples->same : samples->different).push_back(cues(i, j));
          }
        }
      };
      collect(
          pair.labels_a->segments,
          pair.labels_b->segments,
          [&](int i, int j) { return gate.MaySegments(i, j); },
          [&](int i, int j) { return compare.Segments(i, j); },
          &segments[context],
          &seen_segments[context],
          &gated_segments[context]);
      collect(
          pair.labels_a->junctions,
          pair.labels_b->junctions,
          [&](int i, int j) { return gate.MayJunctions(i, j); },
          [&](int i, int j) { return compare.Junctions(i, j); },
          &junctions[context],
          &seen_junctions[context],
          &gated_junctions[context]);
    }
  };
  HOROPTER_RETURN_IF_ERROR(ForEachTruePair(dataset, split, {}, visit));
  std::vector<LogRatioTable> segment_tables[2], junction_tables[2];
  for (int c = 0; c < 2; ++c) {
    std::fprintf(stderr,
                 "%s plane: segments %zu same (%zu gated of %zu), %zu different kept; junctions "
                 "%zu (%zu of %zu), %zu\n",
                 c ? "without" : "with",
                 segments[c].same.size(),
                 gated_segments[c],
                 seen_segments[c],
                 segments[c].different.size(),
                 junctions[c].same.size(),
                 gated_junctions[c],
                 seen_junctions[c],
                 junctions[c].different.size());
    segment_tables[c] = Learn(segments[c], kSegmentRanges);
    junction_tables[c] = Learn(junctions[c], kJunctionRanges);
  }
  Print("kSegmentTables[2][kSegmentCueCount]", segment_tables, kSegmentRanges);
  Print("kJunctionTables[2][kJunctionCueCount]", junction_tables, kJunctionRanges);
  const std::vector<LogRatioTable> link_tables[2] = {LearnLinks(links[0]), LearnLinks(links[1])};
  std::printf(
      "// By the relation of the neighbours; the weight is what a link says without its "
      "disagreement.\n");
  Print("kLinkTables[2][kMatchRelationCount]", link_tables, kLinkRanges);
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: matching_learning DATASET SPLIT\n");
    return 2;
  }
  const absl::Status status = horopter::Run(argv[1], argv[2]);
  if (status.ok()) return 0;
  std::fprintf(stderr, "matching_learning: %s\n", std::string(status.message()).c_str());
  return 1;
}
