// What both bundles have in common: the robust cost of points and lines seen by cameras of one
// kind, and how it changes.
#pragma once

#include <vector>

#include "server/vision/reconstruction/bundle_covariance.h"
#include "server/vision/reconstruction/bundle_observations.h"
#include "server/vision/reconstruction/bundle_residuals.h"
#include "server/vision/reconstruction/robust_curvature.h"

namespace horopter {

// Camera: CameraMatrix or CalibratedCamera.
template <typename Camera>
struct BundleState {
  std::vector<Camera> cameras;          // of the layout
  std::vector<Eigen::Vector4d> points;  // of the tracks, |X| = 1
  std::vector<LineSpan> lines;
};

// C: parameters of a camera. References must outlive it.
template <int C, typename Camera>
class BundleModel {
 public:
  using State = BundleState<Camera>;

  BundleModel(const MultiviewTracks& tracks,
              const BundleObservations& used,
              RobustLoss loss,
              double loss_scale)
      : tracks_(tracks), used_(used), loss_(loss), c_(loss_scale * TuningConstant(loss)) {}

  // Squared residuals in sigmas, sum over `body(observation, feature, r^2)`.
  template <typename Body>
  void ForEachResidual(const State& state, const Body& body) const {
    for (int f = 0; f < used_.layout.Features(); ++f) {
      for (int k = used_.layout.first[f]; k < used_.layout.first[f + 1]; ++k) {
        const Camera& camera = state.cameras[used_.layout.camera[k]];
        const int o = used_.observation[k];
        body(k,
             f,
             f < used_.points
                 ? Residual(tracks_.point_observations[o], camera, state.points[f]).squaredNorm()
                 : Residual(tracks_.line_observations[o], camera, state.lines[f - used_.points])
                       .squaredNorm());
      }
    }
  }

  double Cost(const State& state) const {
    double cost = 0.0;
    ForEachResidual(state, [&](int, int, double squared) {
      cost += RobustCost(loss_, std::sqrt(squared), c_);
    });
    return cost;
  }

  void Linearize(const State& state, Bend bend, NormalEquations<C>* normal) const {
    for (int f = 0; f < used_.layout.Features(); ++f) {
      if (!IsUsed(f)) continue;
      const bool is_point = f < used_.points;
      const LineSpan N =
          is_point ? LineSpan::Zero() : LineComplement(state.lines[f - used_.points]);
      for (int k = used_.layout.first[f]; k < used_.layout.first[f + 1]; ++k) {
        const int i = used_.layout.camera[k], o = used_.observation[k];
        const Linearized<C> l =
            is_point ? horopter::Linearize(
                           tracks_.point_observations[o], state.cameras[i], state.points[f])
                     : horopter::Linearize(tracks_.line_observations[o],
                                           state.cameras[i],
                                           state.lines[f - used_.points],
                                           N);
        const double r = l.r.norm(), weight = RobustWeight(loss_, r, c_);
        if (!(weight > 0.0)) continue;
        const double curvature = bend == Bend::kCurvature ? RobustCurvature(loss_, r, c_) : 1.0;
        normal->Add(k, i, f, weight, curvature, l.r, l.J_camera, l.J_feature);
      }
      // The scale of a homogeneous point: no residual sees it, and nothing shall move along it.
      if (!is_point) continue;
      const Eigen::Vector4d& X = state.points[f];
      normal->V[f] += normal->V[f].trace() * X * X.transpose();
    }
  }

  void MoveFeatures(const BundleStep<C>& step, State* state) const {
    for (int f = 0; f < used_.layout.Features(); ++f) {
      if (!IsUsed(f)) continue;
      if (f < used_.points) {
        state->points[f] = (state->points[f] + step.features[f]).normalized();
      } else {
        LineSpan& line = state->lines[f - used_.points];
        line = MoveLine(line, step.features[f]);
      }
    }
  }

  // Tangent directions of the features; of the cameras none yet.
  TangentBases<C> FeatureBases(const State& state) const {
    TangentBases<C> bases;
    for (int f = 0; f < used_.layout.Features(); ++f) {
      if (!IsUsed(f)) {
        bases.features.push_back(Eigen::Matrix<double, 4, 0>());
      } else if (f < used_.points) {
        bases.features.push_back(SphereTangent<4>(state.points[f]));
      } else {
        bases.features.push_back(Eigen::Matrix4d::Identity());
      }
    }
    return bases;
  }

 private:
  bool IsUsed(int f) const { return used_.layout.first[f] < used_.layout.first[f + 1]; }

  const MultiviewTracks& tracks_;
  const BundleObservations& used_;
  RobustLoss loss_;
  double c_;
};

// Residuals without those of priors, minus unknowns that are not gauge.
template <int C>
int Redundancy(const BundleObservations& used, const TangentBases<C>& bases, int gauge_freedom) {
  int redundancy = 2 * static_cast<int>(used.observation.size()) + gauge_freedom;
  for (const auto& basis : bases.cameras) redundancy -= static_cast<int>(basis.cols());
  for (const auto& basis : bases.features) redundancy -= static_cast<int>(basis.cols());
  return redundancy;
}

// Reading and writing the features of a scene.
inline LineSpan SpanOf(const PluckerLine& line) {
  const auto points = PointsOnLine(ToOrthonormal(line));
  LineSpan X;
  X << points[0], points[1];
  return X;
}
inline PluckerLine LineOf(const LineSpan& X) {
  return JoinPoints(Eigen::Vector4d(X.col(0)), Eigen::Vector4d(X.col(1))).normalized();
}
// Which cameras and features of a scene are there.
template <typename Cameras, typename Points, typename Lines>
KnownScene Known(const Cameras& cameras, const Points& points, const Lines& lines) {
  KnownScene known;
  for (const auto& x : cameras) known.views.push_back(x.has_value());
  for (const auto& x : points) known.points.push_back(x.has_value());
  for (const auto& x : lines) known.lines.push_back(x.has_value());
  return known;
}

}  // namespace horopter
