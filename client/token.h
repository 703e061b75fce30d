// Bearer tokens as files and environments hold them.
#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace horopter {

// White space, line breaks and a mark of byte order around the token are dropped. `where` is named
// in errors, which never hold the token: INVALID_ARGUMENT (a byte outside printable ASCII, with its
// line and column). "": none is left.
absl::StatusOr<std::string> CleanToken(const std::string& text, const std::string& where);

// The first line of a file that is not blank, cleaned. Errors: FAILED_PRECONDITION (cannot be read,
// holds no token), INVALID_ARGUMENT (as above).
absl::StatusOr<std::string> ReadTokenFile(const std::string& path);

// From here on this process leaves no core dump, which would hold its tokens.
void KeepTokensOutOfCoreDumps();

}  // namespace horopter
