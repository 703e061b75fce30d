// Projection, fundamental matrix and trifocal tensor.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "server/vision/geometry/collineation.h"
#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/geometry/projection.h"
#include "server/vision/geometry/trifocal_tensor.h"
#include "tests/server/vision/geometry/up_to_scale.h"
#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

constexpr int kTrials = 100;

CameraMatrix RandomCamera(RandomSpace* space) {
  CameraMatrix P;
  for (double& x : P.reshaped()) x = space->Normal();
  return P;
}

// A pinhole camera (f = 900 px) that looks at the origin from about 5 away.
CameraMatrix LookingCamera(RandomSpace* space) {
  const Eigen::Vector3d w = 0.4 * space->Noise(3);
  Eigen::Matrix3d K;
  K << 900, 0, 320, 0, 900, 240, 0, 0, 1;
  CameraMatrix P;
  P << Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix(),
      Eigen::Vector3d(0.2 * space->Normal(), 0.2 * space->Normal(), 5.0);
  return K * P;
}

TEST(Projection, LineOfTwoPointsIsTheLineThroughTheirImages) {
  RandomSpace space(1);
  for (int k = 0; k < kTrials; ++k) {
    const CameraMatrix P = RandomCamera(&space);
    const Eigen::Vector4d a = space.Point(), b = space.Point();
    const Eigen::Vector3d l = LineCamera(P) * JoinPoints(a, b);
    EXPECT_LT((l - (P * a).cross(P * b)).norm(), 1e-10 * (1.0 + l.norm()));
    // [ [p]x M | cof(M) ]
    const Eigen::Matrix3d M = P.leftCols<3>();
    LineCameraMatrix expected;
    expected << CrossMatrix(P.col(3)) * M, M.determinant() * M.inverse().transpose();
    EXPECT_LT((LineCamera(P) - expected).norm(), 1e-9 * (1.0 + expected.norm()));
    EXPECT_NEAR(ProjectLine(P, JoinPoints(a, b)).dot(ProjectPoint(P, a).homogeneous()), 0.0, 1e-6);
  }
}

TEST(Projection, CentreProjectsToNothingAndLiesInEveryBackProjectedPlane) {
  RandomSpace space(2);
  for (int k = 0; k < kTrials; ++k) {
    const CameraMatrix P = RandomCamera(&space);
    const Eigen::Vector4d C = CameraCenter(P);
    EXPECT_LT((P * C).norm(), 1e-10 * (1.0 + C.norm()));
    EXPECT_NEAR(C.w(), P.leftCols<3>().determinant(), 1e-10);
    const Eigen::Vector4d a = space.Point(), b = space.Point();
    const Eigen::Vector3d l = (P * a).cross(P * b);
    const Eigen::Vector4d plane = BackProjectLine(P, l);
    EXPECT_NEAR(plane.dot(C), 0.0, 1e-9 * (1.0 + plane.norm() * C.norm()));
    EXPECT_NEAR(plane.dot(a), 0.0, 1e-9 * (1.0 + plane.norm() * a.norm()));
    CameraMatrix canonical = CameraMatrix::Zero();
    canonical.leftCols<3>().setIdentity();
    EXPECT_LT((P * CanonicalFrame(P) - canonical).norm(), 1e-8);
  }
}

TEST(Projection, DepthIsPositiveInFrontForEitherSignOfTheMatrix) {
  RandomSpace space(3);
  for (int k = 0; k < kTrials; ++k) {
    const CameraMatrix P = LookingCamera(&space);
    const Eigen::Vector4d x = space.Scale() * Eigen::Vector4d(0.5 * space.Normal(), 0, 0, 1.0);
    for (const double sign : {1.0, -1.0})
      EXPECT_NEAR(SignedDepth(sign * P, x) / 5.0 / std::cbrt(P.leftCols<3>().determinant()) *
                      std::cbrt(900.0 * 900.0),
                  1.0,
                  0.6);
    EXPECT_LT(SignedDepth(P,
                          Eigen::Vector4d(P.row(2).head<3>()(0) * -100,
                                          P.row(2).head<3>()(1) * -100,
                                          P.row(2).head<3>()(2) * -100,
                                          1.0)),
              0.0);
  }
}

TEST(FundamentalMatrix, HoldsForAllPointsAndIgnoresCollineations) {
  RandomSpace space(4);
  for (int k = 0; k < kTrials; ++k) {
    const CameraMatrix A = RandomCamera(&space), B = RandomCamera(&space);
    const Eigen::Matrix3d F = FundamentalFromCameras(A, B);
    for (int i = 0; i < 5; ++i) {
      const Eigen::Vector4d x = space.Point();
      EXPECT_NEAR((B * x).normalized().dot(F * (A * x).normalized()), 0.0, 1e-9);
    }
    EXPECT_NEAR(F.determinant(), 0.0, 1e-10);
    const Eigen::Matrix4d H = space.Collineation();
    EXPECT_LT(Apart(FundamentalFromCameras(A * H, B * H), F), 1e-6);
    const auto [P1, P2] = CamerasFromFundamental(F);
    EXPECT_LT(Apart(FundamentalFromCameras(P1, P2), F), 1e-8);
    EXPECT_LT((F * EpipoleA(F)).norm() + (F.transpose() * EpipoleB(F)).norm(), 1e-10);
    EXPECT_LT(Apart(EpipoleB(F), B * CameraCenter(A)), 1e-6);
  }
}

struct TwoViews {
  Eigen::Matrix3d F;
  std::vector<Eigen::Vector2d> a, b;
};

TwoViews MakeTwoViews(RandomSpace* space, int points, double noise_px, bool planar) {
  const CameraMatrix A = LookingCamera(space), B = LookingCamera(space);
  TwoViews out{FundamentalFromCameras(A, B), {}, {}};
  for (int i = 0; i < points; ++i) {
    Eigen::Vector4d x = space->Point();
    if (planar) x.z() = 0.3 * x.x();
    out.a.push_back(ProjectPoint(A, x) + noise_px * Eigen::Vector2d(space->Noise(2)));
    out.b.push_back(ProjectPoint(B, x) + noise_px * Eigen::Vector2d(space->Noise(2)));
  }
  return out;
}

TEST(FundamentalMatrix, SevenAndEightPointsRecoverIt) {
  RandomSpace space(5);
  for (int k = 0; k < kTrials; ++k) {
    const TwoViews views = MakeTwoViews(&space, 12, 0.0, false);
    const auto eight = EightPoint(views.a, views.b);
    ASSERT_TRUE(eight);
    EXPECT_LT(Apart(*eight, views.F), 1e-6);
    const auto seven = SevenPoint(std::span<const Eigen::Vector2d, 7>(views.a.data(), 7),
                                  std::span<const Eigen::Vector2d, 7>(views.b.data(), 7));
    ASSERT_FALSE(seven.empty());
    double best = 1.0;
    for (const Eigen::Matrix3d& F : seven) {
      EXPECT_NEAR(F.determinant(), 0.0, 1e-12);
      best = std::min(best, Apart(F, views.F));
    }
    EXPECT_LT(best, 1e-5);
  }
}

TEST(FundamentalMatrix, SampsonErrorFollowsTheNoise) {
  RandomSpace space(6);
  for (const double noise : {0.01, 0.1, 1.0}) {
    const TwoViews views = MakeTwoViews(&space, 400, noise, false);
    const auto F = EightPoint(views.a, views.b);
    ASSERT_TRUE(F);
    double sum = 0.0;
    for (size_t i = 0; i < views.a.size(); ++i) sum += SampsonSquared(*F, views.a[i], views.b[i]);
    EXPECT_NEAR(std::sqrt(sum / 400.0) / noise, 1.0, 0.25);
  }
}

TEST(FundamentalMatrix, RefusesAPlaneAndTooFewPoints) {
  RandomSpace space(7);
  const TwoViews planar = MakeTwoViews(&space, 20, 0.0, true);
  EXPECT_FALSE(EightPoint(planar.a, planar.b));
  const TwoViews few = MakeTwoViews(&space, 7, 0.0, false);
  EXPECT_FALSE(EightPoint(few.a, few.b));
}

struct ThreeViews {
  std::array<CameraMatrix, 3> P;
  std::vector<Triplet> points, lines;
};

ThreeViews MakeThreeViews(RandomSpace* space, int points, int lines, double noise_px) {
  ThreeViews out;
  for (CameraMatrix& P : out.P) P = LookingCamera(space);
  const auto image = [&](int v, const Eigen::Vector4d& x) {
    return Eigen::Vector3d(
        (ProjectPoint(out.P[v], x) + noise_px * Eigen::Vector2d(space->Noise(2))).homogeneous());
  };
  for (int i = 0; i < points; ++i) {
    const Eigen::Vector4d x = space->Point();
    out.points.push_back({image(0, x), image(1, x), image(2, x)});
  }
  for (int i = 0; i < lines; ++i) {
    const Eigen::Vector4d a = space->Point(), b = space->Point();
    Triplet l;
    for (int v = 0; v < 3; ++v) l[v] = image(v, a).cross(image(v, b));
    out.lines.push_back(l);
  }
  return out;
}

double Difference(const TrifocalTensor& a, const TrifocalTensor& b) {
  double same = 0.0, opposite = 0.0;
  for (int i = 0; i < 3; ++i) {
    same += (a[i] - b[i]).squaredNorm();
    opposite += (a[i] + b[i]).squaredNorm();
  }
  return std::sqrt(std::min(same, opposite));
}

TEST(TrifocalTensor, TransfersPointsAndLinesAndIgnoresCollineations) {
  RandomSpace space(8);
  for (int k = 0; k < kTrials; ++k) {
    const std::array<CameraMatrix, 3> P = {
        RandomCamera(&space), RandomCamera(&space), RandomCamera(&space)};
    const TrifocalTensor T = TrifocalFromCameras(P[0], P[1], P[2]);
    const Eigen::Vector4d a = space.Point(), b = space.Point();
    const PluckerLine line = JoinPoints(a, b);
    EXPECT_LT(Apart(TransferLine(T, LineCamera(P[1]) * line, LineCamera(P[2]) * line),
                    LineCamera(P[0]) * line),
              1e-6);
    EXPECT_LT(Apart(TransferPoint(T, P[0] * a, LineCamera(P[1]) * line), P[2] * a), 1e-6);
    const Eigen::Matrix4d H = space.Collineation();
    EXPECT_LT(Difference(TrifocalFromCameras(P[0] * H, P[1] * H, P[2] * H), T), 1e-8);
    const auto back = CamerasFromTrifocal(T);
    ASSERT_TRUE(back);
    EXPECT_LT(Difference(TrifocalFromCameras((*back)[0], (*back)[1], (*back)[2]), T), 1e-7);
    // Its pairs are those of the cameras.
    EXPECT_LT(
        Apart(FundamentalFromCameras((*back)[1], (*back)[2]), FundamentalFromCameras(P[1], P[2])),
        1e-4);
  }
}

TEST(TrifocalTensor, IsEstimatedFromPointsLinesAndBoth) {
  RandomSpace space(9);
  const std::vector<std::pair<int, int>> sets = {{7, 0}, {0, 13}, {4, 6}, {20, 0}, {0, 30}};
  for (int k = 0; k < 50; ++k) {
    const auto [points, lines] = sets[k % sets.size()];
    SCOPED_TRACE(testing::Message() << points << " points, " << lines << " lines, trial " << k);
    const ThreeViews views = MakeThreeViews(&space, points, lines, 0.0);
    const auto T = EstimateTrifocal(views.points, views.lines);
    ASSERT_TRUE(T);
    EXPECT_LT(Difference(*T, TrifocalFromCameras(views.P[0], views.P[1], views.P[2])), 1e-4);
  }
}

TEST(TrifocalTensor, NoisyEstimateTransfersWithinAFewTimesTheNoise) {
  RandomSpace space(10);
  for (const double noise : {0.01, 0.1}) {
    std::vector<double> errors;
    for (int k = 0; k < 20; ++k) {
      const ThreeViews views = MakeThreeViews(&space, 20, 20, noise);
      const auto T = EstimateTrifocal(views.points, views.lines);
      ASSERT_TRUE(T);
      const auto P = CamerasFromTrifocal(*T);
      ASSERT_TRUE(P);
      for (const Triplet& x : views.points) {
        // A line through x2 that is not the epipolar line: perpendicular to it.
        const Eigen::Vector3d epipolar = FundamentalFromCameras((*P)[0], (*P)[1]) * x[0];
        const Eigen::Vector3d across(-epipolar.y(), epipolar.x(), 0.0);
        Eigen::Vector3d l(across.x(), across.y(), 0.0);
        l.z() = -l.head<2>().dot(x[1].head<2>());
        errors.push_back((TransferPoint(*T, x[0], l).hnormalized() - x[2].head<2>()).norm());
      }
    }
    std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
    EXPECT_LT(errors[errors.size() / 2], 6.0 * noise);
  }
}

TEST(TrifocalTensor, RefusesTooFewAndParallelLines) {
  RandomSpace space(11);
  const ThreeViews few = MakeThreeViews(&space, 3, 6, 0.0);
  EXPECT_FALSE(EstimateTrifocal(few.points, few.lines));
  ThreeViews views = MakeThreeViews(&space, 0, 0, 0.0);
  for (int i = 0; i < 20; ++i) {
    const Eigen::Vector4d a = space.Point();
    const PluckerLine line = JoinPoints(a, a + Eigen::Vector4d(1.0, 0.5, 0.2, 0.0));
    Triplet l;
    for (int v = 0; v < 3; ++v) l[v] = ProjectLine(views.P[v], line);
    views.lines.push_back(l);
  }
  EXPECT_FALSE(EstimateTrifocal({}, views.lines));
}

}  // namespace
}  // namespace horopter
