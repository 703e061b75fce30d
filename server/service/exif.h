// What a camera wrote beside the pixels of an image file (Exif 2.32): nine tags, read by ourselves.
// The libraries that read all of Exif unfold makers' notes and thumbnails too, which nobody needs
// here and which is where their faults have been.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace horopter {

// Values as they are written, which may be wrong; those that cannot be meant are left out.
struct Exif {
  int orientation = 1;  // 1 .. 8, Exif's numbers; 1: as stored
  // The image as the camera stored it, before anybody cut or scaled it; 0: unknown.
  int64_t width_px = 0;
  int64_t height_px = 0;
  std::optional<double> focal_mm;
  std::optional<double> focal_35mm;     // equivalent on film of 36 x 24 mm, mm
  std::optional<double> pixels_per_mm;  // of the sensor, along the image's width
  std::optional<double> digital_zoom;   // 1: none
};

// Of a JPEG, PNG, WebP, HEIC or TIFF file; any bytes may be given. Nothing is followed twice, so
// that the time is linear in the file's size. Without Exif, or where it is damaged: what can be
// read of it, nothing at worst.
Exif ReadExif(std::string_view file);

}  // namespace horopter
