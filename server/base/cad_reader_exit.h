// How horopter-cad-reader ends, for the server that started it.
#pragma once

namespace horopter {

inline constexpr int kCadReaderUsage = 2;
inline constexpr int kCadReaderRefused = 3;  // the output says why
inline constexpr int kCadReaderOutOfMemory = 4;

}  // namespace horopter
