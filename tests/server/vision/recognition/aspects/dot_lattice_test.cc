#include "server/vision/recognition/aspects/dot_lattice.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/support/random.h"

namespace horopter {
namespace {

constexpr double kHoleShare = 0.5;  // of the spacing

// A plane seen obliquely: a spacing of 30 px in front, of 9 px at the back of the image.
Eigen::Matrix3d Oblique(double turn) {
  Eigen::Matrix3d H;
  H << 30 * std::cos(turn), -22 * std::sin(turn), 320, 30 * std::sin(turn), 22 * std::cos(turn),
      300, 0.006 * std::sin(turn), -0.02 * std::cos(turn), 1;
  return H;
}

Eigen::Vector2d Mapped(const Eigen::Matrix3d& H, double i, double j) {
  const Eigen::Vector3d x = H * Eigen::Vector3d(i, j, 1);
  return x.head<2>() / x.z();
}

double SpacingAt(const Eigen::Matrix3d& H, int i, int j) {
  return std::min((Mapped(H, i + 1, j) - Mapped(H, i, j)).norm(),
                  (Mapped(H, i, j + 1) - Mapped(H, i, j)).norm());
}

bool IsInside(const Eigen::Vector2d& p) {
  return p.x() > 0 && p.y() > 0 && p.x() < 640 && p.y() < 480;
}

Dot DotAt(const Eigen::Matrix3d& H, int i, int j, Random* random, double noise) {
  return {(Mapped(H, i, j) + random->Noise(noise)).cast<float>(),
          static_cast<float>(kHoleShare * SpacingAt(H, i, j))};
}

// Dots inside the image but for one in `missing` and for those under a part in the middle.
std::vector<Dot> Lattice(const Eigen::Matrix3d& H, int missing, double noise, unsigned seed) {
  Random random(seed);
  std::vector<Dot> out;
  for (int j = -10; j <= 20; ++j) {
    for (int i = -20; i <= 20; ++i) {
      if ((H * Eigen::Vector3d(i, j, 1)).z() <= 0.2) continue;
      const Eigen::Vector2d at = Mapped(H, i, j);
      if (!IsInside(at) || (at - Eigen::Vector2d(320, 240)).norm() < 70) continue;
      if (missing > 0 && random.Index(missing) == 0) continue;
      out.push_back(DotAt(H, i, j, &random, noise));
    }
  }
  return out;
}

TEST(DotLattice, DotsAreNumberedWithTheirMap) {
  for (const double noise : {0.0, 0.3, 0.8}) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      SCOPED_TRACE(testing::Message() << "noise " << noise << " seed " << seed);
      const Eigen::Matrix3d H = Oblique(0.15 * seed);
      const std::vector<Dot> dots = Lattice(H, 8, noise, seed);
      const PlaneLatticeFit fit = FitPlaneLattice(dots);
      ASSERT_TRUE(fit.fits);
      EXPECT_GE(2 * fit.dots.size(), dots.size());  // enough for the map
      // Of whichever two steps were the shortest where the numbering began.
      EXPECT_NEAR(fit.lattice.size_share, kHoleShare, 0.12);
      for (std::size_t k = 0; k < fit.dots.size(); ++k) {
        const Eigen::Vector2d at =
            Mapped(fit.lattice.image_from_index, fit.indices[k].x(), fit.indices[k].y());
        EXPECT_LT((at - fit.dots[k].middle.cast<double>()).norm(), 0.1 + 4 * noise);
      }
    }
  }
}

TEST(DotLattice, HolesAreKnownWhereNothingIsLeftBesideThem) {
  const Eigen::Matrix3d H = Oblique(0.3);
  const std::vector<Dot> dots = Lattice(H, 0, 0.2, 1);
  // In the middle, where a part hides their neighbours: holes, and the same between the holes.
  Random random(2);
  std::vector<Dot> boxes;
  std::vector<bool> holes;
  for (int j = -6; j <= 0; ++j) {
    for (int i = -3; i <= 3; ++i) {
      if ((Mapped(H, i, j) - Eigen::Vector2d(320, 240)).norm() > 60) continue;
      boxes.push_back(DotAt(H, i, j, &random, 0.3));
      holes.push_back(true);
      boxes.push_back(boxes.back());
      boxes.back().middle = Mapped(H, i + 0.5, j + 0.5).cast<float>();
      holes.push_back(false);
      // Three times as large: a part's own.
      boxes.push_back(boxes[boxes.size() - 2]);
      boxes.back().size *= 3;
      holes.push_back(false);
    }
  }
  ASSERT_GT(boxes.size(), 15u);
  const std::vector<char> found = HolesOfLattice(dots, boxes);
  for (std::size_t k = 0; k < boxes.size(); ++k)
    EXPECT_EQ(found[k] != 0, holes[k]) << boxes[k].middle.transpose();
}

TEST(DotLattice, StrewnDotsAreNone) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    std::vector<Dot> dots;
    for (int k = 0; k < 300; ++k) {
      dots.push_back({Eigen::Vector2f(static_cast<float>(random.Uniform(0, 640)),
                                      static_cast<float>(random.Uniform(0, 480))),
                      static_cast<float>(random.Uniform(4, 12))});
    }
    EXPECT_FALSE(FitPlaneLattice(dots).fits);
    const std::vector<char> regular = RegularDots(dots);
    EXPECT_LT(std::count(regular.begin(), regular.end(), 1), 90);
  }
}

TEST(DotLattice, FewOrEqualDotsAreNone) {
  EXPECT_FALSE(FitPlaneLattice({}).fits);
  EXPECT_FALSE(FitPlaneLattice(std::vector<Dot>(100, Dot{{5, 5}, 3})).fits);
  std::vector<Dot> row;
  for (int i = 0; i < 60; ++i) row.push_back({{10.0f * static_cast<float>(i), 50.0f}, 4});
  EXPECT_FALSE(FitPlaneLattice(row).fits);
  EXPECT_TRUE(HolesOfLattice({}, {}).empty());
}

}  // namespace
}  // namespace horopter
