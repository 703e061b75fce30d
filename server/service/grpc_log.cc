#include "server/service/grpc_log.h"

#include <grpc/support/log.h>
#include <spdlog/spdlog.h>

#include <cstring>

#include "absl/strings/str_cat.h"
#include "server/service/log_limiter.h"

namespace horopter {
namespace {

// Messages of one line of gRPC's source are a kind.
void Log(gpr_log_func_args* said) {
  static LogLimiter& limiter = *new LogLimiter(3);
  try {
    const char* const slash = std::strrchr(said->file, '/');
    const std::string kind =
        absl::StrCat("grpc ", slash == nullptr ? said->file : slash + 1, ":", said->line);
    const LogLimiter::Verdict verdict = limiter.Ask(kind);
    for (const auto& [what, lines] : verdict.left_out) {
      spdlog::warn("{}: {} more were left out", what, lines);
    }
    if (!verdict.write) return;
    const bool error = said->severity == GPR_LOG_SEVERITY_ERROR;
    spdlog::log(error ? spdlog::level::warn : spdlog::level::debug, "{}: {}", kind, said->message);
  } catch (...) {  // no memory for a line
  }
}

}  // namespace

void LogGrpcMessages() {
  gpr_set_log_function(&Log);
}

}  // namespace horopter
