// What every metric result must be, and how far its focal lengths are off.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <vector>

#include "server/vision/reconstruction/self_calibration.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {

inline void ExpectSane(const MetricResult& r) {
  EXPECT_EQ(r.outcome == MetricOutcome::kMetric, r.reason.empty()) << r.reason;
  for (const auto& view : r.scene.views) {
    if (!view) continue;
    EXPECT_TRUE(std::isfinite(view->camera.focal_px) && view->camera.focal_px > 0.0);
    EXPECT_TRUE(view->camera_from_scene.R.allFinite() && view->camera_from_scene.t.allFinite());
    EXPECT_NEAR(view->camera_from_scene.R.determinant(), 1.0, 1e-6);
  }
  for (const auto& x : r.scene.points) EXPECT_TRUE(!x || x->allFinite());
  for (const auto& l : r.scene.lines) EXPECT_TRUE(!l || l->allFinite());
}

// Log of estimated over true focal length, of the views that are there.
inline std::vector<double> FocalErrors(const SyntheticTracks& truth, const MetricResult& r) {
  std::vector<double> errors;
  for (size_t v = 0; v < r.scene.views.size(); ++v) {
    if (!r.scene.views[v]) continue;
    errors.push_back(std::log(r.scene.views[v]->camera.focal_px / truth.cameras[v].focal_px));
  }
  return errors;
}

}  // namespace horopter
