#include "server/base/rounded.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

TEST(Rounded, IsTheNearestWholeNumberHalvesUp) {
  EXPECT_EQ(Rounded(2.4f), 2);
  EXPECT_EQ(Rounded(2.5f), 3);
  EXPECT_EQ(Rounded(-2.4), -2);
  EXPECT_EQ(Rounded(-2.5), -2);
  EXPECT_EQ(Rounded(-2.6), -3);
  EXPECT_EQ(Rounded(0.0f), 0);
}

}  // namespace
}  // namespace horopter
