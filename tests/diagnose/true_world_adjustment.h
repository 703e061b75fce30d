// Cameras and parts of a scene made to agree with the parts' poses in all images.
#pragma once

#include <optional>
#include <vector>

#include "client/bop_dataset.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

struct AnnotatedPart {
  const ObjectModel* model = nullptr;
  Rigid3 world_from_object;
  // Per image as annotated; empty: not seen, or the image has no pose. A pose that differs from the
  // place by a symmetry counts as that.
  std::vector<std::optional<Rigid3>> camera_from_object;
  double median_px = 0.0;  // output: of its boxes' corners
};

struct WorldAgreement {
  double rms_px = 0.0;  // of the corners that agree
  double cost = 0.0;    // of all, each distance bounded: lower where more agree
};

// Moves the parts, and the cameras with has_pose that are not given (when none is given one stays),
// so that the corners of the parts' boxes project as the annotated poses project them; what moves
// against the rest has little say.
WorldAgreement AdjustTrueWorld(const std::vector<bool>& given,
                               std::vector<BopImage>* images,
                               std::vector<AnnotatedPart>* parts);

}  // namespace horopter
