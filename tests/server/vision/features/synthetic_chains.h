// Edge chains of known shape: lines, arcs and corners walked one after the other, about one point
// per pixel.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <random>
#include <vector>

namespace horopter {

struct SyntheticChain {
  std::vector<Eigen::Vector2d> points;   // on the curve
  std::vector<Eigen::Vector2d> normals;  // unit, to the right of the walk (image axes, y down)
  std::vector<double> curvature;         // 1/px, positive where the walk turns from x towards y
  std::vector<int> joins;                // points at which one piece ends and the next begins

  // The points moved along their normals by independent noise.
  std::vector<Eigen::Vector2f> Noisy(double sigma_px, std::mt19937* rng) const {
    std::normal_distribution<double> normal(0.0, 1.0);
    std::vector<Eigen::Vector2f> out;
    for (size_t i = 0; i < points.size(); ++i) {
      out.push_back((points[i] + sigma_px * normal(*rng) * normals[i]).cast<float>());
    }
    return out;
  }
};

class ChainWalk {
 public:
  ChainWalk(const Eigen::Vector2d& start, double heading_rad) : at_(start), heading_(heading_rad) {}

  // Every piece after the first begins a join.
  ChainWalk& Line(double length_px) { return Go(length_px, 0.0); }
  // Positive turn: from x towards y.
  ChainWalk& Arc(double radius_px, double turn_rad) {
    return Go(radius_px * std::abs(turn_rad), std::copysign(1.0 / radius_px, turn_rad));
  }
  ChainWalk& Turn(double angle_rad) {
    heading_ += angle_rad;
    return *this;
  }

  const SyntheticChain& chain() const { return chain_; }

 private:
  ChainWalk& Go(double length, double kappa) {
    if (!chain_.points.empty()) chain_.joins.push_back(static_cast<int>(chain_.points.size()));
    const int steps = std::max(1, static_cast<int>(std::lround(length)));
    const Eigen::Vector2d start = at_;
    const double heading = heading_;
    const auto on_piece = [&](double s) -> Eigen::Vector2d {
      if (kappa == 0.0) return start + s * Eigen::Vector2d(std::cos(heading), std::sin(heading));
      const double turned = heading + kappa * s;
      return start + Eigen::Vector2d(std::sin(turned) - std::sin(heading),
                                     std::cos(heading) - std::cos(turned)) /
                         kappa;
    };
    for (int k = 0; k < steps; ++k) {
      const double s = length * k / steps, now = heading + kappa * s;
      chain_.points.push_back(on_piece(s));
      chain_.normals.push_back({-std::sin(now), std::cos(now)});
      chain_.curvature.push_back(kappa);
    }
    at_ = on_piece(length);
    heading_ = heading + kappa * length;
    return *this;
  }

  Eigen::Vector2d at_;
  double heading_;
  SyntheticChain chain_;
};

}  // namespace horopter
