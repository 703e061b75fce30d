// Texts of others on a terminal.
#pragma once

#include <string>
#include <string_view>

namespace horopter {

// The text with what a terminal would obey, or be turned by, written out: control characters but
// for tab and line end as \x1b, those of eight bits and the marks of direction as \u009b, \u202e.
std::string Shown(std::string_view text);

}  // namespace horopter
