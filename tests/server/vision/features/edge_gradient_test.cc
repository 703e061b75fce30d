// The gradient fields and the chains linked in them.
#include "server/vision/features/edge_gradient.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>
#include <random>

#include "server/vision/features/edge_linking.h"
#include "tests/server/vision/features/rendered_shapes.h"

namespace horopter {
namespace {

const Eigen::Vector2d kCenter(160.3, 119.6);
constexpr double kRadius = 70.0;

std::vector<EdgeChain> Chains(const cv::Mat& image, ColourGradient colour) {
  GradientOptions gradient;
  gradient.colour = colour;
  std::vector<EdgeChain> all;
  for (const GradientField& field : MakeGradientFields(image, gradient)) {
    for (EdgeChain& chain : LinkEdges(field, LinkingOptions())) all.push_back(std::move(chain));
  }
  return all;
}

// Share of the circle's degrees with a chain point within 1.5 px.
double CircleShare(const std::vector<EdgeChain>& chains) {
  std::vector<char> seen(360, 0);
  for (const EdgeChain& chain : chains) {
    for (const Eigen::Vector2f& p : chain.points) {
      const Eigen::Vector2d q = p.cast<double>() - kCenter;
      if (std::abs(q.norm() - kRadius) < 1.5) {
        seen[static_cast<int>((std::atan2(q.y(), q.x()) + CV_PI) * 180.0 / CV_PI) % 360] = 1;
      }
    }
  }
  return std::count(seen.begin(), seen.end(), 1) / 360.0;
}

cv::Mat Disc(const cv::Scalar& inside, const cv::Scalar& outside, double noise, std::mt19937* rng) {
  ShapeRenderOptions options;
  options.background = outside;
  options.foreground = inside;
  options.noise_sigma = noise;
  return RenderPolygon(EllipsePolygon(kCenter, kRadius, kRadius, 0.0), options, rng);
}

TEST(EdgeGradient, ColourFindsEqualLuminanceEdgesThatGreyMisses) {
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  for (int trial = 0; trial < 8; ++trial) {
    SCOPED_TRACE(testing::Message() << "seed 5, trial " << trial);
    // 0.114 B + 0.587 G + 0.299 R is the same on both sides.
    const double green = 30.0 + 15.0 * u(rng);
    const double red = green * 0.587 / 0.299;
    const cv::Mat image =
        Disc(cv::Scalar(80, 90, 70 + red), cv::Scalar(80, 90 + green, 70), 1.5, &rng);
    EXPECT_LT(CircleShare(Chains(image, ColourGradient::kIntensity)), 0.3);
    for (ColourGradient colour : {ColourGradient::kEachChannel,
                                  ColourGradient::kStrongestChannel,
                                  ColourGradient::kVectorValued,
                                  ColourGradient::kSaturationWeighted}) {
      EXPECT_GE(CircleShare(Chains(image, colour)), 0.95) << static_cast<int>(colour);
    }
  }
}

TEST(EdgeGradient, SaturationWeightingIsNoNoisierThanIntensityInGreyAreas) {
  std::mt19937 rng(6);
  const cv::Mat image = Disc(cv::Scalar(110, 110, 110), cv::Scalar(110, 110, 110), 4.0, &rng);
  const auto points = [&](ColourGradient colour) {
    size_t count = 0;
    for (const EdgeChain& chain : Chains(image, colour)) count += chain.points.size();
    return count;
  };
  EXPECT_LE(points(ColourGradient::kSaturationWeighted),
            points(ColourGradient::kIntensity) + image.total() / 1000);
}

TEST(EdgeLinking, ChainsAreOrderedSubPixelAndCarryTheGradient) {
  std::mt19937 rng(7);
  const cv::Mat image = Disc(cv::Scalar(160, 160, 160), cv::Scalar(60, 60, 60), 1.0, &rng);
  const std::vector<EdgeChain> chains = Chains(image, ColourGradient::kIntensity);
  ASSERT_FALSE(chains.empty());
  const EdgeChain& chain =
      *std::max_element(chains.begin(), chains.end(), [](const EdgeChain& a, const EdgeChain& b) {
        return a.points.size() < b.points.size();
      });
  EXPECT_TRUE(chain.closed);
  EXPECT_GT(chain.points.size(), 380u);  // 2 pi 70 = 440 px, up to sqrt(2) px per step
  double square = 0.0;
  for (size_t i = 0; i < chain.points.size(); ++i) {
    const Eigen::Vector2d q = chain.points[i].cast<double>() - kCenter;
    square += (q.norm() - kRadius) * (q.norm() - kRadius);
    EXPECT_LT(chain.gradients[i].cast<double>().normalized().dot(q.normalized()), -0.9);
    if (i > 0) {
      EXPECT_LE((chain.points[i] - chain.points[i - 1]).norm(), 2.3f);
    }
  }
  EXPECT_LT(std::sqrt(square / static_cast<double>(chain.points.size())), 0.2);
}

}  // namespace
}  // namespace horopter
