// Which six of many points to ask for together: the catalog and a scene must choose the same sets,
// or no query meets a stored key.
#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

namespace horopter {

struct SixPointSetOptions {
  // Sets whose determinants are looked at: all there are, or that many drawn ones. Raising it finds
  // better ones of many points (all of 28 points are 376,740 sets).
  int max_looked_at = 400000;
  unsigned seed = 1;  // of the draws
};

// Sets of six indices, ascending in themselves, at most `most`; those first of which the smallest
// determinant of any four points is largest. The determinants are of the points in the affine frame
// in which their second moment is the identity: an affine map of all points changes nothing, a mild
// collineation (a quasi-affine frame) or points that are missing little. Ties in the order of the
// indices. Empty with fewer than six points or points that lie in a plane.
std::vector<std::array<int, 6>> WellSpreadSets(std::span<const Eigen::Vector3d> points,
                                               int most,
                                               const SixPointSetOptions& options = {});

}  // namespace horopter
