// Known parts in one image of an uncalibrated camera, from the aspects of their CAD models.
//
// Votes of contour fragments, tested on oriented distance maps (aspect_votes.h), are refined to
// poses (pose_edges.h) and scored by what they explain (aspect_score.h), each step for fewer of
// them at a finer rendering.
#pragma once

#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/geometry/camera_prior.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspect_search/aspect_votes.h"
#include "server/vision/recognition/aspect_search/pose_edges.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

struct FindAspectOptions {
  AspectVoteOptions votes;
  // Focal length in image widths; a known camera is given to FindAspectHypotheses instead.
  double nominal_focal_share = kNominalFocalShare;
  double log_focal_sigma = kNominalFocalLogSigma;
  int coarse_per_object = 10;  // poses refined and scored in a coarse rendering
  double coarse_render_px = 110.0;
  int fine_per_object = 6;  // ... in a fine one; also the most hypotheses of a part
  double fine_render_px = 200.0;
  // Coarse poses that score less than this share of the image's best are not refined finely.
  double fine_share = 0.3;
  int threads = 1;
};

// For a request that has little time: fewer matches, votes and poses, in less than half of the time
// (25 parts; ADR 60). Never more than the options ask for.
FindAspectOptions Brief(FindAspectOptions options);

struct AspectHypothesis {
  int object = -1;       // index of FragmentIndex::models
  PinholeCamera camera;  // of the original image, with the focal length found
  Rigid3 camera_from_object;
  double precision = 0.0;
  double recall = 0.0;
  double support_px = 0.0;
  double score = 0.0;  // AspectScore::score
};

struct AspectFindings {
  std::vector<AspectHypothesis> hypotheses;  // best first, distinct, of all parts
  AspectVotes votes;
  int refined = 0, fine = 0;  // poses that reached the first and the last step
};

// The camera of an image of unknown focal length.
PinholeCamera NominalCamera(const AspectImage& image,
                            double nominal_focal_share = kNominalFocalShare);

// `known`: the camera of the original image; its focal length is kept. Null: nominal, and refined
// under its prior. Empty when nothing is found; what was found so far when stopped.
AspectFindings FindAspectHypotheses(const AspectImage& image,
                                    const FragmentIndex& index,
                                    const FindAspectOptions& options = {},
                                    const PinholeCamera* known = nullptr,
                                    const StopRequested& stop = {});

// A part's diameter at a pose in the image, px of the camera.
double SizePx(const AspectModel& model, const PinholeCamera& camera, const Rigid3& pose);

// Largest distance in the image (px of the cameras) between corners of the part's bounding box
// under two poses, the least over its symmetries.
double PoseDistancePx(const AspectModel& model,
                      const PinholeCamera& camera_a,
                      const Rigid3& a,
                      const PinholeCamera& camera_b,
                      const Rigid3& b);

}  // namespace horopter
