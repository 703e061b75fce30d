// What a file of ISO's base media format (HEIF, MP4) holds, by the brands of its first box.
#pragma once

#include <string_view>

namespace horopter {

enum class HeifKind {
  kNone,        // no such file
  kHeic,        // one or more still images, coded by HEVC
  kAvif,        // by AV1
  kSequence,    // HEVC, a sequence alone
  kCr3,         // a raw image of a Canon camera
  kOtherImage,  // a still image in another coding
  kVideo,       // MP4, MOV and all else
};

HeifKind HeifKindOf(std::string_view bytes);

}  // namespace horopter
