// Boxes of an image in which something is looked for.
#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Pixels: the centre of the top-left pixel is (0, 0), so that all of an image is from (-0.5, -0.5)
// to (width - 0.5, height - 0.5).
using ImageBox = Eigen::AlignedBox2d;

// All of an image.
ImageBox WholeImage(int width, int height);

// A box in space about the origin of its own frame.
struct SpaceBox {
  Rigid3 base_from_box;
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  // along the axes of its frame, > 0
};

// How well a camera is known beside which boxes are to be placed in its image.
struct CameraDeviation {
  double log_focal = 0.0;
  double turn_rad = 0.0;
  double shift_m = 0.0;
};

// The smallest box of the image that holds what the space box shows there, grown by two standard
// deviations of what is known of the camera; nothing where it shows nothing. A box that begins
// behind the camera shows what of it is in front. camera_from_scene of `view` is camera_from_base.
std::optional<ImageBox> BoxInImage(const SpaceBox& box,
                                   const CalibratedCamera& view,
                                   const CameraDeviation& deviation);

// The share of a box's area that lies in the others, 0..1; what lies in several counts once for
// each of them. 0 of an empty box.
double ShareInBoxes(const ImageBox& box, std::span<const ImageBox> others);

// Whether a point lies in one of the boxes, or on its border.
bool InBoxes(const Eigen::Vector2d& point, std::span<const ImageBox> boxes);

}  // namespace horopter
