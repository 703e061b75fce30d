// Which image edge points the visible CAD edges of a scene are compared with.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/euclidean/edge_points.h"
#include "server/vision/features/features.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// The edge points of an image in cells of a few working pixels (see edge_points.h): built in
// milliseconds, where distance maps of the whole image take tens.
class EdgeGrid {
 public:
  EdgeGrid() = default;
  explicit EdgeGrid(const ImageFeatures& features);

  double working_from_image() const { return scale_; }
  int width() const { return width_; }  // working pixels
  int height() const { return height_; }

  // The point nearest to `u` (working pixels) within reach_px (<= kCellPx) whose direction is
  // within max_turn_rad of `direction_rad`; null: none.
  const EdgePoint* Nearest(const Eigen::Vector2d& u,
                           double direction_rad,
                           double reach_px,
                           double max_turn_rad) const;

  static constexpr double kCellPx = 8.0;  // working px; the reach of a search

 private:
  double scale_ = 1.0;
  int width_ = 0, height_ = 0, columns_ = 0, rows_ = 0;
  std::vector<int> first_;         // of each cell, one more at the end
  std::vector<EdgePoint> points_;  // image pixels, by cell
};

// A view or an object as the observations and the adjustment see it.
struct AdjustedView {
  bool known = false;
  PinholeCamera camera;
  Rigid3 camera_from_scene;
};
struct AdjustedObject {
  Rigid3 scene_from_object;
  const PreparedObject* model = nullptr;
};

struct EdgeObservation {
  int view = -1;
  int object = -1;  // index into the scene's objects
  int edge = -1;    // of the model
  Eigen::Vector3d point_in_object = Eigen::Vector3d::Zero();
  Eigen::Vector2d edge_point = Eigen::Vector2d::Zero();  // image pixels
  Eigen::Vector2d normal = Eigen::Vector2d::Zero();      // of the projected edge, unit
  double residual_px = 0.0;                              // along the normal, working pixels
  double spacing_px = 0.0;  // of neighbouring samples in the image, working pixels
};

// Samples of an object's edges that a view sees: nothing of the scene hides them, and they are not
// seen end-on. Of aspects: what a camera sees as edges at this pose (contours, creases), `edge` the
// chain they are in, of this view alone.
struct VisibleSamples {
  int view = -1;
  int object = -1;
  std::vector<EdgeSample> samples;
  double spacing_m = 0.0;  // on the part, between one and the next
};

struct ObservationOptions {
  double search_px = 4.0;    // reach of the association, working pixels, <= EdgeGrid::kCellPx
  int samples_per_view = 0;  // of an object, spread evenly; 0: all
  int threads = 1;
  bool aspects = false;  // edges as the camera sees them instead of the model's sharp ones
};

// Per known view and object, hidden lines removed by a depth buffer of all objects.
std::vector<VisibleSamples> FindVisibleSamples(std::span<const AdjustedView> views,
                                               std::span<const AdjustedObject> objects,
                                               std::span<const EdgeGrid> grids,
                                               const ObservationOptions& options);

// Associates the visible samples with like-directed image edge points. Ordered by view, object,
// sample.
std::vector<EdgeObservation> ObserveEdges(std::span<const AdjustedView> views,
                                          std::span<const AdjustedObject> objects,
                                          std::span<const EdgeGrid> grids,
                                          std::span<const VisibleSamples> visible,
                                          const ObservationOptions& options);

}  // namespace horopter
