// What was copied from one catalog into another.
#pragma once

#include <functional>
#include <string>

namespace horopter {

struct CopyReport {
  int objects = 0;
  int copied = 0;      // the others were there
  std::string digest;  // of both (DigestOfRows)
};
using CopyProgress = std::function<void(int done, int total)>;

}  // namespace horopter
