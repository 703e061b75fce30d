// Configuration files of our programs: TOML whose keys are the program's options.
#pragma once

#include <CLI/App.hpp>
#include <CLI/Config.hpp>

namespace horopter {

// Adds --config, whose keys have to be options, each once and none in a section, and
// --print-config, which prints such a file and is done. `app` outlives the parsing.
void AddCheckedConfig(CLI::App& app);

}  // namespace horopter
