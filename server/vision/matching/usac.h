// OpenCV's robust estimators as we call them.
#pragma once

#include <opencv2/calib3d.hpp>

namespace horopter {

// MAGSAC++ with local optimisation (Barath et al. 2020), on one thread and deterministic for a
// seed. threshold_px: largest sigma of an inlier.
inline cv::UsacParams Magsac(double threshold_px,
                             double confidence,
                             int max_iterations,
                             unsigned seed) {
  cv::UsacParams usac;
  usac.confidence = confidence;
  usac.isParallel = false;
  usac.maxIterations = max_iterations;
  usac.randomGeneratorState = static_cast<int>(seed);
  usac.sampler = cv::SAMPLING_UNIFORM;
  usac.score = cv::SCORE_METHOD_MAGSAC;
  usac.loMethod = cv::LOCAL_OPTIM_SIGMA;
  usac.loIterations = 10;
  usac.threshold = threshold_px;
  return usac;
}

}  // namespace horopter
