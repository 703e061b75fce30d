// What can be said to horopter-console, on the command line and in a file.
#pragma once

#include <CLI/App.hpp>
#include <string>

#include "console/console_state.h"

namespace horopter {

struct ConsoleFlags {
  std::string log_level = "info";
  ConsoleOptions console;
};

// Every option with its default and what it does; --config and --print-config as horopterd's.
void AddConsoleFlags(CLI::App& app, ConsoleFlags& flags);

}  // namespace horopter
