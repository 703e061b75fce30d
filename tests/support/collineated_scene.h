// Parts in a projective reconstruction: what the thesis's decomposition starts from.
#pragma once

#include <optional>
#include <vector>

#include "server/vision/reconstruction/grow_projective.h"
#include "tests/support/joint_adjustment.h"

namespace horopter {

struct CollineatedScene {
  std::vector<CollineatedObject> objects;
  std::vector<std::optional<CameraMatrix>> cameras;
  std::vector<Eigen::Vector2i> sizes;
  std::vector<ObjectPointObservation> observations;
  std::vector<ObjectEdgeObservation> edge_observations;
  std::vector<Rigid3> world_from_object;  // truth
};

// `parts` parts about 200 mm apart seen by `views` cameras on an arc, reconstructed from noisy
// points, every part's collineation fitted to its reconstructed points. Empty when the
// reconstruction refuses.
std::optional<CollineatedScene> MakeCollineatedScene(unsigned seed,
                                                     int parts,
                                                     int views,
                                                     double sigma_px);

// Error of the pose of part `k` in part 0: of the part's middle (metres) and of the rotation (rad).
struct BetweenError {
  double shift_m = 0.0;
  double turn_rad = 0.0;
};
BetweenError ErrorBetween(const CollineatedScene& scene,
                          const std::vector<Rigid3>& metric_from_object,
                          int k);

}  // namespace horopter
