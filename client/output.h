// What a command prints: text for people, or JSON for programs (`--json`), one value a line.
#pragma once

#include <cstdarg>
#include <nlohmann/json_fwd.hpp>

namespace horopter {

// Once, before a command runs.
void SetJsonOutput(bool json);
bool JsonOutput();

// printf to stdout, without anything that a terminal would obey; nothing with --json.
void Say(const char* format, ...) __attribute__((format(printf, 1, 2)));

// A JSON value and a line end to stdout; nothing without --json.
void SayJson(const nlohmann::json& value);

}  // namespace horopter
