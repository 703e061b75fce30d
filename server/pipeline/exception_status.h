// Exceptions of libraries and of the allocator as the Status of the request that met them.
#pragma once

#include "absl/status/status.h"

namespace horopter {

// Of the exception that is being handled: call it in a catch block. CANCELLED when the work was
// stopped (stop_scope.h), RESOURCE_EXHAUSTED when memory was short, OpenCV's as well as our own;
// INTERNAL with its message otherwise. Where there is no memory for words the code comes alone.
absl::Status StatusOfException() noexcept;

// function(), or what it throws as a Status. Its result must be made of a Status.
template <typename Function>
auto CatchExceptions(const Function& function) -> decltype(function()) {
  try {
    return function();
  } catch (...) {
    return StatusOfException();
  }
}

}  // namespace horopter
