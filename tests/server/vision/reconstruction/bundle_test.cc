// The bundle's solver, derivatives and parameters against dense algebra and differences.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "server/vision/reconstruction/bundle_covariance.h"
#include "server/vision/reconstruction/bundle_residuals.h"

namespace horopter {
namespace {

class Random {
 public:
  explicit Random(unsigned seed) : rng_(seed) {}
  double operator()(double low, double high) {
    return low + (high - low) * (static_cast<double>(rng_()) + 0.5) / 4294967296.0;
  }
  template <typename Matrix>
  Matrix In(double low, double high) {
    Matrix M;
    for (Eigen::Index c = 0; c < M.cols(); ++c) {
      for (Eigen::Index r = 0; r < M.rows(); ++r) M(r, c) = (*this)(low, high);
    }
    return M;
  }

 private:
  std::mt19937 rng_;
};

LineSpan RandomSpan(Random* random) {
  const LineSpan raw = random->In<LineSpan>(-1, 1) + 0.5 * LineSpan::Identity();
  const Eigen::Matrix4d Q = Eigen::HouseholderQR<LineSpan>(raw).householderQ();
  return Q.leftCols<2>();
}

TEST(Manifolds, TangentsAreOrthonormalAndOrthogonal) {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    Random random(seed);
    Eigen::Vector4d x = random.In<Eigen::Vector4d>(-1, 1);
    if (seed == 1) x = Eigen::Vector4d::UnitX();
    if (seed == 2) x = -Eigen::Vector4d::UnitX();
    if (seed == 3) x = Eigen::Vector4d::UnitW();
    const auto T = SphereTangent<4>(x);
    EXPECT_LT((T.transpose() * T - Eigen::Matrix3d::Identity()).norm(), 1e-12) << seed;
    EXPECT_LT((T.transpose() * x).norm(), 1e-12) << seed;
    const LineSpan X = RandomSpan(&random), N = LineComplement(X);
    EXPECT_LT((N.transpose() * N - Eigen::Matrix2d::Identity()).norm(), 1e-12);
    EXPECT_LT((N.transpose() * X).norm(), 1e-12);
  }
}

TEST(Manifolds, LinesMoveByTheirStepAndStayOrthonormal) {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    Random random(seed);
    const LineSpan X = RandomSpan(&random);
    const Eigen::Vector4d step = random.In<Eigen::Vector4d>(-0.3, 0.3);
    const LineSpan Y = MoveLine(X, step);
    EXPECT_LT((Y.transpose() * Y - Eigen::Matrix2d::Identity()).norm(), 1e-12);
    // The new span in terms of the old one and its complement: [I; D].
    const Eigen::Matrix2d D = LineComplement(X).transpose() * Y * (X.transpose() * Y).inverse();
    EXPECT_LT((D - Eigen::Map<const Eigen::Matrix2d>(step.data())).norm(), 1e-10) << seed;
  }
}

// Differences of a residual along each parameter.
template <int N, typename Residual>
Eigen::Matrix<double, 2, N> Differences(const Residual& residual) {
  Eigen::Matrix<double, 2, N> J;
  constexpr double kStep = 1e-6;
  for (int k = 0; k < N; ++k) {
    const Eigen::Matrix<double, N, 1> d = kStep * Eigen::Matrix<double, N, 1>::Unit(k);
    J.col(k) = (residual(d) - residual(-d)) / (2.0 * kStep);
  }
  return J;
}

struct Sample {
  Eigen::Vector4d X;
  LineSpan span;
  PointObservation point;
  LineObservation line;
};

Sample RandomSample(double pixels, Random* random) {
  Sample s;
  s.X = (random->In<Eigen::Vector4d>(-0.5, 0.5) + Eigen::Vector4d::UnitW()).normalized();
  s.span = RandomSpan(random);
  s.point = {0, 0, random->In<Eigen::Vector2d>(-pixels, pixels), (*random)(0.3, 2.0)};
  s.line = {0,
            0,
            random->In<Eigen::Vector2d>(-pixels, pixels),
            random->In<Eigen::Vector2d>(-pixels, pixels),
            (*random)(0.3, 2.0)};
  return s;
}

TEST(BundleResiduals, ProjectiveDerivativesAreThoseOfTheResidual) {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    Random random(seed);
    CameraMatrix P = random.In<CameraMatrix>(-1, 1);
    P.row(2) += 2.0 * Eigen::RowVector4d::UnitW();
    const Sample s = RandomSample(1.0, &random);
    using Vector12 = Eigen::Matrix<double, 12, 1>;
    const auto moved = [&](const Vector12& d) {
      CameraMatrix Q = P;
      for (int r = 0; r < 3; ++r) Q.row(r) += d.segment<4>(4 * r).transpose();
      return Q;
    };
    const auto point = Linearize(s.point, P, s.X);
    EXPECT_LT((point.r - Residual(s.point, P, s.X)).norm(), 1e-12);
    const auto by_camera =
        Differences<12>([&](const Vector12& d) { return Residual(s.point, moved(d), s.X); });
    const auto by_point = Differences<4>(
        [&](const Eigen::Vector4d& d) { return Residual(s.point, P, Eigen::Vector4d(s.X + d)); });
    EXPECT_LT((point.J_camera - by_camera).norm(), 1e-6 * by_camera.norm() + 1e-7) << seed;
    EXPECT_LT((point.J_feature - by_point).norm(), 1e-6 * by_point.norm() + 1e-7) << seed;

    const auto line = Linearize(s.line, P, s.span, LineComplement(s.span));
    EXPECT_LT((line.r - Residual(s.line, P, s.span)).norm(), 1e-12);
    const auto line_by_camera =
        Differences<12>([&](const Vector12& d) { return Residual(s.line, moved(d), s.span); });
    const auto by_line = Differences<4>(
        [&](const Eigen::Vector4d& d) { return Residual(s.line, P, MoveLine(s.span, d)); });
    EXPECT_LT((line.J_camera - line_by_camera).norm(), 1e-6 * line_by_camera.norm() + 1e-7) << seed;
    EXPECT_LT((line.J_feature - by_line).norm(), 1e-6 * by_line.norm() + 1e-7) << seed;
  }
}

CalibratedCamera RandomCamera(Random* random) {
  CalibratedCamera view;
  view.camera = CenteredCamera(640, 480, (*random)(600, 1200));
  view.camera.k1 = (*random)(-0.2, 0.2);
  view.camera_from_scene.R =
      Eigen::AngleAxisd((*random)(-2, 2), random->In<Eigen::Vector3d>(-1, 1).normalized())
          .toRotationMatrix();
  view.camera_from_scene.t = random->In<Eigen::Vector3d>(-0.3, 0.3) + Eigen::Vector3d(0, 0, 3);
  return view;
}

TEST(BundleResiduals, MetricDerivativesAreThoseOfTheResidual) {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    Random random(seed);
    const CalibratedCamera view = RandomCamera(&random);
    Sample s = RandomSample(150.0, &random);
    for (Eigen::Vector2d* x : {&s.point.pixel, &s.line.start, &s.line.end})
      *x += Eigen::Vector2d(320, 240);
    using Vector10 = Eigen::Matrix<double, 10, 1>;
    const auto close = [&](const auto& J, const auto& expected) {
      return (J - expected).norm() < 1e-5 * expected.norm() + 1e-6;
    };
    const auto point = Linearize(s.point, view, s.X);
    EXPECT_LT((point.r - Residual(s.point, view, s.X)).norm(), 1e-9);
    EXPECT_TRUE(close(point.J_camera, Differences<10>([&](const Vector10& d) {
                        return Residual(s.point, MoveCamera(view, d), s.X);
                      })))
        << seed;
    EXPECT_TRUE(close(point.J_feature, Differences<4>([&](const Eigen::Vector4d& d) {
                        return Residual(s.point, view, Eigen::Vector4d(s.X + d));
                      })))
        << seed;
    const auto line = Linearize(s.line, view, s.span, LineComplement(s.span));
    EXPECT_LT((line.r - Residual(s.line, view, s.span)).norm(), 1e-9);
    EXPECT_TRUE(close(line.J_camera, Differences<10>([&](const Vector10& d) {
                        return Residual(s.line, MoveCamera(view, d), s.span);
                      })))
        << seed;
    EXPECT_TRUE(close(line.J_feature, Differences<4>([&](const Eigen::Vector4d& d) {
                        return Residual(s.line, view, MoveLine(s.span, d));
                      })))
        << seed;
  }
}

TEST(BundleResiduals, PosePriorDerivativesAreThoseOfTheResidual) {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    Random random(seed);
    const CalibratedCamera view = RandomCamera(&random);
    PosePrior prior{view.camera_from_scene, 0.02, 0.01};
    if (seed > 1) {  // the first one is met exactly
      const double angle = std::exp(random(std::log(1e-6), std::log(2.0)));
      prior.camera_from_world.R =
          Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()) * prior.camera_from_world.R;
      prior.camera_from_world.t += random.In<Eigen::Vector3d>(-0.1, 0.1);
    }
    const auto J = Jacobian(prior, view.camera_from_scene);
    for (int k = 0; k < 6; ++k) {
      const Eigen::Matrix<double, 10, 1> d = 1e-6 * Eigen::Matrix<double, 10, 1>::Unit(k);
      const Eigen::Matrix<double, 6, 1> slope =
          (Residual(prior, MoveCamera(view, d).camera_from_scene) -
           Residual(prior, MoveCamera(view, -d).camera_from_scene)) /
          2e-6;
      EXPECT_LT((J.col(k) - slope).norm(), 1e-4 * slope.norm() + 1e-4) << seed << " " << k;
    }
  }
}

// A random sparse problem and its normal matrix in full, cameras first.
struct Problem {
  BundleLayout layout;
  NormalEquations<10> normal;
  Eigen::MatrixXd A;
  Eigen::VectorXd g;
};

Problem RandomProblem(unsigned seed) {
  Random random(seed);
  Problem p;
  p.layout.cameras = 4;
  const int features = 30, at = 10 * p.layout.cameras;
  std::vector<int> feature_of;
  for (int f = 0; f < features; ++f) {
    for (int i = 0; i < p.layout.cameras; ++i) {
      // Two cameras determine four parameters; the eighth feature is seen by nobody.
      if (f == 7 || (i > 1 && random(0, 1) < 0.5)) continue;
      p.layout.camera.push_back(i);
      feature_of.push_back(f);
    }
    p.layout.first.push_back(static_cast<int>(p.layout.camera.size()));
  }
  p.normal.SetZero(p.layout);
  const int n = at + 4 * features;
  p.A = Eigen::MatrixXd::Zero(n, n);
  p.g = Eigen::VectorXd::Zero(n);
  for (size_t k = 0; k < feature_of.size(); ++k) {
    const auto r = random.In<Eigen::Vector2d>(-1, 1);
    const auto J_camera = random.In<Eigen::Matrix<double, 2, 10>>(-1, 1);
    const auto J_feature = random.In<FeatureJacobian>(-1, 1);
    const double weight = random(0.1, 1.0), curvature = random(0.1, 1.0);
    p.normal.Add(static_cast<int>(k),
                 p.layout.camera[k],
                 feature_of[k],
                 weight,
                 curvature,
                 r,
                 J_camera,
                 J_feature);
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(2, n);
    J.middleCols(10 * p.layout.camera[k], 10) = J_camera;
    J.middleCols(at + 4 * feature_of[k], 4) = J_feature;
    const Eigen::Vector2d along = r.normalized();
    const Eigen::Matrix2d bend =
        Eigen::Matrix2d::Identity() - (1.0 - curvature) * along * along.transpose();
    p.A += weight * J.transpose() * bend * J;
    p.g += weight * J.transpose() * r;
  }
  return p;
}

TEST(BundleSolver, EliminationGivesTheDenseStepAndItsDecrease) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const Problem p = RandomProblem(seed);
    for (const double damping : {1e-3, 1.0, 100.0}) {
      BundleStep<10> step;
      ASSERT_TRUE(SolveDamped(p.layout, p.normal, damping, &step));
      Eigen::MatrixXd damped = p.A;
      damped.diagonal() += damping * p.A.diagonal().cwiseMax(1e-6);
      const Eigen::VectorXd x = damped.ldlt().solve(-p.g);
      Eigen::VectorXd ours(x.size());
      for (int i = 0; i < p.layout.cameras; ++i) ours.segment<10>(10 * i) = step.cameras[i];
      for (int f = 0; f < p.layout.Features(); ++f) {
        ours.segment<4>(10 * p.layout.cameras + 4 * f) = step.features[f];
      }
      EXPECT_LT((ours - x).norm(), 1e-8 * x.norm()) << seed << " " << damping;
      const double decrease = -p.g.dot(x) - 0.5 * x.dot(p.A * x);
      EXPECT_NEAR(step.predicted, decrease, 1e-8 * decrease) << seed << " " << damping;
    }
  }
}

TEST(BundleSolver, RefusesWhatIsNotFinite) {
  Problem p = RandomProblem(1);
  p.normal.V[3](1, 1) = std::nan("");
  BundleStep<10> step;
  EXPECT_FALSE(SolveDamped(p.layout, p.normal, 1e-3, &step));
}

TEST(BundleCovariance, IsTheInverseOfTheNormalMatrixWithoutGauge) {
  Problem p = RandomProblem(3);
  TangentBases<10> bases;
  for (int i = 0; i < p.layout.cameras; ++i) {
    bases.cameras.push_back(Eigen::Matrix<double, 10, 10>::Identity().leftCols(9));
  }
  std::vector<int> kept, features;
  for (int i = 0; i < p.layout.cameras; ++i) {
    for (int k = 0; k < 9; ++k) kept.push_back(10 * i + k);
  }
  for (int f = 0; f < p.layout.Features(); ++f) {
    const bool in = p.layout.first[f + 1] > p.layout.first[f];
    bases.features.push_back(in ? Eigen::Matrix4d::Identity().leftCols(4)
                                : Eigen::Matrix4d::Identity().leftCols(0));
    if (!in) continue;
    features.push_back(f);
    for (int k = 0; k < 4; ++k) kept.push_back(10 * p.layout.cameras + 4 * f + k);
  }
  const auto covariance = InvertBundle<10>(p.layout, p.normal, bases, 0);
  ASSERT_TRUE(covariance);
  const auto n = static_cast<Eigen::Index>(kept.size());
  Eigen::MatrixXd reduced(n, n);
  for (Eigen::Index r = 0; r < n; ++r) {
    for (Eigen::Index c = 0; c < n; ++c) reduced(r, c) = p.A(kept[r], kept[c]);
  }
  const Eigen::MatrixXd inverse = reduced.inverse();
  const int cameras = 9 * p.layout.cameras;
  EXPECT_LT((covariance->cameras - inverse.topLeftCorner(cameras, cameras)).norm(),
            1e-6 * inverse.norm());
  const Eigen::MatrixXd joint = covariance->Features(features);
  EXPECT_LT((joint - inverse.bottomRightCorner(joint.rows(), joint.cols())).norm(),
            1e-6 * inverse.norm());
}

}  // namespace
}  // namespace horopter
