// What single images show, transferred into the others through cameras that are known: along the
// ray of its image a hypothesis has one unknown, its depth in their unit.
#pragma once

#include <Eigen/Core>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_search/pose_edges.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// The edge points that a camera sees of a part, from the part's stored aspects: nothing is
// rendered. Of the parts of an index, which outlive the object. Aspects are 10 degrees apart:
// contours of round parts are off by some hundredths of the size. Any number of threads may ask.
class ContourPoints {
 public:
  explicit ContourPoints(std::span<const AspectModel> models);

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
    std::once_flag unpacked;
    std::vector<Eigen::Vector3f> toward;              // of each aspect
    std::vector<std::vector<ModelEdgePoint>> points;  // of each aspect
  };
  const Stored& StoredOf(int object) const;

  std::span<const AspectModel> models_;
  mutable std::vector<Stored> stored_;  // of each part, once it was asked for
};

// A part in known cameras: a scene of this object, and what the views' edges say for it.
struct TransferredObject {
  AspectScene scene;  // of this one object; cameras as the search has moved them
  double unit_m = 1.0;
  double support = 0.0;
  int view = -1;           // whose image lists it
  bool coincides = false;  // with what another image lists
};

// Best first.
void SortBySupport(std::vector<TransferredObject>* list);

// Factor by which a single image's hypothesis errs in depth.
inline constexpr double kDepthError = 1.18;

// What is looked for along a ray.
struct UnitRange {
  double least_m = 0.0, most_m = 0.0;  // metres of the unit, both positive
  // The unit is the cameras': what differs is taken for an error of the hypothesis's depth.
  bool known = false;
};

struct TransferOptions {
  // Working px by which edges may be off at first, and a view as a whole.
  double reach_px = 10.0;
};

class Transfer {
 public:
  // cameras: in metres under the prior's unit, views empty where not known. What is pointed to
  // outlives the object.
  Transfer(const AspectLinkInput& input,
           const std::vector<std::optional<AspectSceneView>>& cameras,
           const CamerasPrior& prior,
           const ContourPoints& contours,
           const TransferOptions& options);

  // The units under which the other views show most of the hypothesis of a view, best first, at
  // most `most` that differ; none where fewer than `least_views` others could show it.
  std::vector<TransferredObject> Place(int view,
                                       const AspectHypothesis& hypothesis,
                                       const UnitRange& range,
                                       int least_views,
                                       int most) const;

  // The same with views shifted as a whole to where they show most and then all adjusted: cameras
  // under their prior, the object, and the unit. Sets what is found in the end, of all views.
  void Adjust(TransferredObject* placed) const;

  // Sum over the views of what they show of an object above what wrong places do; left_out: a view
  // that is not asked, or -1.
  double Support(const AspectScene& scene, double reach_px, int left_out = -1) const;

 private:
  TransferredObject At(int view, const Rigid3& camera_from_object, double unit_m, int object) const;
  void ShiftViews(AspectScene* scene) const;

  const AspectLinkInput& in_;
  const std::vector<std::optional<AspectSceneView>>& cameras_;
  const CamerasPrior& prior_;
  const ContourPoints& contours_;
  const TransferOptions& options_;
};

}  // namespace horopter
