// How long the caller of a request waits.
#pragma once

#include "server/base/stop_token.h"

namespace horopter {

// stop: the answer is not wanted any more. hurry: it is, but most of the time for it is gone: what
// is found is to be answered, and nothing costly begun.
struct CallLimits {
  StopRequested stop;
  StopRequested hurry;
  double allowed_s = 0.0;  // from the call's arrival to its deadline; 0: any time
};

}  // namespace horopter
