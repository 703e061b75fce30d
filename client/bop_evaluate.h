// Scores a result file against the ground truth of a BOP split, after BOP's definitions of MSSD and
// MSPD.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/bop_dataset.h"
#include "client/bop_results.h"

namespace horopter {

struct BopEvaluateOptions {
  double min_visib = 0.3;  // instances less visible in an image are no targets there
  std::set<int> scenes;    // empty: all
};

// Means over targets unless said otherwise; NaN where there is nothing to average.
struct BopScores {
  int scenes = 0;
  int targets = 0;       // (image, instance) pairs
  double ar = 0.0;       // mean of the two below
  double ar_mspd = 0.0;  // average recall over 5..50 px at an image width of 640
  double ar_mssd = 0.0;  // over 5..50 % of the diameter, in the camera frame
  double recall_10px = 0.0;
  // The same with the estimate seen by the camera of its own answer and the truth by the true one,
  // lenses included: what the images decide when nothing is known of the cameras.
  double own_10px = 0.0;
  double precision =
      0.0;  // share of estimates within 50 px of an instance of their object, however visible
  double rel_mm =
      0.0;  // median error of the pose of one recognised object relative to another, at its centre
  double rel_deg = 0.0;
  double focal_error = 0.0;      // median relative, over the images with recovered intrinsics
  double seconds_per_set = 0.0;  // median
};

// One row of the results against the truth.
struct BopScoredEstimate {
  int im_id = 0;
  int obj_id = 0;
  double score = 0.0;
  bool right = false;  // as precision counts it
  // To the nearest unused instance, by the answer's own camera, at an image width of 640; infinite
  // where there is none.
  double own_px = 0.0;
};

// What intervals over scenes and stated against observed scores are made from.
struct BopSceneScores {
  std::string tier;
  BopScores scores;  // of this scene alone
  int false_estimates = 0;
  std::vector<BopScoredEstimate> estimates;  // image by image, best score first
  // One value a pair of recognised objects in an image, and one an image with recovered intrinsics.
  std::vector<double> rel_mm, rel_deg, focal_error;
};

struct BopEvaluation {
  std::map<std::string, BopScores> tiers;  // by tier name, without the sum
  BopScores all;
  std::map<int, BopSceneScores> scenes;
};

// Estimates are matched per image, best score first, each to the unused instance of its object with
// the smallest MSPD below 50 px, by the true camera or by the answer's own. Symmetries are
// honoured; the lens distortion is not (K alone projects), as BOP does, but where own cameras
// project. Errors: NOT_FOUND, INVALID_ARGUMENT (dataset without meshes or models_info.json, broken
// file).
absl::StatusOr<BopEvaluation> EvaluateBopResults(const BopDataset& dataset,
                                                 const std::string& split,
                                                 const BopResults& results,
                                                 const BopEvaluateOptions& options = {});

}  // namespace horopter
