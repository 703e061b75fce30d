#include "server/pipeline/exception_status.h"

#include <exception>
#include <new>
#include <opencv2/core.hpp>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// A status without words takes no memory.
absl::Status Said(absl::StatusCode code, const char* what) noexcept {
  try {
    return absl::Status(code, what);
  } catch (...) {
    return absl::Status(code, "");
  }
}

}  // namespace

absl::Status StatusOfException() noexcept {
  try {
    throw;
  } catch (const WorkStopped&) {
    return Said(absl::StatusCode::kCancelled, "stopped");
  } catch (const std::bad_alloc&) {
    return Said(absl::StatusCode::kResourceExhausted, "out of memory");
  } catch (const cv::Exception& error) {
    if (error.code == cv::Error::StsNoMem) {
      return Said(absl::StatusCode::kResourceExhausted, "out of memory");
    }
    return Said(absl::StatusCode::kInternal, error.what());
  } catch (const std::exception& error) {
    return Said(absl::StatusCode::kInternal, error.what());
  } catch (...) {
    return Said(absl::StatusCode::kInternal, "unknown exception");
  }
}

}  // namespace horopter
