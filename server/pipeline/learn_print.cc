#include "server/pipeline/learn_print.h"

#include "server/base/parallel_for.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"

namespace horopter {

absl::StatusOr<SurfacePrint> LearnPrintOf(const ObjectModel& model,
                                          const std::vector<AnsweredImages>& scenes,
                                          int threads,
                                          const StopRequested& stop) {
  if (threads < 1) return absl::InvalidArgumentError("threads: at least one is needed");
  const CoreBudget budget(threads);
  const StopScope scope(stop);
  return CatchExceptions([&]() -> absl::StatusOr<SurfacePrint> {
    return LearnPrintFrom(model, scenes, threads, stop);
  });
}

}  // namespace horopter
