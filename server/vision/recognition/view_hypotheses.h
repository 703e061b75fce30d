// Hypotheses of one object in one view: two connected image edges held against two connected model
// edges (thesis 4.6, frontend.md 4).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/pose_score.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/view_evidence.h"

namespace horopter {

// Image points a, b, c with edges a-b and b-c; b is a junction. Image pixels.
struct ImagePath {
  Eigen::Vector2d a = Eigen::Vector2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
  Eigen::Vector2d c = Eigen::Vector2d::Zero();
  int segment_ab = -1;  // indices into ImageFeatures::segments
  int segment_bc = -1;
  double rank = 0.0;  // larger: longer edges, ends that are junctions
};

// The image's paths, best rank first, at most max_paths. Segments in fine texture take no part.
// on_plane (empty or one per segment): segments that lie on the supporting plane; paths of two such
// rank low.
std::vector<ImagePath> FindImagePaths(const ImageFeatures& features,
                                      const std::vector<bool>& on_plane,
                                      double working_from_image,
                                      int max_paths);

// The up to two poses in which a weak-perspective view, corrected to full perspective, shows the
// model path along the image path. `reversed` matches the image's a with the model's c.
struct PathPoses {
  int count = 0;
  Rigid3 camera_from_object[2];
};
PathPoses PosesFromPath(const ObjectModel& model,
                        const VertexPath& path,
                        bool reversed,
                        const PinholeCamera& camera,
                        const ImagePath& image_path);

struct ViewHypothesisOptions {
  int max_paths = 450;  // image paths tried; more: slower, finds smaller and more hidden parts
  float quick_reach_px = 6.0f;  // working pixels
  float give_up = 0.25f;        // mean support of the first quarter below which a pose is dropped
  int pool = 600;               // poses kept by quick score before non-maximum suppression
  int refined = 90;             // distinct poses refined
  int verified = 24;            // ... of which verified with hidden lines removed
  double distinct_px = 12.0;    // working pixels
  double min_radius_px = 12.0;  // projected radius of the part, working pixels
  double max_radius_px = 420.0;
  double focal_log_sigma = 0.35;
};

struct ViewHypotheses {
  std::vector<ViewHypothesis> best;  // verified, distinct, best F1 first
  std::vector<ViewHypothesis>
      pool;  // refined, distinct, best quick score first; score = quick score
};

// All hypotheses of one object in one view with the given start camera.
ViewHypotheses FindViewHypotheses(const PreparedObject& object,
                                  int object_index,
                                  const ViewEvidence& view,
                                  int view_index,
                                  const std::vector<ImagePath>& paths,
                                  const PinholeCamera& start,
                                  const ViewHypothesisOptions& options,
                                  const StopRequested& stop);

}  // namespace horopter
