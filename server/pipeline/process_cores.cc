#include "server/pipeline/process_cores.h"

#include <malloc.h>

#include <opencv2/core/utility.hpp>

#include "server/base/parallel_for.h"

namespace horopter {

void SetProcessCores(int cores) {
  SetPoolThreads(cores - 1);
  cv::setNumThreads(1);
}

void KeepFreedMemory() {
  // Half of the largest block that an arena of a thread can hold, and well below it.
  constexpr int kKept = 32 << 20, kLargestKept = 8 << 20;
  ::mallopt(M_TRIM_THRESHOLD, kKept);
  ::mallopt(M_MMAP_THRESHOLD, kLargestKept);
}

}  // namespace horopter
