// Small parts in large images: looked for a second time, in more of the images' pixels. ADR 85.
#pragma once

#include <memory>
#include <opencv2/core.hpp>
#include <span>

#include "server/vision/recognition/object/aspect_options.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/reconstruction/off_plane.h"

namespace horopter {

// For parts of up to a quarter of an image's width, in images of up to 1280 px.
AspectRecognitionOptions FinerOptions();

// Whether the second look may show parts that the first did not: the images are larger than those
// it searched, and it found nothing, not all cameras, or an object of the list would be small where
// its answer's objects are. Of images of which boxes are searched only where one of these is longer
// than a quarter of the width: others are enlarged as it is; and wherever a box has room for more
// than what was found. objects: with aspects; searched: one
// per image or none.
bool MayShowMore(std::span<const cv::Mat> images,
                 std::span<const std::optional<SearchedPart>> searched,
                 std::span<const std::shared_ptr<const PreparedObject>> objects,
                 const RecognitionResult& answer);

// Where small things are, for a look at them enlarged and at nothing else. ADR 115.
struct Attention {
  // Windows of each image, those of which most is expected first; none of an image: no boxes.
  std::vector<std::optional<SearchedPart>> parts;
  int windows = 0, standing_off = 0;  // of all images; those of them that are told from space
  double share = 0.0;                 // of the images, mean
};

// Windows are at most this share of the image's width, and so many of an image.
inline constexpr double kMostWindowSide = 0.16;
inline constexpr int kMostWindows = 40;

// A third of each image's area at most. things: boxes of each image, those of which most is
// expected first (SmallThings); standing_off: what stands off the plane that things stand on, as
// several images see it, which is looked at before them; may be empty.
Attention Attend(std::span<const cv::Mat> images,
                 std::span<const std::vector<ImageBox>> things,
                 std::span<const OffPlaneGroup> standing_off);

// Whether more objects of the second look's answer than of the first's are right, as their
// probabilities say.
bool ShowMore(const RecognitionResult& finer, const RecognitionResult& answer);

}  // namespace horopter
