// Width and height of an image.
#pragma once

namespace horopter {

struct ImageSize {
  int width = 0;
  int height = 0;
};

}  // namespace horopter
