// What one image says of each visible edge of a placed part, and which of its edges no part has.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

enum class EdgeState {
  kSupported,    // the image has an edge of like direction there
  kUnsupported,  // it has none
  kHidden,       // behind another part
};

// Points of one edge in one state, in order along it, pixels of the image.
struct EdgeRun {
  int edge = -1;  // index into ObjectModel::edges; -1: outline or rim that is none of them
  EdgeState state = EdgeState::kSupported;
  std::vector<Eigen::Vector2d> points;
};

struct EdgeReport {
  std::vector<EdgeRun> runs;
  // Lengths, pixels of the image. visible: supported or not, without what is hidden.
  double visible_px = 0.0;
  double supported_px = 0.0;
  double hidden_px = 0.0;
};

struct ExplainedObject {
  const PreparedObject* object = nullptr;
  Rigid3 camera_from_object;
};

// Support as AspectScore counts it: full within a third of its tolerance, the border of an edge's
// state where it is one half. others: parts that may hide the edges. Empty when nothing of the part
// is visible.
EdgeReport ReportEdges(const AspectImage& image,
                       const PinholeCamera& camera,
                       const ExplainedObject& placed,
                       std::span<const ExplainedObject> others);

// Pieces of the image's edge chains (pixels of the image) that lie beside all visible edges of the
// parts; shorter ones than `least_px` are left out. Chains of fine texture are kept: they are
// unexplained too.
std::vector<std::vector<Eigen::Vector2d>> UnexplainedEdges(const ImageFeatures& features,
                                                           const PinholeCamera& camera,
                                                           std::span<const ExplainedObject> placed,
                                                           double least_px = 12.0);

}  // namespace horopter
