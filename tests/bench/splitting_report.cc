// The ways to split edge chains, side by side on shapes of known geometry:
//   splitting_report
// Shapes are rendered with blur and noise and linked as the features stage links them; seeds are
// fixed, so every run prints the same (but the times).
#include <algorithm>
#include <cstdio>
#include <utility>

#include "server/vision/features/chain_splitting.h"
#include "tests/bench/joined_shapes.h"

namespace horopter {
namespace {

constexpr double kFoundPx = 4.0;  // a cut this near to a join has found it
constexpr int kMethods = 5;

struct Score {
  int joins = 0, found = 0, false_cuts = 0;
  double square = 0.0;
  double length = 0.0;
  double seconds = 0.0;
};

void Judge(const Shape& shape,
           const std::vector<EdgeChain>& chains,
           const ChainSplittingOptions& options,
           Score* score) {
  std::vector<Eigen::Vector2d> cuts, ends;
  for (const EdgeChain& chain : chains) {
    const auto start = std::chrono::steady_clock::now();
    const auto pieces = SplitChain(chain.points, chain.closed, options);
    score->seconds += Since(start);
    score->length += static_cast<double>(chain.points.size());
    ends.push_back(chain.points.front().cast<double>());
    ends.push_back(chain.points.back().cast<double>());
    const int last = static_cast<int>(chain.points.size()) - 1;
    for (const ChainPiece& piece : *pieces) {
      if (piece.begin > 0) cuts.push_back(chain.points[piece.begin].cast<double>());
      if (piece.end - 1 < last) cuts.push_back(chain.points[piece.end - 1].cast<double>());
    }
  }
  const auto nearest = [](const std::vector<Eigen::Vector2d>& points, const Eigen::Vector2d& p) {
    double best = 1e9;
    for (const Eigen::Vector2d& q : points) best = std::min(best, (q - p).norm());
    return best;
  };
  for (const Eigen::Vector2d& join : shape.joins) {
    if (nearest(ends, join) < kFoundPx) continue;  // the linker has cut here
    ++score->joins;
    if (const double distance = nearest(cuts, join); distance < kFoundPx) {
      ++score->found;
      score->square += distance * distance;
    }
  }
  std::vector<Eigen::Vector2d> counted;
  for (const Eigen::Vector2d& cut : cuts) {
    // Two pieces share a cut; points left out between them are one cut.
    if (nearest(shape.joins, cut) > kFoundPx && nearest(ends, cut) > kFoundPx &&
        nearest(counted, cut) > kFoundPx) {
      ++score->false_cuts;
      counted.push_back(cut);
    }
  }
}

void ReportSplitting() {
  const std::pair<const char*, MakeShape> shapes[] = {{"corners 60-120 deg", Polygon},
                                                      {"corners 20-30 deg", ObtusePolygon},
                                                      {"line-arc corners", HalfDisc},
                                                      {"smooth line-arc joins", RoundedSquare},
                                                      {"ellipses", Ellipse}};
  struct Method {
    const char* name;
    ChainSplittingMethod method;
    bool rejoin = false;
  };
  const Method methods[kMethods] = {
      {"split and merge", ChainSplittingMethod::kSplitAndMerge},
      {"curvature threshold", ChainSplittingMethod::kCurvatureThreshold},
      {"... rejoined", ChainSplittingMethod::kCurvatureThreshold, true},
      {"templates", ChainSplittingMethod::kCurvatureTemplates},
      {"... rejoined", ChainSplittingMethod::kCurvatureTemplates, true}};
  std::printf("| shape | noise |");
  for (const Method& method : methods) std::printf(" %s |", method.name);
  std::printf("\n|---|---|---|---|---|---|---|\n");
  double seconds[kMethods] = {}, points = 0.0;
  for (const auto& [name, make] : shapes) {
    for (double noise : {0.0, 2.0, 4.0, 8.0}) {
      std::printf("| %s | %.0f |", name, noise);
      Score scores[kMethods];
      std::mt19937 rng(kSeed);
      for (int k = 0; k < kShapes; ++k) {
        const Shape shape = make(&rng);
        ShapeRenderOptions render;
        render.noise_sigma = noise;
        const std::vector<EdgeChain> chains = Chains(RenderPolygon(shape.outline, render, &rng));
        for (int m = 0; m < kMethods; ++m) {
          ChainSplittingOptions options;
          options.method = methods[m].method;
          if (!methods[m].rejoin) options.rejoin_factor = 0.0;
          Judge(shape, chains, options, &scores[m]);
        }
      }
      for (int m = 0; m < kMethods; ++m) {
        const Score& s = scores[m];
        seconds[m] += s.seconds;
        if (s.joins > 0) {
          std::printf(" %.2f, %.2f px,", 1.0 * s.found / s.joins, std::sqrt(s.square / s.found));
        }
        std::printf(" %.1f |", 1000.0 * s.false_cuts / s.length);
      }
      points += scores[0].length;
      std::printf("\n");
    }
  }
  std::printf("\nns per point:");
  for (int m = 0; m < kMethods; ++m) {
    std::printf(
        " %s %.0f%s", methods[m].name, 1e9 * seconds[m] / points, m + 1 < kMethods ? "," : "\n");
  }
}

}  // namespace
}  // namespace horopter

int main() {
  std::printf("joins found, rms distance, false cuts per 1000 points\n\n");
  horopter::ReportSplitting();
  return 0;
}
