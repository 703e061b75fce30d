// Lines and texts that show an answer over its images: wireframes, grippers, the supporting plane.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "server/overlay/drawing.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Colour of the k-th object, from a fixed list that repeats.
DrawingColor ObjectColor(int k);

// Width of lines and height of letters that read well on a drawing of this size.
double LineWidthPx(const Drawing& drawing);
double TextHeightPx(const Drawing& drawing);

struct OverlayObject {
  const ObjectModel* model = nullptr;
  Rigid3 camera_from_object;
  std::string label;
  DrawingColor color;
};

// The visible parts of the objects' edges, each object hiding what is behind it; of a part without
// sharp edges its outline. Objects behind the camera are left out. The camera's k1 bends the lines.
void DrawWireframes(const PinholeCamera& camera,
                    std::span<const OverlayObject> objects,
                    Drawing* drawing);

// An open parallel-jaw gripper: two fingers of `finger_m` that end at the tips, the palm behind
// them and a line along the approach. Left out when a part of it is behind the camera.
void DrawGripper(const PinholeCamera& camera,
                 const Rigid3& camera_from_gripper,
                 double opening_m,
                 double finger_m,
                 const DrawingColor& color,
                 Drawing* drawing);

// A suction cup: its rim, and a line of `length_m` along the approach that ends in its middle. Left
// out when a part of it is behind the camera.
void DrawSuctionCup(const PinholeCamera& camera,
                    const Rigid3& camera_from_gripper,
                    double radius_m,
                    double length_m,
                    const DrawingColor& color,
                    Drawing* drawing);

// Squares of `cell_m` on the plane {x : normal . x = offset_m} of the scene, `cells` to each side
// of the point of the plane nearest to `middle`. What is behind the camera is left out.
struct GridPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit
  double offset_m = 0.0;
};
void DrawGrid(const PinholeCamera& camera,
              const Rigid3& camera_from_scene,
              const GridPlane& plane,
              const Eigen::Vector3d& middle,
              double cell_m,
              int cells,
              Drawing* drawing);

// A line of text in the lower left corner.
void DrawCaption(const std::string& text, Drawing* drawing);

}  // namespace horopter
