#include "server/pipeline/ranking.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

// Two bright squares on a dark ground; the second one is the smaller.
cv::Mat TwoSquares() {
  cv::Mat image(480, 640, CV_8UC1, cv::Scalar(60));
  cv::rectangle(image, {60, 100, 160, 160}, cv::Scalar(200), cv::FILLED);
  cv::rectangle(image, {450, 250, 60, 60}, cv::Scalar(200), cv::FILLED);
  return image;
}

double SideOfEdges(const RankingImage& image) {
  float least = 1e9f, most = -1e9f;
  for (const ImageEdgePoint& e : image.edges) {
    least = std::min(least, e.point.x());
    most = std::max(most, e.point.x());
  }
  return most - least;
}

TEST(Ranking, IsAskedByWhatLiesInTheRegionsEnlarged) {
  const std::vector<cv::Mat> images{TwoSquares()};
  const auto whole = RankingQuestion(images, 1);
  ASSERT_EQ(whole.size(), 1u);
  EXPECT_EQ(whole[0].width, 640);
  EXPECT_NEAR(SideOfEdges(whole[0]), 450.0, 4.0);

  SearchedPart part;
  part.boxes.emplace_back(Eigen::Vector2d(430.0, 230.0), Eigen::Vector2d(530.0, 330.0));
  const std::vector<std::optional<SearchedPart>> searched{part};
  const auto region = RankingQuestion(images, 1, searched);
  ASSERT_EQ(region.size(), 1u);
  ASSERT_FALSE(region[0].edges.empty());
  EXPECT_GT(SideOfEdges(region[0]), 100.0);  // of the small square alone, some 2.4 times as large
  EXPECT_LT(SideOfEdges(region[0]), 180.0);
}

TEST(Ranking, LooksAtTheWholeOfAnImageWhoseCutWouldBeTooLongForRankers) {
  cv::Mat strip(60, 3000, CV_8UC1, cv::Scalar(60));
  for (int x = 20; x < 2950; x += 90) cv::rectangle(strip, {x, 15, 30, 30}, cv::Scalar(200), -1);
  SearchedPart part;
  for (int x = 20; x < 2950; x += 90)
    part.boxes.emplace_back(Eigen::Vector2d(x - 8.0, 7.0), Eigen::Vector2d(x + 38.0, 53.0));
  const std::vector<cv::Mat> images{strip};
  const std::vector<std::optional<SearchedPart>> searched{part};
  const auto asked = RankingQuestion(images, 1, searched);
  ASSERT_EQ(asked.size(), 1u);
  EXPECT_LE(asked[0].width, 4096);
  EXPECT_FALSE(asked[0].edges.empty());
}

}  // namespace
}  // namespace horopter
