#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <thread>

#include "server/vision/features/features.h"
#include "tests/server/vision/features/rendered_shapes.h"

namespace horopter {
namespace {

ImageFeatures Detect(const cv::Mat& image, const FeatureOptions& options = {}) {
  absl::StatusOr<ImageFeatures> features = DetectFeatures(image, options);
  EXPECT_TRUE(features.ok()) << std::string(features.status().message());
  return features.ok() ? *features : ImageFeatures();
}

// Convex quadrilateral with sides of at least 60 px and corners between 40 and 140 degrees.
std::vector<Eigen::Vector2d> RandomQuad(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  for (;;) {
    std::vector<Eigen::Vector2d> quad;
    const double turn = 2.0 * CV_PI * u(*rng);
    for (int k = 0; k < 4; ++k) {
      const double a = turn + 0.5 * CV_PI * (k + 0.5 * (u(*rng) - 0.5));
      quad.emplace_back(160.0 + (60.0 + 45.0 * u(*rng)) * std::cos(a),
                        120.0 + (60.0 + 45.0 * u(*rng)) * std::sin(a));
    }
    bool good = true;
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector2d a = quad[(k + 1) % 4] - quad[k];
      const Eigen::Vector2d b = quad[(k + 2) % 4] - quad[(k + 1) % 4];
      const double angle = std::atan2(a.x() * b.y() - a.y() * b.x(), a.dot(b));
      good &= a.norm() > 60.0 && angle > 40.0 * CV_PI / 180 && angle < 140.0 * CV_PI / 180;
    }
    if (good) {
      return quad;
    }
  }
}

double LineDistance(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& p) {
  const Eigen::Vector2d d = (b - a).normalized();
  return std::abs(d.x() * (p.y() - a.y()) - d.y() * (p.x() - a.x()));
}

// Longest segment on the line a-b; null without one.
const Segment* FindOn(const ImageFeatures& features,
                      const Eigen::Vector2d& a,
                      const Eigen::Vector2d& b,
                      double tolerance) {
  const Segment* best = nullptr;
  for (const Segment& segment : features.segments) {
    const Eigen::Vector2d middle = 0.5 * (segment.start + segment.end);
    const double along = (middle - a).dot((b - a).normalized());
    if (LineDistance(a, b, segment.start) < tolerance &&
        LineDistance(a, b, segment.end) < tolerance && along > 0 && along < (b - a).norm() &&
        (!best || segment.Length() > best->Length())) {
      best = &segment;
    }
  }
  return best;
}

double NearestJunction(const ImageFeatures& features, const Eigen::Vector2d& p) {
  double best = 1e9;
  for (const Junction& junction : features.junctions) {
    best = std::min(best, (junction.point - p).norm());
  }
  return best;
}

void ExpectSane(const ImageFeatures& features) {
  for (const Segment& s : features.segments) {
    ASSERT_TRUE(s.start.allFinite() && s.end.allFinite() && s.left_bgr.allFinite() &&
                s.right_bgr.allFinite());
    ASSERT_TRUE(std::isfinite(s.contrast) && s.contrast >= 0.0 && std::isfinite(s.rms_px));
    ASSERT_GT(s.Length(), 0.0);
  }
  for (const Junction& j : features.junctions) {
    ASSERT_TRUE(j.point.allFinite() && std::isfinite(j.rms_px));
    ASSERT_GE(j.ends.size(), 2u);
    for (const Junction::End& end : j.ends) {
      ASSERT_GE(end.segment, 0);
      ASSERT_LT(end.segment, static_cast<int>(features.segments.size()));
    }
  }
  for (const EllipseArc& arc : features.arcs) {
    ASSERT_TRUE(arc.center.allFinite() && std::isfinite(arc.angle_rad) &&
                std::isfinite(arc.start_rad));
    ASSERT_GE(arc.semi_major_px, arc.semi_minor_px);
    ASSERT_GT(arc.semi_minor_px, 0.0);
    ASSERT_GT(arc.sweep_rad, 0.0);
    ASSERT_LE(arc.sweep_rad, 2.0 * CV_PI + 1e-9);
  }
  for (const EdgeChain& chain : features.chains) {
    for (size_t i = 0; i < chain.points.size(); ++i) {
      ASSERT_TRUE(chain.points[i].allFinite());
      ASSERT_GT(chain.points[i].minCoeff(), -2.0f);
      ASSERT_LT(chain.points[i].x(), features.width + 2.0f);
      ASSERT_LT(chain.points[i].y(), features.height + 2.0f);
    }
  }
}

struct NoiseCase {
  double noise_sigma;
  double blur_sigma;
  double line_px;    // largest distance of a segment's ends from the true line
  double corner_px;  // median distance of the junctions from the true corners
};

class PolygonAccuracy : public testing::TestWithParam<NoiseCase> {};

TEST_P(PolygonAccuracy, EdgesAndCornersAreSubPixel) {
  const NoiseCase& c = GetParam();
  std::mt19937 rng(17);
  std::vector<double> corner_errors;
  for (int trial = 0; trial < 25; ++trial) {
    SCOPED_TRACE(trial);
    const std::vector<Eigen::Vector2d> quad = RandomQuad(&rng);
    ShapeRenderOptions options;
    options.noise_sigma = c.noise_sigma;
    options.blur_sigma = c.blur_sigma;
    const ImageFeatures features = Detect(RenderPolygon(quad, options, &rng));
    ExpectSane(features);
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector2d& a = quad[k];
      const Eigen::Vector2d& b = quad[(k + 1) % 4];
      const Segment* segment = FindOn(features, a, b, c.line_px);
      ASSERT_NE(segment, nullptr) << a.transpose() << " to " << b.transpose();
      EXPECT_GT(segment->Length(), 0.8 * (b - a).norm())
          << a.transpose() << " to " << b.transpose();
      corner_errors.push_back(NearestJunction(features, a));
    }
  }
  std::sort(corner_errors.begin(), corner_errors.end());
  EXPECT_LT(corner_errors[corner_errors.size() / 2], c.corner_px);
  EXPECT_LT(corner_errors[corner_errors.size() * 95 / 100], 6.0 * c.corner_px);
}

INSTANTIATE_TEST_SUITE_P(Noise,
                         PolygonAccuracy,
                         testing::Values(NoiseCase{0.0, 0.8, 0.25, 0.15},
                                         NoiseCase{2.0, 0.8, 0.4, 0.2},
                                         NoiseCase{4.0, 1.0, 0.5, 0.25},
                                         NoiseCase{4.0, 1.5, 0.6, 0.3}));

TEST(DetectFeatures, BrighterSideIsOnTheRightAndSideColoursAreTheFaces) {
  std::mt19937 rng(3);
  for (int trial = 0; trial < 10; ++trial) {
    SCOPED_TRACE(trial);
    const std::vector<Eigen::Vector2d> quad = RandomQuad(&rng);
    ShapeRenderOptions options;
    options.background = cv::Scalar(40, 60, 50);
    options.foreground = cv::Scalar(140, 160, 170);
    const ImageFeatures features = Detect(RenderPolygon(quad, options, &rng));
    for (int k = 0; k < 4; ++k) {
      const Segment* segment = FindOn(features, quad[k], quad[(k + 1) % 4], 0.5);
      ASSERT_NE(segment, nullptr);
      EXPECT_NEAR((segment->right_bgr - Eigen::Vector3f(140, 160, 170)).norm(), 0.0, 4.0);
      EXPECT_NEAR((segment->left_bgr - Eigen::Vector3f(40, 60, 50)).norm(), 0.0, 4.0);
      // The right side holds the polygon's centre.
      const Eigen::Vector2d d = segment->end - segment->start;
      const Eigen::Vector2d right(-d.y(), d.x());
      EXPECT_GT(right.dot(Eigen::Vector2d(160, 120) - segment->start), 0.0);
    }
  }
}

TEST(DetectFeatures, SeesEqualLuminanceEdgesInColourOnly) {
  ShapeRenderOptions options;
  options.background = cv::Scalar(90, 100, 120);
  // Same 0.114 B + 0.587 G + 0.299 R, other hue.
  options.foreground = cv::Scalar(90, 120, 81);
  std::mt19937 rng(5);
  const std::vector<Eigen::Vector2d> quad = RandomQuad(&rng);
  const cv::Mat image = RenderPolygon(quad, options, &rng);
  cv::Mat grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  const ImageFeatures colour = Detect(image);
  for (int k = 0; k < 4; ++k) {
    EXPECT_NE(FindOn(colour, quad[k], quad[(k + 1) % 4], 0.5), nullptr) << k;
    EXPECT_LT(NearestJunction(colour, quad[k]), 1.5) << k;
  }
  EXPECT_TRUE(Detect(grey).segments.empty());
}

TEST(DetectFeatures, GreyAndGreyAsColourAgree) {
  std::mt19937 rng(8);
  const std::vector<Eigen::Vector2d> quad = RandomQuad(&rng);
  ShapeRenderOptions options;
  options.noise_sigma = 0.0;
  const cv::Mat image = RenderPolygon(quad, options, &rng);
  cv::Mat grey;
  cv::extractChannel(image, grey, 0);
  const ImageFeatures from_grey = Detect(grey);
  const ImageFeatures from_colour = Detect(image);
  ASSERT_EQ(from_grey.segments.size(), from_colour.segments.size());
  for (const Segment& s : from_grey.segments) {
    EXPECT_NE(FindOn(from_colour, s.start, s.end, 0.1), nullptr);
    EXPECT_EQ(s.left_bgr[0], s.left_bgr[2]);
  }
}

TEST(DetectFeatures, FollowsQuarterTurnsAndMirrors) {
  std::mt19937 rng(23);
  for (int trial = 0; trial < 10; ++trial) {
    SCOPED_TRACE(trial);
    ShapeRenderOptions options;
    options.noise_sigma = 1.0;
    const cv::Mat image = RenderPolygon(RandomQuad(&rng), options, &rng);
    const ImageFeatures original = Detect(image);
    cv::Mat turned, mirrored;
    cv::rotate(image, turned, cv::ROTATE_90_CLOCKWISE);
    cv::flip(image, mirrored, 1);
    const ImageFeatures of_turned = Detect(turned);
    const ImageFeatures of_mirrored = Detect(mirrored);
    const auto turn = [&](const Eigen::Vector2d& p) {
      return Eigen::Vector2d(image.rows - 1 - p.y(), p.x());
    };
    const auto mirror = [&](const Eigen::Vector2d& p) {
      return Eigen::Vector2d(image.cols - 1 - p.x(), p.y());
    };
    for (const Segment& s : original.segments) {
      if (s.Length() < 40.0) {
        continue;
      }
      const Segment* a = FindOn(of_turned, turn(s.start), turn(s.end), 0.5);
      const Segment* b = FindOn(of_mirrored, mirror(s.start), mirror(s.end), 0.5);
      ASSERT_NE(a, nullptr);
      ASSERT_NE(b, nullptr);
      EXPECT_NEAR(a->Length(), s.Length(), 4.0);
      EXPECT_NEAR(b->Length(), s.Length(), 4.0);
      // A turn keeps the direction of travel, a mirror reverses it: brightness stays on the right.
      EXPECT_GT((a->end - a->start).dot(turn(s.end) - turn(s.start)), 0.0);
      EXPECT_LT((b->end - b->start).dot(mirror(s.end) - mirror(s.start)), 0.0);
    }
  }
}

TEST(DetectFeatures, FindsEllipsesAsOneArc) {
  std::mt19937 rng(29);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  for (int trial = 0; trial < 20; ++trial) {
    SCOPED_TRACE(trial);
    const Eigen::Vector2d center(140 + 40 * u(rng), 100 + 40 * u(rng));
    const double major = 12 + 60 * u(rng);
    const double minor = std::max(6.0, major * (0.35 + 0.65 * u(rng)));
    ShapeRenderOptions options;
    options.noise_sigma = 2.0;
    const ImageFeatures features = Detect(RenderPolygon(
        EllipsePolygon(center, major, std::min(minor, major), CV_PI * u(rng)), options, &rng));
    ASSERT_FALSE(features.arcs.empty());
    const EllipseArc& arc = features.arcs[0];  // longest first
    EXPECT_LT((arc.center - center).norm(), 0.5);
    EXPECT_NEAR(arc.semi_major_px, major, 0.6);
    EXPECT_NEAR(arc.semi_minor_px, std::min(minor, major), 0.6);
    EXPECT_GT(arc.sweep_rad, 5.5);
    EXPECT_LE(features.arcs.size(), 2u);
  }
}

TEST(DetectFeatures, StructurelessImagesGiveNothing) {
  for (int value : {0, 1, 128, 255}) {
    const ImageFeatures features = Detect(cv::Mat(200, 300, CV_8UC3, cv::Scalar::all(value)));
    EXPECT_TRUE(features.segments.empty() && features.chains.empty() &&
                features.junctions.empty() && features.arcs.empty());
  }
}

TEST(DetectFeatures, HostileImagesStaySaneAndBounded) {
  std::mt19937 rng(31);
  std::uniform_int_distribution<int> byte(0, 255);
  cv::Mat noise(480, 640, CV_8UC3), checks(480, 640, CV_8UC1), stripes(480, 640, CV_8UC1),
      salt(480, 640, CV_8UC3);
  for (size_t i = 0; i < noise.total() * 3; ++i) {
    noise.data[i] = static_cast<uint8_t>(byte(rng));
    salt.data[i] = byte(rng) < 3 ? 255 : 0;
  }
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      checks.at<uint8_t>(y, x) = (x + y) % 2 == 0 ? 0 : 255;
      stripes.at<uint8_t>(y, x) = x % 2 == 0 ? 0 : 255;
    }
  }
  cv::Mat blocks, wide_stripes;
  cv::resize(checks(cv::Rect(0, 0, 80, 60)), blocks, cv::Size(640, 480), 0, 0, cv::INTER_NEAREST);
  cv::resize(stripes, wide_stripes, cv::Size(2560, 480), 0, 0, cv::INTER_NEAREST);
  FeatureOptions options;
  options.max_segments = 300;
  options.arcs.max_arcs = 50;
  for (const cv::Mat& image : {noise, checks, stripes, salt, blocks, wide_stripes}) {
    const ImageFeatures features = Detect(image, options);
    ExpectSane(features);
    EXPECT_LE(features.segments.size(), 300u);
    EXPECT_LE(features.arcs.size(), 50u);
    EXPECT_EQ(features.counts.count("segments_cut"), 1u);
  }
}

TEST(DetectFeatures, CutsTheWeakestAndSaysSo) {
  std::mt19937 rng(37);
  cv::Mat blocks(240, 320, CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < 240; ++y) {
    for (int x = 0; x < 320; ++x) {
      blocks.at<uint8_t>(y, x) = ((x / 40 + y / 40) % 2 == 0) ? 40 : 40 + 20 * (y / 40);
    }
  }
  const ImageFeatures all = Detect(blocks);
  ASSERT_GT(all.segments.size(), 10u);
  FeatureOptions options;
  options.max_segments = 5;
  const ImageFeatures cut = Detect(blocks, options);
  ASSERT_EQ(cut.segments.size(), 5u);
  EXPECT_EQ(cut.counts.at("segments_cut"), static_cast<double>(all.segments.size() - 5));
  ExpectSane(cut);
}

TEST(DetectFeatures, RefusesWrongTypesAndSizes) {
  for (const cv::Mat& image : {cv::Mat(),
                               cv::Mat(15, 64, CV_8UC1),
                               cv::Mat(64, 15, CV_8UC3),
                               cv::Mat(1, 1, CV_8UC3),
                               cv::Mat(64, 64, CV_16SC1),
                               cv::Mat(64, 64, CV_32FC3),
                               cv::Mat(64, 64, CV_8UC4),
                               cv::Mat(64, 64, CV_8UC2)}) {
    const auto features = DetectFeatures(image, {});
    ASSERT_FALSE(features.ok());
    EXPECT_EQ(features.status().code(), absl::StatusCode::kInvalidArgument);
  }
}

TEST(DetectFeatures, SmallestImageWorks) {
  cv::Mat image(16, 16, CV_8UC3, cv::Scalar::all(30));
  image(cv::Rect(8, 0, 8, 16)).setTo(cv::Scalar::all(200));
  ExpectSane(Detect(image));
  ExpectSane(Detect(cv::Mat(16, 16, CV_8UC1, cv::Scalar(7))));
}

TEST(DetectFeatures, SubMatricesAreReadWithTheirStride) {
  std::mt19937 rng(41);
  const cv::Mat image = RenderPolygon(RandomQuad(&rng), {}, &rng);
  cv::Mat framed(300, 400, CV_8UC3, cv::Scalar(255, 0, 255));
  image.copyTo(framed(cv::Rect(30, 20, 320, 240)));
  const ImageFeatures whole = Detect(image);
  const ImageFeatures part = Detect(framed(cv::Rect(30, 20, 320, 240)));
  ASSERT_EQ(whole.segments.size(), part.segments.size());
  for (size_t i = 0; i < whole.segments.size(); ++i) {
    EXPECT_EQ(whole.segments[i].start, part.segments[i].start);
  }
}

TEST(DetectFeatures, SameBytesFromEveryThread) {
  std::mt19937 rng(43);
  ShapeRenderOptions options;
  options.noise_sigma = 4.0;
  const cv::Mat image = RenderPolygon(RandomQuad(&rng), options, &rng);
  const ImageFeatures expected = Detect(image);
  std::vector<ImageFeatures> results(4);
  std::vector<std::thread> threads;
  for (ImageFeatures& result : results) {
    threads.emplace_back([&] { result = Detect(image); });
  }
  for (std::thread& thread : threads) {
    thread.join();
  }
  for (const ImageFeatures& result : results) {
    ASSERT_EQ(result.segments.size(), expected.segments.size());
    for (size_t i = 0; i < expected.segments.size(); ++i) {
      EXPECT_EQ(result.segments[i].start, expected.segments[i].start);
      EXPECT_EQ(result.segments[i].end, expected.segments[i].end);
    }
    EXPECT_EQ(result.junctions.size(), expected.junctions.size());
    EXPECT_EQ(result.chains.size(), expected.chains.size());
  }
}

TEST(DetectFeatures, SixteenBitsGiveWhatEightBitsGive) {
  std::mt19937 rng(12);
  const cv::Mat image = RenderPolygon(RandomQuad(&rng), ShapeRenderOptions(), &rng);
  cv::Mat deep;
  image.convertTo(deep, CV_16U, 257.0);
  const ImageFeatures from_deep = Detect(deep), from_shallow = Detect(image);
  ASSERT_EQ(from_deep.segments.size(), from_shallow.segments.size());
  for (size_t i = 0; i < from_deep.segments.size(); ++i) {
    EXPECT_EQ(from_deep.segments[i].start, from_shallow.segments[i].start);
  }
}

TEST(DetectFeatures, RefusesOptionsThatMeanNothing) {
  const cv::Mat image(64, 64, CV_8UC1, cv::Scalar(0));
  FeatureOptions options;
  options.linking.low = 2.0 * options.linking.high;
  EXPECT_EQ(DetectFeatures(image, options).status().code(), absl::StatusCode::kInvalidArgument);
  options = {};
  options.linking.high = std::nan("");
  EXPECT_EQ(DetectFeatures(image, options).status().code(), absl::StatusCode::kInvalidArgument);
  options = {};
  options.max_segments = -1;
  EXPECT_EQ(DetectFeatures(image, options).status().code(), absl::StatusCode::kInvalidArgument);
}

// Edges between hues of one luminance, which the grey image does not show.
TEST(DetectFeatures, EveryColourFieldFindsEqualLuminanceEdges) {
  for (ColourGradient colour : {ColourGradient::kEachChannel,
                                ColourGradient::kStrongestChannel,
                                ColourGradient::kVectorValued,
                                ColourGradient::kSaturationWeighted}) {
    SCOPED_TRACE(static_cast<int>(colour));
    FeatureOptions options;
    options.gradient.colour = colour;
    std::mt19937 rng(21);
    std::uniform_real_distribution<double> u(0.0, 1.0);
    int edges = 0, in_colour = 0, in_grey = 0;
    for (int trial = 0; trial < 25; ++trial) {
      ShapeRenderOptions render;
      render.noise_sigma = 1.0;
      // Red rises by 30 to 60 grey levels, green falls so that the luminance stays.
      const double red = 30.0 + 30.0 * u(rng);
      render.background = cv::Scalar(90, 120, 80);
      render.foreground = cv::Scalar(90, 120 - red * 0.299 / 0.587, 80 + red);
      const std::vector<Eigen::Vector2d> quad = RandomQuad(&rng);
      const cv::Mat image = RenderPolygon(quad, render, &rng);
      cv::Mat grey;
      cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
      const ImageFeatures with_colour = Detect(image, options), without = Detect(grey, options);
      for (int k = 0; k < 4; ++k) {
        const Eigen::Vector2d& a = quad[k];
        const Eigen::Vector2d& b = quad[(k + 1) % 4];
        const auto found = [&](const ImageFeatures& features) {
          const Segment* segment = FindOn(features, a, b, 2.0);
          return segment && segment->Length() > 0.7 * (b - a).norm();
        };
        ++edges;
        in_colour += found(with_colour) ? 1 : 0;
        in_grey += found(without) ? 1 : 0;
      }
    }
    EXPECT_GE(in_colour, 0.95 * edges);
    EXPECT_LT(in_grey, 0.3 * edges);
  }
}

}  // namespace
}  // namespace horopter
