// Wireframes of recognised objects over the images they were seen in.
#pragma once

#include <map>
#include <opencv2/core/mat.hpp>
#include <span>
#include <string>
#include <vector>

#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

struct OverlayObject {
  const ObjectModel* model = nullptr;
  Rigid3 camera_from_object;
  std::string label;
  int color = 0;  // index into a fixed list, the same object has the same one in all images
};

// Draws the visible parts of the objects' edges (each object hides what is behind it) into a BGR
// image. Objects behind the camera are left out. The camera's k1 bends the lines.
void DrawOverlay(const PinholeCamera& camera,
                 std::span<const OverlayObject> objects,
                 cv::Mat* image);

// Draws an open parallel-jaw gripper as lines: two fingers of `finger_m` that end at the tips, the
// palm behind them and a line along the approach. Left out when a part of it is behind the camera.
void DrawGripper(const PinholeCamera& camera,
                 const Rigid3& camera_from_gripper,
                 double opening_m,
                 double finger_m,
                 const cv::Scalar& color,
                 cv::Mat* image);

// Writes a line of text into the lower left corner.
void DrawCaption(const std::string& text, cv::Mat* image);

// Tiles images row by row; each is scaled down to at most `tile_width` pixels.
cv::Mat Tile(std::span<const cv::Mat> images, int tile_width);

}  // namespace horopter
