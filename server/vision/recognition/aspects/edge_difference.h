// Where two placed parts, or two poses of one, show different edges: what images can tell them
// apart by.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/geometry/view_difference.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {

// A visible edge point of one of the two that the other has none like.
struct DifferingPoint {
  VisibleEdgePoint point;  // in its own object's frame
  bool of_a = true;
  float length_px = 0.0f;  // of edge that it stands for
};

struct EdgeDifference {
  std::vector<DifferingPoint> points;
  double length_a_px = 0.0, length_b_px = 0.0;  // visible edge
  double only_a_px = 0.0, only_b_px = 0.0;      // of it, without a like one
};

struct EdgeDifferenceOptions {
  double tolerance_px = 3.0;  // edges of like direction nearer than this are alike
  double render_px = 160.0;   // of a diameter
};

// Of edge that a point stands for, px: half the way to both neighbours on its chain.
float LengthAt(const VisibleEdges& edges, std::size_t i);

// Both as the camera sees them. k1 counts.
EdgeDifference CompareEdges(const RenderMesh& a,
                            const Rigid3& camera_from_a,
                            const RenderMesh& b,
                            const Rigid3& camera_from_b,
                            const PinholeCamera& camera,
                            const EdgeDifferenceOptions& options = {});

// The same of edges that were found before.
EdgeDifference CompareEdges(const VisibleEdges& a,
                            const VisibleEdges& b,
                            const PinholeCamera& camera,
                            const EdgeDifferenceOptions& options = {});

// A place on the parts where their edges differ.
struct DistinguishingFeature {
  bool of_a = true;                                     // its edges are a's, b has none there
  VisibleEdgeKind kind = VisibleEdgeKind::kSilhouette;  // of most of its edge
  Eigen::Vector3d place = Eigen::Vector3d::Zero();      // frame of a, metres
  double size_m = 0.0;                                  // extent
  double length_px = 0.0;  // of its edge in the view around the part that shows most of it
};

struct DistinguishingFeatures {
  std::vector<DistinguishingFeature> features;  // longest edge first
  double differing_share = 0.0;                 // 0..1, of the edges of both over all views, mean
  double most_in_a_view = 0.0;                  // ... of the view that tells most
  std::vector<ViewDifference> views;            // each of the views, frame of a
};

// From 26 views around a, 160 px a diameter; at most `most` features, none that shows less than
// `min_length_px` in every view.
DistinguishingFeatures FindDistinguishingFeatures(const RenderMesh& a,
                                                  const RenderMesh& b,
                                                  const Rigid3& a_from_b,
                                                  int most = 4,
                                                  double min_length_px = 8.0);

// The part's edges from these views, 160 px a diameter.
std::vector<VisibleEdges> FindEdgesAround(const RenderMesh& mesh);

// From the same views, of a's visible edges those that `is_asked` names: by what a part without
// them would differ.
std::vector<ViewDifference> FindVisibleLength(
    const RenderMesh& a, const std::function<bool(const VisibleEdgePoint&)>& is_asked);

}  // namespace horopter
