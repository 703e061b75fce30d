// The ways to split edge chains and to find lines, side by side on shapes of known geometry:
//   splitting_report
// Shapes are rendered with blur and noise and linked as the features stage links them; seeds are
// fixed, so every run prints the same.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "server/vision/features/chain_splitting.h"
#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/edge_linking.h"
#include "tests/server/vision/features/rendered_shapes.h"
#include "tests/server/vision/features/synthetic_chains.h"

namespace horopter {
namespace {

constexpr double kFoundPx = 4.0;  // a cut this near to a join has found it
constexpr int kShapes = 40;
constexpr int kMethods = 5;

struct Shape {
  std::vector<Eigen::Vector2d> outline;
  std::vector<Eigen::Vector2d> joins;
};

Shape Centred(const SyntheticChain& chain, std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  Shape shape;
  shape.outline = chain.points;
  shape.joins = {chain.points.front()};  // the outline is closed
  for (int j : chain.joins) shape.joins.push_back(chain.points[j]);
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : shape.outline) mean += p / shape.outline.size();
  const Eigen::Vector2d shift = Eigen::Vector2d(155 + 10 * u(*rng), 115 + 10 * u(*rng)) - mean;
  for (Eigen::Vector2d& p : shape.outline) p += shift;
  for (Eigen::Vector2d& p : shape.joins) p += shift;
  return shape;
}

using MakeShape = Shape (*)(std::mt19937*);

// Triangle to hexagon: corners that turn by 60 to 120 degrees.
Shape Polygon(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const int sides = 3 + static_cast<int>(4 * u(*rng));
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  const double length = 300.0 / sides;
  for (int k = 0; k < sides; ++k) walk.Line(length).Turn(2 * M_PI / sides);
  return Centred(walk.chain(), rng);
}

// Twelve to eighteen sides of 30 px: corners that turn by 20 to 30 degrees.
Shape ObtusePolygon(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const int sides = 12 + static_cast<int>(7 * u(*rng));
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  for (int k = 0; k < sides; ++k) walk.Line(30.0).Turn(2 * M_PI / sides);
  return Centred(walk.chain(), rng);
}

// Rounded square: lines run smoothly into arcs of radius 12 to 30 px.
Shape RoundedSquare(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double radius = 12 + 18 * u(*rng);
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  for (int k = 0; k < 4; ++k) walk.Line(60.0).Arc(radius, M_PI / 2);
  return Centred(walk.chain(), rng);
}

// Half a disc: two corners between a line and an arc.
Shape HalfDisc(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double radius = 25 + 50 * u(*rng);
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  walk.Line(2 * radius).Turn(M_PI / 2).Arc(radius, M_PI).Turn(M_PI / 2);
  return Centred(walk.chain(), rng);
}

// No join at all: every cut is false.
Shape Ellipse(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double major = 15 + 60 * u(*rng);
  Shape shape;
  shape.outline = EllipsePolygon({155 + 10 * u(*rng), 115 + 10 * u(*rng)},
                                 major,
                                 major * (0.5 + 0.5 * u(*rng)),
                                 M_PI * u(*rng));
  return shape;
}

struct Score {
  int joins = 0, found = 0, false_cuts = 0;
  double square = 0.0;
  double length = 0.0;
  double seconds = 0.0;
};

std::vector<EdgeChain> Chains(const Shape& shape, double noise, std::mt19937* rng) {
  RenderOptions render;
  render.noise_sigma = noise;
  const cv::Mat image = RenderPolygon(shape.outline, render, rng);
  GradientOptions gradient;
  gradient.colour = ColourGradient::kIntensity;
  std::vector<EdgeChain> chains;
  for (const GradientField& field : MakeGradientFields(image, gradient)) {
    for (EdgeChain& chain : LinkEdges(field, {})) {
      if (chain.points.size() >= 12) chains.push_back(std::move(chain));
    }
  }
  return chains;
}

void Judge(const Shape& shape,
           const std::vector<EdgeChain>& chains,
           const ChainSplittingOptions& options,
           Score* score) {
  std::vector<Eigen::Vector2d> cuts, ends;
  for (const EdgeChain& chain : chains) {
    const auto start = std::chrono::steady_clock::now();
    const auto pieces = SplitChain(chain.points, chain.closed, options);
    score->seconds +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
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
      std::mt19937 rng(7);
      for (int k = 0; k < kShapes; ++k) {
        const Shape shape = make(&rng);
        const std::vector<EdgeChain> chains = Chains(shape, noise, &rng);
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
