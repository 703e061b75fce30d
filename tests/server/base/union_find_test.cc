#include "server/base/union_find.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

TEST(UnionFind, JoinsUnderTheSmallestNumber) {
  UnionFind sets(4);
  EXPECT_TRUE(sets.Join(3, 2));
  EXPECT_TRUE(sets.Join(2, 1));
  EXPECT_FALSE(sets.Join(1, 3));
  EXPECT_EQ(sets.Find(3), 1);
  EXPECT_EQ(sets.Find(0), 0);
}

TEST(UnionFind, GrowsFromNothing) {
  UnionFind sets;
  EXPECT_EQ(sets.size(), 0);
  EXPECT_EQ(sets.Add(), 0);
  EXPECT_EQ(sets.Add(), 1);
  EXPECT_NE(sets.Find(0), sets.Find(1));
  EXPECT_TRUE(sets.Join(0, 1));
  EXPECT_EQ(sets.Find(1), 0);
}

}  // namespace
}  // namespace horopter
