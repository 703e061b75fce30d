#include "server/pipeline/process_cores.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <opencv2/core.hpp>
#include <thread>

namespace horopter {
namespace {

int64_t PageFaults() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}

// On a thread of its own, as requests are: their arenas trim themselves, too.
TEST(KeepFreedMemory, TheImagesOfARequestAreTakenFromThoseOfTheOneBefore) {
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

}  // namespace
}  // namespace horopter
