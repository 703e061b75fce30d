// The edge points that a camera sees of a part, from the part's stored aspects: nothing is
// rendered.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_search/pose_edges.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// Of the parts of an index, which outlive the object. Aspects are 10 degrees apart: contours of
// round parts are off by some hundredths of the size. Not for several threads before Prepare.
class ContourPoints {
 public:
  explicit ContourPoints(std::span<const AspectModel> models);

  // Unpacks a part's aspects, once; then any number of threads may ask for it.
  void Prepare(int object);

  // What a camera sees of a part, and from where: `toward` is the unit direction from the part's
  // centre to the camera in the object frame. Turns and size do not matter.
  struct Seen {
    Eigen::Vector3f toward = Eigen::Vector3f::Zero();
    std::vector<ModelEdgePoint> points;
  };
  // Leaves what was seen from nearly the same direction.
  void See(int object, const Rigid3& camera_from_object, Seen* seen) const;

 private:
  struct Stored {
    std::vector<Eigen::Vector3f> toward;              // of each aspect
    std::vector<std::vector<ModelEdgePoint>> points;  // of each aspect
  };
  std::span<const AspectModel> models_;
  std::vector<std::optional<Stored>> stored_;
};

}  // namespace horopter
