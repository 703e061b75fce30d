#include "server/pipeline/process_cores.h"

#include <malloc.h>

#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>

#include "server/base/parallel_for.h"
#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// OpenCV's own allocator, which asks first: SIFT, robust estimates and filters take a matrix for
// each of their steps, and nothing else in them knows of us.
class StoppableAllocator : public cv::MatAllocator {
 public:
  cv::UMatData* allocate(int dims,
                         const int* sizes,
                         int type,
                         void* data,
                         size_t* step,
                         cv::AccessFlag flags,
                         cv::UMatUsageFlags usage) const override {
    LeaveIfStopped();
    return standard_->allocate(dims, sizes, type, data, step, flags, usage);
  }
  bool allocate(cv::UMatData* data, cv::AccessFlag flags, cv::UMatUsageFlags usage) const override {
    return standard_->allocate(data, flags, usage);
  }
  void deallocate(cv::UMatData* data) const override { standard_->deallocate(data); }

 private:
  cv::MatAllocator* const standard_ = cv::Mat::getStdAllocator();
};

}  // namespace

void SetProcessCores(int cores) {
  SetPoolThreads(cores - 1);
  cv::setNumThreads(1);
  static StoppableAllocator* const allocator = new StoppableAllocator;  // as long as any matrix
  cv::Mat::setDefaultAllocator(allocator);
}

void KeepFreedMemory() {
  // Half of the largest block that an arena of a thread can hold, and well below it.
  constexpr int kKept = 32 << 20, kLargestKept = 8 << 20;
  ::mallopt(M_TRIM_THRESHOLD, kKept);
  ::mallopt(M_MMAP_THRESHOLD, kLargestKept);
}

}  // namespace horopter
