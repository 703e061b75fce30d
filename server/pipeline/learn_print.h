// What is printed on an object, learnt within the cores and the memory of a request.
#pragma once

#include "server/vision/recognition/print_learning.h"

namespace horopter {

// LearnPrintFrom. Errors: those, INVALID_ARGUMENT (threads), RESOURCE_EXHAUSTED (memory), INTERNAL.
absl::StatusOr<SurfacePrint> LearnPrintOf(const ObjectModel& model,
                                          const std::vector<AnsweredImages>& scenes,
                                          int threads,
                                          const StopRequested& stop);

}  // namespace horopter
