#include "server/vision/geometry/box_tree.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <random>
#include <set>

namespace horopter {
namespace {

using Eigen::AlignedBox3d;
using Eigen::Vector3d;

std::set<int> AllAt(const BoxTree& tree, const Vector3d& p) {
  std::set<int> found;
  EXPECT_FALSE(tree.AnyAt(p, [&](int i) {
    EXPECT_TRUE(found.insert(i).second);
    return false;
  }));
  return found;
}

std::set<int> AllAt(const std::vector<AlignedBox3d>& boxes, const Vector3d& p) {
  std::set<int> found;
  for (int i = 0; i < static_cast<int>(boxes.size()); ++i) {
    if (boxes[i].contains(p)) found.insert(i);
  }
  return found;
}

TEST(BoxTree, FindsWhatAllBoxesOneByOneFind) {
  std::mt19937 rng(1);
  for (const double spread : {0.01, 0.3, 3.0}) {
    std::uniform_real_distribution<double> place(-1.0, 1.0), size(0.0, spread);
    const auto point = [&](auto& d) { return Vector3d(d(rng), d(rng), d(rng)); };
    for (const int n : {0, 1, 4, 5, 37, 1000}) {
      std::vector<AlignedBox3d> boxes;
      for (int i = 0; i < n; ++i) {
        const Vector3d low = point(place);
        boxes.emplace_back(low, low + point(size));
      }
      const BoxTree tree(boxes);
      for (int i = 0; i < 200; ++i) {
        const Vector3d p = point(place);
        EXPECT_EQ(AllAt(tree, p), AllAt(boxes, p));
      }
      for (const AlignedBox3d& box : boxes) EXPECT_TRUE(AllAt(tree, box.max()).size() > 0);
    }
  }
}

TEST(BoxTree, StopsAtTheFirst) {
  const BoxTree tree(std::vector<AlignedBox3d>(100, {Vector3d::Zero(), Vector3d::Ones()}));
  int asked = 0;
  EXPECT_TRUE(tree.AnyAt(Vector3d::Constant(0.5), [&](int) { return ++asked == 7; }));
  EXPECT_EQ(asked, 7);
}

TEST(BoxTree, AsksNoMoreBoxesThanThereAreAboutAPoint) {
  std::vector<AlignedBox3d> boxes;
  const int side = 300;
  for (int i = 0; i < side * side; ++i) {
    const Vector3d low(i % side, static_cast<double>(i / side), 0.0);
    boxes.emplace_back(low, low + Vector3d(1.5, 1.5, 0.0));
  }
  const BoxTree tree(std::move(boxes));
  int asked = 0;
  for (int i = 1; i < side; ++i) {
    tree.AnyAt({i + 0.25, i + 0.25, 0.0}, [&](int) { return ++asked < 0; });
  }
  EXPECT_EQ(asked, 4 * (side - 1));
}

TEST(BoxTree, LeavesOutWhatIsNoBox) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  const AlignedBox3d good(Vector3d::Zero(), Vector3d::Ones());
  std::vector<AlignedBox3d> boxes(9, good);
  boxes[2] = AlignedBox3d();
  boxes[3] = AlignedBox3d(Vector3d::Constant(-kInf), Vector3d::Constant(kInf));
  boxes[5] = AlignedBox3d(Vector3d::Constant(std::nan("")), Vector3d::Ones());
  EXPECT_EQ(AllAt(BoxTree(boxes), Vector3d::Constant(0.5)), (std::set<int>{0, 1, 4, 6, 7, 8}));
  EXPECT_TRUE(AllAt(BoxTree(boxes), Vector3d::Constant(std::nan(""))).empty());
}

}  // namespace
}  // namespace horopter
