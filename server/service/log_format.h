// Log lines that nothing in them can break.
#pragma once

#include <spdlog/formatter.h>

#include <memory>

namespace horopter {

// `[time] [level] message`, one line a message: control characters in it are escaped, so that
// nothing a client sends ends the line or looks like another one.
std::unique_ptr<spdlog::formatter> OneLineFormatter();

}  // namespace horopter
