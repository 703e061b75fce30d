// What an image file's Exif says of the camera, with how far that can be believed.
#pragma once

#include <optional>

#include "server/service/exif.h"

namespace horopter {

struct ExifCamera {
  // Of the image as it is, pixels; unset where nothing is said, or too little to be of use.
  std::optional<double> focal_px;
  double focal_log_sigma = 0.0;  // of ln focal_px
  // Each coordinate of the principal point about the image's middle, where the sizes say that the
  // image was cut out of a larger one; pixels.
  std::optional<double> center_sigma_px;
};

// width, height: of the image as stored. cropped: the caller says that the image is a cut-out, of
// which nobody knows where it was.
//
// Focal lengths of 35 mm equivalent are of the diagonal for some makers and of the width for
// others, and of the whole sensor where an image of 16 : 9 was cut out of 4 : 3: what is between
// these counts as equally likely. Sizes that differ from those that the camera wrote tell a scaled
// image (the shape is the same) from a cut-out (it is not; then it may have been scaled as well). A
// cut-out of the same shape looks as if it were scaled.
ExifCamera CameraFromExif(const Exif& exif, int width, int height, bool cropped);

// Quarter turns clockwise that bring the stored image upright, 0 .. 3. No camera mirrors what it
// takes: a mirrored orientation was made by a program and says nothing.
int QuarterTurnsToUpright(const Exif& exif);

}  // namespace horopter
