// How well a pose explains one image: its visible edges are there, and the image's edges inside the
// part are its own.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspect_search/pose_edges.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

inline constexpr double kHiddenShare =
    0.02;  // of the diameter by which what hides an edge is nearer

// A part as one view shows it: working pixels x0 .. x0 + width - 1 and so on.
struct ObjectLayer {
  static constexpr std::uint8_t kNoEdge = 255;  // where the part has none
  int x0 = 0, y0 = 0, width = 0, height = 0;
  std::vector<float> inverse_depth;    // 1 / m, 0 where the part is not
  std::vector<std::uint8_t> edge_bin;  // direction of a visible edge of the part that is near

  bool Has(int x, int y) const { return x >= x0 && y >= y0 && x < x0 + width && y < y0 + height; }
  std::size_t Cell(int x, int y) const {
    return static_cast<std::size_t>(y - y0) * width + (x - x0);
  }
};

// The same part in another image of a scene.
struct SiblingView {
  const AspectImage* image = nullptr;
  PinholeCamera camera;  // of the original image
  Rigid3 camera_from_object;
  const ObjectLayer* layer = nullptr;  // of the part in that image
};

struct AspectScoreOptions {
  double render_px = 200.0;   // a diameter; smaller is faster and coarser
  double tolerance_px = 3.0;  // working pixels; support falls to 0 there
  // Image edges so near the silhouette must be explained as well, and no farther: large parts stand
  // beside others (ADR 43).
  double max_margin_px = 16.0;
  // Chance (AspectImage::chance) up to this is free, as parts have it themselves; what exceeds it
  // is taken off the precision, and image edges in such places count less in the recall.
  double free_chance = kFreeChance;
};

// precision: share of the visible model edge with like-directed image edge, as far as that is not
// chance; recall: share of the
// image's edge strength (at most AspectImage::kMaxStrength a point) inside silhouette and margin
// that lies on like-directed model edge. score = 2 P R / (P + R) * n / (n + kHalfLengthPx) with
// n = support_px.
struct AspectScore {
  double precision = 0.0;
  double recall = 0.0;
  double support_px = 0.0;  // supported visible edge, working pixels
  double visible_px = 0.0;  // visible edge that no other part hides, working pixels
  double hidden_px = 0.0;   // ... that other parts hide
  double claimed_px = 0.0;  // ... found where another part has a like-directed edge
  double score = 0.0;
  // Of the edge strength on its surface that is not its own, what siblings show in the same places;
  // 0 without siblings.
  double print = 0.0;
};

// AspectScore::score of its parts.
double ScoreOf(double precision, double recall, double support_px);

// A pose whose edges are found so well may be one of a part that is printed on: image edges within
// it that are not its own say nothing before other views have told whether they stay in their
// places. The score it has with this recall, if that is more; its own of others.
inline constexpr double kPrintPrecision = 0.75;
double PresumedScore(double precision, double recall, double support_px, double presumed_recall);

// The camera is that of the original image. All zero when nothing of the part is visible. `others`
// are parts that are known to be there: what they hide of this one is not asked for, image edges of
// theirs need no explanation and support nothing; nor do edges that `siblings` show in the same
// places of the part's surface: those are print, scratches or seams that CAD does not have.
AspectScore ScorePose(const AspectImage& image,
                      const RenderMesh& mesh,
                      const PinholeCamera& camera,
                      const Rigid3& camera_from_object,
                      const AspectScoreOptions& options = {},
                      std::span<const ObjectLayer* const> others = {},
                      std::span<const SiblingView> siblings = {});

// The same of given visible edges of the working image at that pose.
AspectScore ScoreEdges(const AspectImage& image,
                       const RenderMesh& mesh,
                       const VisibleEdges& edges,
                       const PinholeCamera& camera,
                       const Rigid3& camera_from_object,
                       const AspectScoreOptions& options = {},
                       std::span<const ObjectLayer* const> others = {},
                       std::span<const SiblingView> siblings = {});

// Visible edges of the working image at a pose, the camera that of the original.
VisibleEdges WorkingEdges(const AspectImage& image,
                          const RenderMesh& mesh,
                          const PinholeCamera& camera,
                          const Rigid3& camera_from_object,
                          double render_px);

// What ScorePose needs of the others, of visible edges of the working image. Empty when nothing of
// the part is visible.
ObjectLayer MakeObjectLayer(const AspectImage& image,
                            const VisibleEdges& edges,
                            const PinholeCamera& camera,
                            const AspectScoreOptions& options = {});

// The same of a part at a pose, rendered for it.
ObjectLayer MakeObjectLayer(const AspectImage& image,
                            const RenderMesh& mesh,
                            const PinholeCamera& camera,
                            const Rigid3& camera_from_object,
                            double render_px);

// Mean support (0..1) that edge points of a part find in the distance maps, above what chance gives
// there beyond `free_chance`; edges farther than reach_px (working pixels) support nothing. Much
// cheaper than a score: nothing is rendered.
double PointSupport(const AspectImage& image,
                    std::span<const ModelEdgePoint> points,
                    const PinholeCamera& camera,
                    const Rigid3& camera_from_object,
                    double free_chance = kFreeChance,
                    double reach_px = 4.0);

}  // namespace horopter
