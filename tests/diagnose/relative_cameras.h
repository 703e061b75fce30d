// Estimated cameras against the truth without aligning frames: rotations between images, directions
// from one to another, focal lengths.
#pragma once

#include <optional>
#include <vector>

#include "client/bop_dataset.h"

namespace horopter {

struct EstimatedCamera {
  PinholeCamera camera;
  Rigid3 camera_from_world;      // of any scale
  double focal_log_sigma = 0.0;  // as stated; 0: nothing is
};

// Of pairs of registered images whose true poses are known, and of registered images. Empty where
// there is none.
struct CameraErrors {
  int registered = 0;
  std::vector<double> rotations_deg;  // between the images of a pair
  // Of the directions from one camera to the other, in the first one's frame; pairs whose true
  // cameras are in one place are left out.
  std::vector<double> baselines_deg;
  std::vector<double> focal;            // |f / true f - 1|
  std::vector<double> focal_in_sigmas;  // |ln(f / true f)| over the stated deviation

  std::optional<double> MedianRotation() const;
  std::optional<double> WorstRotation() const;
  std::optional<double> MedianBaseline() const;
  std::optional<double> MedianFocal() const;
  std::optional<double> WorstFocal() const;
};

// views: one per image of the scene; images as CompleteTruth gives them. The true focal length is
// the mean of both axes'.
CameraErrors CompareRelative(const std::vector<std::optional<EstimatedCamera>>& views,
                             const BopScene& scene);

}  // namespace horopter
