// The two macros of the project: early return on a failed absl::Status / absl::StatusOr.
#pragma once

#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

#define HOROPTER_RETURN_IF_ERROR(expr)                  \
  do {                                                  \
    if (absl::Status status_ = (expr); !status_.ok()) { \
      return status_;                                   \
    }                                                   \
  } while (false)

#define HOROPTER_CONCAT_INNER_(a, b) a##b
#define HOROPTER_CONCAT_(a, b) HOROPTER_CONCAT_INNER_(a, b)

#define HOROPTER_ASSIGN_OR_RETURN(lhs, expr) \
  HOROPTER_ASSIGN_OR_RETURN_(HOROPTER_CONCAT_(status_or_, __LINE__), lhs, expr)

#define HOROPTER_ASSIGN_OR_RETURN_(tmp, lhs, expr) \
  auto tmp = (expr);                               \
  if (!tmp.ok()) {                                 \
    return tmp.status();                           \
  }                                                \
  lhs = std::move(tmp).value()
