// Formats of images that are not read, by their first bytes: a message that names one tells its
// reader what to do.
#pragma once

#include <string>
#include <string_view>

namespace horopter {

// "a GIF image", "a web page"; empty for what is unknown, and for a format that has a codec.
std::string NameOfOtherFormat(std::string_view bytes);

}  // namespace horopter
