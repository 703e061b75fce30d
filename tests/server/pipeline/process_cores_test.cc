#include "server/pipeline/process_cores.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <thread>
#include <vector>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

int64_t PageFaults() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}

// On a thread of its own, as requests are: their arenas trim themselves, too.
TEST(KeepFreedMemory, TheImagesOfARequestAreTakenFromThoseOfTheOneBefore) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "the sanitizer keeps freed memory from being used again";
#endif
  KeepFreedMemory();
  constexpr int kRequests = 20, kImages = 4, kWidth = 640, kHeight = 480;
  int64_t faults = 0;
  std::thread([&] {
    const auto request = [] {
      cv::Mat images[kImages];
      for (cv::Mat& image : images) image = cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(1, 2, 3));
    };
    request();
    const int64_t before = PageFaults();
    for (int i = 0; i < kRequests; ++i) request();
    faults = PageFaults() - before;
  }).join();
  const int64_t pages = int64_t{kImages} * kWidth * kHeight * 3 / ::sysconf(_SC_PAGESIZE);
  EXPECT_LT(faults, pages) << "of " << kRequests * pages << " pages that were written";
}

TEST(SetProcessCores, OpenCvLeavesWhenTheWorkIsToStop) {
  SetProcessCores(2);
  cv::Mat image(480, 640, CV_8UC1);
  cv::randu(image, 0, 255);
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
  const auto detect = [&] {
    cv::SIFT::create()->detectAndCompute(image, cv::noArray(), points, descriptors);
  };
  int looks = 0;
  {
    const StopRequested never = [&] { return ++looks < 0; };
    const StopScope scope(never);
    detect();
  }
  EXPECT_GT(looks, 40) << "a look for each image of the pyramids";
  ASSERT_FALSE(points.empty());
  const cv::Mat before = descriptors.clone();
  const StopRequested at_tenth = [&] { return looks++ >= 10; };
  {
    looks = 0;
    const StopScope scope(at_tenth);
    EXPECT_THROW(detect(), WorkStopped);
  }
  // What was left half done is no harm to the next.
  detect();
  EXPECT_EQ(cv::norm(before, descriptors, cv::NORM_INF), 0.0);
}

}  // namespace
}  // namespace horopter
