#include "server/vision/recognition/aspects/attention.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

// A table in slanting light with a little grain, so many pixels wide, and things on it given for a
// width of 1280.
class Bench {
 public:
  explicit Bench(int width) : scale_(width / 1280.0), image_(width * 3 / 4, width, CV_8UC3) {
    cv::RNG random(5);
    for (int y = 0; y < image_.rows; ++y) {
      for (int x = 0; x < image_.cols; ++x) {
        const double light = 110 + 40.0 * x / image_.cols + 20.0 * y / image_.rows;
        for (int c = 0; c < 3; ++c)
          image_.at<cv::Vec3b>(y, x)[c] =
              cv::saturate_cast<std::uint8_t>(light + random.gaussian(2.0));
      }
    }
  }
  void Put(const cv::Rect2d& box, const cv::Scalar& bgr) {
    cv::rectangle(
        image_,
        cv::Rect2d(box.x * scale_, box.y * scale_, box.width * scale_, box.height * scale_),
        bgr,
        cv::FILLED);
  }
  std::vector<AttentionWindow> Windows(const AttentionOptions& options = {}) const {
    return FindWindows(image_, MakeAspectImage(image_), options);
  }
  // Number of the first window that holds the box and is not much larger; -1: none.
  int WindowOf(const std::vector<AttentionWindow>& windows, const cv::Rect2d& box) const {
    const ImageBox of(Eigen::Vector2d(box.x, box.y) * scale_,
                      Eigen::Vector2d(box.x + box.width, box.y + box.height) * scale_);
    for (std::size_t i = 0; i < windows.size(); ++i) {
      const ImageBox both = windows[i].box.intersection(of);
      if (!both.isEmpty() && both.volume() > 0.9 * of.volume() &&
          windows[i].box.volume() < 3.0 * of.volume() + 2000.0 * scale_ * scale_)
        return static_cast<int>(i);
    }
    return -1;
  }

 private:
  double scale_;
  cv::Mat image_;
};

const cv::Rect2d kRed(200, 300, 60, 40), kDark(700, 500, 44, 50), kCarton(850, 100, 320, 260);

class Attention : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Widths, Attention, testing::Values(640, 1280, 2560));

TEST_P(Attention, SmallThingsHaveWindowsAndLargeOnesHaveNone) {
  Bench bench(GetParam());
  bench.Put(kRed, {110, 115, 150});
  bench.Put(kDark, {90, 90, 90});
  bench.Put(kCarton, {60, 120, 180});
  const auto windows = bench.Windows();
  EXPECT_GE(bench.WindowOf(windows, kRed), 0) << "as bright as the table, of another colour";
  EXPECT_GE(bench.WindowOf(windows, kDark), 0);
  EXPECT_LT(bench.WindowOf(windows, kCarton), 0);
  EXPECT_LE(windows.size(), 8u);
  EXPECT_TRUE(std::is_sorted(windows.begin(), windows.end(), [](const auto& a, const auto& b) {
    return a.gain > b.gain;
  }));
}

TEST_P(Attention, AnEmptyTableHasHardlyAny) {
  EXPECT_LE(Bench(GetParam()).Windows().size(), 2u);
}

TEST(AttentionWindows, AreAsManyAsAreAsked) {
  Bench bench(1280);
  for (int k = 0; k < 20; ++k) bench.Put(cv::Rect2d(40 + 60 * k, 300, 30, 30), {60, 60, 200});
  AttentionOptions options;
  EXPECT_GE(bench.Windows(options).size(), 20u);
  options.most_windows = 5;
  EXPECT_EQ(bench.Windows(options).size(), 5u);
}

TEST(AttentionWindows, OfWhatIsNoImageThereIsNone) {
  EXPECT_TRUE(FindWindows(cv::Mat(), AspectImage()).empty());
  EXPECT_TRUE(FindWindows(cv::Mat(48, 64, CV_32F), AspectImage()).empty());
}

}  // namespace
}  // namespace horopter
