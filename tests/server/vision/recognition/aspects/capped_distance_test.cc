#include "server/vision/recognition/aspects/capped_distance.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

namespace horopter {
namespace {

std::vector<std::uint8_t> Capped(const std::vector<std::uint8_t>& marked, int width, int height) {
  std::vector<std::uint8_t> distance(marked.size(), 7);
  FillCappedDistance(marked, width, height, distance);
  return distance;
}

TEST(FillCappedDistance, IsTheChamferOfOpenCvToAStep) {
  for (unsigned seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 rng(seed);
    const int width = 1 + static_cast<int>(rng() % 200), height = 1 + static_cast<int>(rng() % 150);
    const double share = 0.3 / (1 << (seed % 12));
    std::vector<std::uint8_t> marked(static_cast<std::size_t>(width) * height);
    std::bernoulli_distribution mark(share);
    for (auto& m : marked) m = mark(rng);
    marked[rng() % marked.size()] = 255;
    cv::Mat zero_at_marked(height, width, CV_8U), expected;
    for (std::size_t i = 0; i < marked.size(); ++i) zero_at_marked.data[i] = marked[i] == 0;
    cv::distanceTransform(zero_at_marked, expected, cv::DIST_L2, cv::DIST_MASK_3, CV_32F);
    expected.convertTo(expected, CV_8U, 8.0);
    const std::vector<std::uint8_t> distance = Capped(marked, width, height);
    for (std::size_t i = 0; i < marked.size(); ++i)
      ASSERT_NEAR(distance[i], expected.data[i], 1) << width << "x" << height << " at " << i;
  }
}

TEST(FillCappedDistance, EndsWhereAByteEnds) {
  std::vector<std::uint8_t> marked(80, 0);
  EXPECT_EQ(Capped(marked, 80, 1), std::vector<std::uint8_t>(80, 255));
  marked[40] = 1;
  for (const auto& [width, height] : {std::pair(80, 1), std::pair(1, 80)}) {
    const std::vector<std::uint8_t> distance = Capped(marked, width, height);
    EXPECT_EQ(distance[40], 0);
    EXPECT_EQ(distance[41], 8);
    EXPECT_EQ(distance[40 - 33], 252);  // 31.5 px
    EXPECT_EQ(distance[40 + 33], 252);
    EXPECT_EQ(distance[40 - 34], 255);
    EXPECT_EQ(distance[79], 255);
  }
  EXPECT_TRUE(Capped({}, 0, 0).empty());
}

}  // namespace
}  // namespace horopter
