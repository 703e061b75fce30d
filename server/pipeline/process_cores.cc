#include "server/pipeline/process_cores.h"

#include <opencv2/core/utility.hpp>

#include "server/base/parallel_for.h"

namespace horopter {

void SetProcessCores(int cores) {
  SetPoolThreads(cores - 1);
  cv::setNumThreads(1);
}

}  // namespace horopter
