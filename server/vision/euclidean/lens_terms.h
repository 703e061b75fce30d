// What a lens does beyond one radial coefficient, where the scene's edges and its plane prove it.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/euclidean/scene_bundle.h"

namespace horopter {

// The second radial and the two tangential coefficients (Brown 1971, in the order of OpenCV); the
// first is PinholeCamera::k1.
struct LensTerms {
  double k2 = 0.0;
  double p1 = 0.0;
  double p2 = 0.0;

  bool none() const { return k2 == 0.0 && p1 == 0.0 && p2 == 0.0; }
};

// By how much the terms shift the image of a point that the camera without them has at `pixel`;
// pixels.
Eigen::Vector2d ShiftByTerms(const PinholeCamera& camera,
                             const LensTerms& terms,
                             const Eigen::Vector2d& pixel);

// Where the camera without them has the point that is at `pixel` with them (fixed point, five
// rounds: exact to 1e-3 px for shifts of up to 8 px inside an image of 640).
Eigen::Vector2d WithoutTerms(const PinholeCamera& camera,
                             const LensTerms& terms,
                             const Eigen::Vector2d& pixel);

struct LensTermOptions {
  bool estimate = true;
  // Deviations of the terms of a lens nobody knows.
  double k2_sigma = 0.2;
  double tangential_sigma = 0.005;
  // What edges and plane must say against a lens without terms (LensFit::proof). Few edges make its
  // tail heavier than that of chi square: up to 42 in 12 scenes of real parts without terms
  // (one-off). Higher: fewer lenses have terms.
  double least_proof = 60.0;
  // Shift that they make somewhere among what was observed, image pixels: less is not worth a word.
  double least_shift_px = 0.3;
  int rounds = 3;  // of fit and adjustment
};

struct LensFit {
  LensTerms terms;        // to be added to those that the observations are without already
  double proof = 0.0;     // chi square, 3 degrees of freedom
  double shift_px = 0.0;  // largest among the observations
};

// One step towards the terms that these views have in common, in an adjusted bundle; all else may
// move, but for the gauge and the scales. The proof is a score test whose variance is that of the
// edges' own sums (an edge of a part errs in common in all views: Liang and Zeger 1986), so that it
// needs no model of their noise. Nothing where the system cannot be solved.
std::optional<LensFit> FitLensTerms(const SceneBundle& bundle,
                                    const std::vector<int>& views,
                                    const LensTermOptions& options);

}  // namespace horopter
