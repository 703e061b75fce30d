#include "server/vision/recognition/aspects/plane_edges.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <vector>

namespace horopter {
namespace {

constexpr int kWidth = 480, kHeight = 360;
constexpr int kViews = 4;
const cv::Rect kStanding(150, 110, 120, 90);  // in the frame of the ground

// Stones of some px, each of one grey; larger than the images.
cv::Mat Stones(int seed, int stone_px = 16) {
  cv::RNG random(seed);
  cv::Mat zero_at_middles(900, 1000, CV_8U, cv::Scalar(1)), distance, nearest;
  for (int i = 0; i < zero_at_middles.rows * zero_at_middles.cols / (stone_px * stone_px); ++i) {
    zero_at_middles.at<std::uint8_t>(random.uniform(0, zero_at_middles.rows),
                                     random.uniform(0, zero_at_middles.cols)) = 0;
  }
  cv::distanceTransform(
      zero_at_middles, distance, nearest, cv::DIST_L2, cv::DIST_MASK_5, cv::DIST_LABEL_PIXEL);
  std::vector<std::uint8_t> greys(zero_at_middles.total());
  for (std::uint8_t& grey : greys) grey = static_cast<std::uint8_t>(random.uniform(70, 170));
  cv::Mat out(nearest.size(), CV_8U);
  for (int y = 0; y < out.rows; ++y) {
    for (int x = 0; x < out.cols; ++x)
      out.at<std::uint8_t>(y, x) = greys[nearest.at<std::int32_t>(y, x)];
  }
  cv::GaussianBlur(out, out, cv::Size(), 0.8);
  return out;
}

// View v's pixels from the ground's.
Eigen::Matrix3d ImageFromGround(int v) {
  Eigen::Matrix3d H;
  H << 1.0 - 0.02 * v, 0.03 * v, -220.0 + 6.0 * v, -0.02 * v, 1.0 + 0.015 * v, -210.0 - 4.0 * v,
      1e-5 * v, -2e-5 * v, 1.0;
  return H;
}

// The ground as view v sees it, and a grey card before it: it stands `parallax_px` a view away from
// where the ground would take it; 0: it lies flat.
cv::Mat View(int v, const cv::Mat& stones, double parallax_px, int seed) {
  cv::Matx33d M;
  const Eigen::Matrix3d H = ImageFromGround(v);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) M(r, c) = H(r, c);
  }
  cv::Mat image;
  cv::warpPerspective(stones, image, M, cv::Size(kWidth, kHeight), cv::INTER_LINEAR);
  std::vector<cv::Point> corners;
  for (const auto& [dx, dy] : {std::pair{0, 0}, {1, 0}, {1, 1}, {0, 1}}) {
    const Eigen::Vector2d at = (H * Eigen::Vector3d(220 + kStanding.x + dx * kStanding.width,
                                                    210 + kStanding.y + dy * kStanding.height,
                                                    1.0))
                                   .hnormalized();
    corners.emplace_back(static_cast<int>(std::lround(at.x() + parallax_px * v)),
                         static_cast<int>(std::lround(at.y() - 0.6 * parallax_px * v)));
  }
  cv::fillConvexPoly(image, corners, cv::Scalar(225), cv::LINE_AA);
  cv::Mat noise(image.size(), CV_16S);
  cv::theRNG().state = static_cast<std::uint64_t>(seed + 77 * v);
  cv::randn(noise, 0.0, 1.5);
  cv::add(image, noise, image, cv::noArray(), CV_8U);
  return image;
}

// All edges, none dropped.
AspectImage Plain(const cv::Mat& image) {
  AspectImageOptions options;
  options.max_texture = 1.0;
  options.drop_pattern = false;
  return MakeAspectImage(image, options);
}

struct Scene {
  std::vector<AspectImage> images;
  std::vector<GroundView> OthersOf(int v) const {
    std::vector<GroundView> out;
    for (int w = 0; w < kViews; ++w) {
      if (w != v) out.push_back({&images[w], ImageFromGround(w) * ImageFromGround(v).inverse()});
    }
    return out;
  }
};

Scene Make(int seed, double parallax_px) {
  Scene scene;
  const cv::Mat stones = Stones(seed);
  for (int v = 0; v < kViews; ++v)
    scene.images.push_back(Plain(View(v, stones, parallax_px, seed)));
  return scene;
}

// Distance of a point of view 0, whose pixels are the ground's less an offset, to the card's
// outline; negative inside.
double FromCard(const Eigen::Vector2f& p) {
  const double x = std::max(kStanding.x - p.x(), p.x() - kStanding.x - kStanding.width);
  const double y = std::max(kStanding.y - p.y(), p.y() - kStanding.y - kStanding.height);
  return std::max(x, y);
}

struct Shares {
  double ground = 0.0, outline = 0.0;  // of their edges that are marked
};

Shares MarkedShares(const AspectImage& image, const std::vector<std::uint8_t>& marked) {
  int ground = 0, outline = 0;
  Shares out;
  for (std::size_t i = 0; i < marked.size(); ++i) {
    const double from = FromCard(image.edges[i].point);
    if (from > 25.0) {
      ++ground;
      out.ground += marked[i];
    } else if (std::abs(from) < 1.5) {
      ++outline;
      out.outline += marked[i];
    }
  }
  out.ground /= std::max(1, ground);
  out.outline /= std::max(1, outline);
  return out;
}

class GroundEdges : public testing::TestWithParam<int> {};

TEST_P(GroundEdges, TheGroundsEdgesAreMarkedAndNotThoseOfWhatStandsOnIt) {
  const Scene scene = Make(GetParam(), 7.0);
  const std::vector<std::uint8_t> marked =
      FindPlaneEdges(scene.images[0], scene.OthersOf(0)).marked;
  ASSERT_EQ(marked.size(), scene.images[0].edges.size());
  const Shares shares = MarkedShares(scene.images[0], marked);
  EXPECT_GT(shares.ground, 0.75);
  EXPECT_LT(shares.outline, 0.2);
}

TEST_P(GroundEdges, TheOutlineOfWhatLiesFlatStays) {
  const Scene scene = Make(GetParam(), 0.0);
  const std::vector<std::uint8_t> marked =
      FindPlaneEdges(scene.images[0], scene.OthersOf(0)).marked;
  ASSERT_EQ(marked.size(), scene.images[0].edges.size());
  const Shares shares = MarkedShares(scene.images[0], marked);
  EXPECT_GT(shares.ground, 0.75);
  // Stones that meet the outline, and its corners, may go.
  EXPECT_LT(shares.outline, 0.34);
}

TEST_P(GroundEdges, AWrongMotionMarksNothing) {
  const Scene scene = Make(GetParam(), 7.0);
  std::vector<GroundView> others = scene.OthersOf(0);
  for (GroundView& view : others) {
    view.there_from_here(0, 2) += 9.0;
    view.there_from_here(1, 2) -= 5.0;
  }
  EXPECT_TRUE(FindPlaneEdges(scene.images[0], others).marked.empty());
}

TEST_P(GroundEdges, OneOtherViewSaysNothing) {
  const Scene scene = Make(GetParam(), 7.0);
  EXPECT_TRUE(FindPlaneEdges(scene.images[0], std::vector<GroundView>{scene.OthersOf(0)[0]})
                  .marked.empty());
}

// What no other view sees none could bear out.
TEST_P(GroundEdges, AtTheRimTheOthersThatSeeItAreEnough) {
  const Scene scene = Make(GetParam(), 7.0);
  std::vector<GroundView> others = scene.OthersOf(0);
  const PlaneEdges all = FindPlaneEdges(scene.images[0], others);
  ASSERT_FALSE(all.marked.empty());
  int unseen = 0, marked = 0;
  for (std::size_t i = 0; i < all.marked.size(); ++i) {
    int seen = 0;
    for (const GroundView& view : others) {
      const Eigen::Vector2d at =
          (view.there_from_here * scene.images[0].edges[i].point.cast<double>().homogeneous())
              .hnormalized();
      seen += at.x() >= 0 && at.y() >= 0 && at.x() < kWidth - 1 && at.y() < kHeight - 1;
    }
    if (seen > 0) continue;
    ++unseen;
    marked += all.marked[i];
  }
  ASSERT_GT(unseen, 0);
  EXPECT_GT(marked, 0.8 * unseen);
}

TEST_P(GroundEdges, GroundIsBetweenItsEdgesAndNotWhereSomethingStands) {
  const Scene scene = Make(GetParam(), 7.0);
  const AspectImage& image = scene.images[0];
  const PlaneEdges edges = FindPlaneEdges(image, scene.OthersOf(0));
  const std::vector<std::uint8_t> ground = GroundCells(image, edges);
  ASSERT_EQ(ground.size(), static_cast<std::size_t>(image.half_width) * image.half_height);
  int around = 0, seen = 0, inside = 0, wrong = 0;
  for (int y = 0; y < image.half_height; ++y) {
    for (int x = 0; x < image.half_width; ++x) {
      const double from = FromCard({2.0f * x, 2.0f * y});
      const int cell = ground[static_cast<std::size_t>(y) * image.half_width + x];
      if (from > 40.0) ++around, seen += cell;
      if (from < -15.0) ++inside, wrong += cell;
    }
  }
  EXPECT_GT(seen, 0.4 * around);
  EXPECT_LT(wrong, 0.1 * inside);
  EXPECT_TRUE(GroundCells(image, {}).empty());
}

INSTANTIATE_TEST_SUITE_P(Seeds, GroundEdges, testing::Range(1, 4));

TEST(PlaneEdgesOfFewEdges, ABlankGroundHasNone) {
  Scene scene;
  const cv::Mat blank(900, 1000, CV_8U, cv::Scalar(120));
  for (int v = 0; v < kViews; ++v) scene.images.push_back(Plain(View(v, blank, 0.0, 5)));
  EXPECT_TRUE(FindPlaneEdges(scene.images[0], scene.OthersOf(0)).marked.empty());
}

// Views that are not linked, and a scene without any, are as they are alone.
TEST(AspectImagesOnGround, WithoutMotionAreTheImagesAlone) {
  std::vector<cv::Mat> images;
  for (int v = 0; v < 3; ++v) images.push_back(View(v, Stones(9), 7.0, 9));
  const std::vector<std::optional<Eigen::Matrix3d>> unknown(3);
  const std::vector<AspectImage> made = MakeAspectImagesOnGround(images, unknown, {}, 2);
  for (int v = 0; v < 3; ++v) {
    const AspectImage alone = MakeAspectImage(images[v]);
    EXPECT_EQ(made[v].distance, alone.distance);
    EXPECT_EQ(made[v].edge_at, alone.edge_at);
  }
}

// The views of a ground and where they have it.
struct SeenGround {
  std::vector<cv::Mat> images;
  std::vector<std::optional<Eigen::Matrix3d>> image_from_plane;
};

SeenGround ViewsOf(const cv::Mat& ground, int seed) {
  SeenGround out;
  for (int v = 0; v < kViews; ++v) {
    out.images.push_back(View(v, ground, 7.0, seed));
    out.image_from_plane.emplace_back(ImageFromGround(v));
  }
  return out;
}

// Before fine grains outlines meet something in the other views, too.
TEST(AspectImagesOnGround, WhereTheImageAloneTellsTheTextureItDoes) {
  for (const int seed : {1, 2, 3}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const auto [images, image_from_plane] = ViewsOf(Stones(seed, 7), seed);
    AspectImageOptions by_motion;
    by_motion.ground.told_alone = 2.0;
    const AspectImage alone = MakeAspectImage(images[0]);
    const AspectImage made = MakeAspectImagesOnGround(images, image_from_plane, {}, 2)[0];
    const AspectImage moved = MakeAspectImagesOnGround(images, image_from_plane, by_motion, 2)[0];
    EXPECT_EQ(made.edge_at, alone.edge_at);
    EXPECT_FALSE(made.ground.empty());
    EXPECT_EQ(made.ground, moved.ground);
    EXPECT_NE(moved.edge_at, alone.edge_at);
  }
}

// Edges of an image between two columns.
std::vector<Eigen::Vector2f> Between(const AspectImage& image, float x0, float x1) {
  std::vector<Eigen::Vector2f> out;
  for (const ImageEdgePoint& e : image.edges) {
    if (e.point.x() >= x0 && e.point.x() < x1) out.push_back(e.point);
  }
  return out;
}

TEST(AspectImagesOnGround, EachPlaceIsToldAsItIsToldBest) {
  for (const int seed : {1, 2, 3}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    cv::Mat ground = Stones(seed, 7);
    const cv::Rect right(560, 0, ground.cols - 560, ground.rows);
    Stones(seed, 24)(right).copyTo(ground(right));
    const auto [images, image_from_plane] = ViewsOf(ground, seed);
    AspectImageOptions by_motion;
    by_motion.ground.told_alone = 2.0;
    const AspectImage alone = MakeAspectImage(images[0]);
    const AspectImage made = MakeAspectImagesOnGround(images, image_from_plane, {}, 2)[0];
    const AspectImage moved = MakeAspectImagesOnGround(images, image_from_plane, by_motion, 2)[0];
    EXPECT_EQ(Between(made, 0, 130), Between(alone, 0, 130));
    EXPECT_NE(Between(made, 0, 130), Between(moved, 0, 130));
    EXPECT_LT(Between(made, 380, kWidth).size(), Between(alone, 380, kWidth).size() / 4);
    for (std::size_t i = 0; i < made.edges.size(); ++i) {
      const Eigen::Vector2f& p = made.edges[i].point;
      EXPECT_EQ(
          made.edge_at[made.Cell(static_cast<int>(p.x() + 0.5f), static_cast<int>(p.y() + 0.5f))],
          static_cast<std::int32_t>(i));
    }
  }
}

TEST(AspectImagesOnGround, EmptyImagesStayEmpty) {
  const std::vector<cv::Mat> images(3);
  const std::vector<std::optional<Eigen::Matrix3d>> identity(3, Eigen::Matrix3d::Identity());
  for (const AspectImage& image : MakeAspectImagesOnGround(images, identity, {}, 2))
    EXPECT_EQ(image.width, 0);
}

TEST(AspectImagesOnGround, SmallerImagesAreTakenInTheirWorkingPixels) {
  std::vector<cv::Mat> images;
  std::vector<std::optional<Eigen::Matrix3d>> image_from_plane;
  for (int v = 0; v < kViews; ++v) {
    cv::Mat larger;
    cv::resize(View(v, Stones(3), 7.0, 3), larger, cv::Size(), 2.0, 2.0, cv::INTER_CUBIC);
    images.push_back(larger);
    Eigen::Matrix3d twice;
    twice << 2.0, 0.0, 0.5, 0.0, 2.0, 0.5, 0.0, 0.0, 1.0;
    image_from_plane.emplace_back(twice * ImageFromGround(v));
  }
  AspectImageOptions options;
  options.max_texture = 1.0;
  options.max_width_px = kWidth;
  const std::size_t on_ground =
      MakeAspectImagesOnGround(images, image_from_plane, options, 2)[0].edges.size();
  const std::size_t alone = MakeAspectImage(images[0], options).edges.size();
  EXPECT_LT(on_ground, alone / 2);
}

TEST(PlaneEdgeOptionsTest, ValidateNamesTheField) {
  AspectImageOptions options;
  EXPECT_TRUE(Validate(options).ok());
  options.ground.min_coverage = 1.5;
  EXPECT_NE(std::string(Validate(options).message()).find("min_coverage"), std::string::npos);
}

}  // namespace
}  // namespace horopter
