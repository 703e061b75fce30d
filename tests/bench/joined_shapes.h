// Shapes of lines and arcs whose joins are known, and their edge chains, for the reports.
#pragma once

#include <chrono>
#include <cmath>
#include <random>
#include <vector>

#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/edge_linking.h"
#include "tests/server/vision/features/rendered_shapes.h"
#include "tests/server/vision/features/synthetic_chains.h"

namespace horopter {

constexpr int kShapes = 40;
constexpr unsigned kSeed = 11;

inline double Cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

inline double Since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct Shape {
  std::vector<Eigen::Vector2d> outline;
  std::vector<Eigen::Vector2d> joins;
};

inline Shape Centred(const SyntheticChain& chain, std::mt19937* rng) {
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
inline Shape Polygon(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const int sides = 3 + static_cast<int>(4 * u(*rng));
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  const double length = 300.0 / sides;
  for (int k = 0; k < sides; ++k) walk.Line(length).Turn(2 * M_PI / sides);
  return Centred(walk.chain(), rng);
}

// Twelve to eighteen sides of 30 px: corners that turn by 20 to 30 degrees.
inline Shape ObtusePolygon(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const int sides = 12 + static_cast<int>(7 * u(*rng));
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  for (int k = 0; k < sides; ++k) walk.Line(30.0).Turn(2 * M_PI / sides);
  return Centred(walk.chain(), rng);
}

// Rounded square: lines run smoothly into arcs of radius 12 to 30 px.
inline Shape RoundedSquare(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double radius = 12 + 18 * u(*rng);
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  for (int k = 0; k < 4; ++k) walk.Line(60.0).Arc(radius, M_PI / 2);
  return Centred(walk.chain(), rng);
}

// Half a disc: two corners between a line and an arc.
inline Shape HalfDisc(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double radius = 25 + 50 * u(*rng);
  ChainWalk walk({0, 0}, 2 * M_PI * u(*rng));
  walk.Line(2 * radius).Turn(M_PI / 2).Arc(radius, M_PI).Turn(M_PI / 2);
  return Centred(walk.chain(), rng);
}

// No join at all: every cut is false.
inline Shape Ellipse(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const double major = 15 + 60 * u(*rng);
  Shape shape;
  shape.outline = EllipsePolygon({155 + 10 * u(*rng), 115 + 10 * u(*rng)},
                                 major,
                                 major * (0.5 + 0.5 * u(*rng)),
                                 M_PI * u(*rng));
  return shape;
}

// Chains of 12 and more points, linked as the features stage links grey images.
inline std::vector<EdgeChain> Chains(const cv::Mat& image) {
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

}  // namespace horopter
