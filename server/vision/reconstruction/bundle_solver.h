// Levenberg-Marquardt for bundles: every residual has two rows and depends on one camera and one
// feature, so that the features are eliminated one by one and only the cameras' system is dense
// (Schur complement; Triggs et al. 2000, section 6). Blocks have fixed sizes, sums a fixed order:
// the same input gives the same bits.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <vector>

#include "server/base/stop_scope.h"

namespace horopter {

// Parameters of a feature: a homogeneous point, or the tangent of a line.
inline constexpr int kFeatureParameters = 4;

// Which observations there are, feature after feature, cameras ascending within a feature.
struct BundleLayout {
  int cameras = 0;
  std::vector<int> first = {0};  // per feature its first observation; one past the end at the end
  std::vector<int> camera;       // per observation
  int Features() const { return static_cast<int>(first.size()) - 1; }
};

// J^T J (with the curvature of the loss in it) and J^T r. C: parameters of a camera. Blocks of a
// camera and a feature, W = K F, stay factors: an observation has two rows, so they have rank two,
// and eliminating features takes half the work.
template <int C>
struct NormalEquations {
  using CameraVector = Eigen::Matrix<double, C, 1>;
  using CameraFactor = Eigen::Matrix<double, C, 2>;
  using FeatureFactor = Eigen::Matrix<double, 2, kFeatureParameters>;
  std::vector<Eigen::Matrix<double, C, C>> U;  // per camera
  std::vector<Eigen::Matrix4d> V;              // per feature
  std::vector<CameraFactor> K;   // per observation: J_camera^T times a root of its Hessian
  std::vector<FeatureFactor> F;  // ... and J_feature
  std::vector<CameraVector> camera_gradient;
  std::vector<Eigen::Vector4d> feature_gradient;
  // What ties cameras to each other (several images of one camera): J^T J of all their parameters,
  // of which the upper triangle counts. Empty: nothing does.
  Eigen::MatrixXd coupling;

  void SetZero(const BundleLayout& layout) {
    U.assign(layout.cameras, Eigen::Matrix<double, C, C>::Zero());
    V.assign(layout.Features(), Eigen::Matrix4d::Zero());
    K.assign(layout.camera.size(), CameraFactor::Zero());
    F.assign(layout.camera.size(), FeatureFactor::Zero());
    camera_gradient.assign(layout.cameras, CameraVector::Zero());
    feature_gradient.assign(layout.Features(), Eigen::Vector4d::Zero());
    coupling.resize(0, 0);
  }

  // One observation's residual and Jacobians. Its cost bends by `weight` across the residual and by
  // `curvature` times that along it (robust_curvature.h).
  void Add(int observation,
           int camera,
           int feature,
           double weight,
           double curvature,
           const Eigen::Vector2d& r,
           const Eigen::Matrix<double, 2, C>& J_camera,
           const Eigen::Matrix<double, 2, kFeatureParameters>& J_feature) {
    const double squared = r.squaredNorm();
    Eigen::Matrix2d root = Eigen::Matrix2d::Identity();
    if (squared > 0.0) root -= (1.0 - std::sqrt(curvature)) / squared * r * r.transpose();
    root *= std::sqrt(weight);
    const Eigen::Vector2d scaled = weight * r;
    const CameraFactor& k = K[observation] = J_camera.transpose().lazyProduct(root);
    const FeatureFactor& f = F[observation] = root.lazyProduct(J_feature);
    U[camera] += k.lazyProduct(k.transpose());
    V[feature] += f.transpose().lazyProduct(f);
    camera_gradient[camera] += J_camera.transpose().lazyProduct(scaled);
    feature_gradient[feature] += J_feature.transpose().lazyProduct(scaled);
  }
};

// The features eliminated: V = L L^T, Z = F L^-T, S = U - sum (K Z) (K Z)^T.
template <int C>
struct SchurComplement {
  Eigen::MatrixXd S;               // upper triangle of blocks; below it nothing
  std::vector<Eigen::Matrix4d> L;  // per feature
  std::vector<typename NormalEquations<C>::FeatureFactor> Z;  // per observation
};

// False when a V is not positive definite (nothing is damped without damping). For C = 10 and 12.
template <int C>
bool EliminateFeatures(const BundleLayout& layout,
                       const NormalEquations<C>& normal,
                       double damping,
                       SchurComplement<C>* out);

template <int C>
struct BundleStep {
  std::vector<Eigen::Matrix<double, C, 1>> cameras;
  std::vector<Eigen::Vector4d> features;
  double predicted = 0.0;  // decrease of the cost by the linear model
};

// The step that solves (J^T J + damping diag(J^T J)) step = -J^T r. Damping > 0 is what makes a
// free gauge solvable. Features without observations do not move. False when the system is not
// positive definite or not finite. For C = 10 and 12.
template <int C>
bool SolveDamped(const BundleLayout& layout,
                 const NormalEquations<C>& normal,
                 double damping,
                 BundleStep<C>* step);

struct BundleSolverOptions {
  int max_iterations = 30;
  double function_tolerance = 1e-6;  // relative decrease at which it stops
  // Of the diagonal. The least is what keeps a free gauge solvable, and slows down directions that
  // the observations hardly determine.
  double first_damping = 1e-5;
  double min_damping = 1e-8;
};

// What a linearisation takes the robust cost to bend like along a residual: like its square with
// the weight of the place, which holds from afar, or as it does there (robust_curvature.h), without
// which the last steps creep.
enum class Bend { kWeights, kCurvature };

struct BundleReport {
  bool usable = false;
  double cost = 0.0;
  int iterations = 0;  // linearisations
};

// Minimises model.Cost(state), starting from *state. The model has
//   double Cost(const State&) const                        not finite where it has no meaning,
//   void Linearize(const State&, Bend, NormalEquations<C>*) const  at a place of finite cost,
//   State Moved(const State&, const BundleStep<C>&) const.
// Damping follows Nielsen (1999). Unusable, and *state unchanged, when the cost is not finite at
// the start.
template <int C, typename Model, typename State>
BundleReport MinimizeBundle(const BundleLayout& layout,
                            const BundleSolverOptions& options,
                            const Model& model,
                            State* state) {
  constexpr double kGiveUp = 1e10;  // damping at which a step is nothing against the parameters
  constexpr double kNear = 0.03;    // relative decrease from which on curvatures hold
  BundleReport report;
  report.cost = model.Cost(*state);
  if (!std::isfinite(report.cost)) return report;
  report.usable = true;
  double damping = options.first_damping, growth = 2.0;
  NormalEquations<C> normal;
  BundleStep<C> step;
  Bend bend = Bend::kWeights;
  bool converged = false;
  while (!converged && report.iterations < options.max_iterations) {
    LeaveIfStopped();
    ++report.iterations;
    normal.SetZero(layout);
    model.Linearize(*state, bend, &normal);
    bool moved = false;
    while (!moved && damping < kGiveUp) {
      if (SolveDamped(layout, normal, damping, &step)) {
        State next = model.Moved(*state, step);
        const double cost = model.Cost(next);
        const double gain = (report.cost - cost) / step.predicted;
        if (cost <= report.cost && gain > 0.0) {
          const double decrease = (report.cost - cost) / report.cost;
          converged = decrease <= options.function_tolerance;
          bend = decrease < kNear ? Bend::kCurvature : Bend::kWeights;
          *state = std::move(next);
          report.cost = cost;
          moved = true;
          const double t = 2.0 * gain - 1.0;
          damping = std::max(options.min_damping, damping * std::max(0.1, 1.0 - t * t * t));
          growth = 2.0;
          continue;
        }
        // Nothing left to gain: rounding decides.
        if (step.predicted <= options.function_tolerance * report.cost * 1e-3) break;
      }
      if (bend == Bend::kCurvature) break;
      damping *= growth;
      growth *= 2.0;
    }
    if (moved) continue;
    if (bend == Bend::kWeights) break;
    bend = Bend::kWeights;
  }
  return report;
}

}  // namespace horopter
