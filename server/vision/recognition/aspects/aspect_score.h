// How well a pose explains one image: its visible edges are there, and the image's edges inside the
// part are its own.
#pragma once

#include <span>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/pose_edges.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

struct AspectScoreOptions {
  double render_px = 200.0;       // a diameter; smaller is faster and coarser
  double tolerance_px = 3.0;      // working pixels; support falls to 0 there
  double max_turn_rad = 0.45;     // between directions of model and image edge
  double margin_share = 0.10;     // of the size: image edges so near the silhouette must be
                                  // explained as well
  double half_length_px = 200.0;  // supported px at which the size factor is one half
  // Chance (AspectImage::chance) up to this is free, as parts have it themselves; what exceeds it
  // is taken off the precision, and image edges in such places count less in the recall.
  double free_chance = 0.10;
};

// precision: share of the visible model edge with like-directed image edge, as far as that is not
// chance; recall: share of the
// image's edge strength (at most AspectImage::kMaxStrength a point) inside silhouette and margin
// that lies on like-directed model edge. score = 2 P R / (P + R) * n / (n + half_length_px) with
// n = support_px.
struct AspectScore {
  double precision = 0.0;
  double recall = 0.0;
  double support_px = 0.0;  // supported visible edge, working pixels
  double visible_px = 0.0;  // visible edge, working pixels
  double score = 0.0;
};

// The camera is that of the original image. All zero when nothing of the part is visible.
AspectScore ScorePose(const AspectImage& image,
                      const RenderMesh& mesh,
                      const PinholeCamera& camera,
                      const Rigid3& camera_from_object,
                      const AspectScoreOptions& options = {});

// Mean support (0..1) that edge points of a part find in the distance maps, above what chance gives
// there beyond `free_chance`; edges farther than reach_px (working pixels) support nothing. Much
// cheaper than a score: nothing is rendered.
double PointSupport(const AspectImage& image,
                    std::span<const ModelEdgePoint> points,
                    const PinholeCamera& camera,
                    const Rigid3& camera_from_object,
                    double free_chance = 0.10,
                    double reach_px = 4.0);

}  // namespace horopter
