// Keys of connected vertex paths as seen in an image, under weak and full perspective, for the
// view-led route.
//
// No single view of four points has an invariant: a model path is a surface of keys over the view
// sphere. The catalog keeps it as boxes, one per cell of the view sphere, that hold the keys of all
// views of the cell from some distance to infinity; an index of boxes finds them.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/invariants/invariant_key.h"

namespace horopter {

// Image of a chain a-b-c-d, 4 values: a and d in the similarity frame of the image that puts b at
// (0, 0) and c at (1, 0). covariance is 8 x 8 of the stacked pixels, or empty. Nothing when b and c
// (nearly) coincide.
std::optional<InvariantKey> PathViewKey(std::span<const Eigen::Vector2d, 4> image_points,
                                        const Eigen::MatrixXd& covariance = {});

// The image of the path from a direction (object to camera, need not be of unit length), up to a
// similarity of the image. distance_diameters: of the camera from the path's centre in diameters of
// the path; 0: infinitely far (weak perspective).
std::array<Eigen::Vector2d, 4> ProjectPath(std::span<const Eigen::Vector3d, 4> path,
                                           const Eigen::Vector3d& direction,
                                           double distance_diameters);

// Cells of half the view sphere. The view from behind is the mirror image under weak perspective:
// its key has the second and fourth value negated.
inline constexpr int kPathCells = 32;
Eigen::Vector3d PathCellDirection(int cell);  // unit

// How an image path is looked up: as it is, in reverse (d-c-b-a), and the mirror image of both,
// which a view from behind has.
enum class PathReading { kForward = 0, kReverse = 1, kMirrored = 2, kMirroredReverse = 3 };
inline constexpr int kPathReadings = 4;  // of the enumeration above

std::optional<InvariantKey> PathViewKey(std::span<const Eigen::Vector2d, 4> image_points,
                                        const Eigen::MatrixXd& covariance,
                                        PathReading reading);

// The keys of one path from the views of one cell.
struct PathViewBox {
  int cell = 0;
  std::array<float, 4> low{};
  std::array<float, 4> high{};
};

struct PathViewOptions {
  // Nearest camera in diameters of the path; the boxes hold all farther ones. Smaller: wider boxes,
  // more objects in an answer.
  double min_distance_diameters = 4.0;
  // A cell in which b-c is foreshortened below this share of its length is left out: there the key
  // runs away. Raising it leaves out more views and makes the boxes smaller.
  double min_length_ratio = 0.25;
  // b-c shorter than this share of the path's diameter gives no boxes: badly conditioned.
  double min_base_ratio = 0.1;
};

// Empty when the path is degenerate: b and c too near each other, or a coordinate is not finite.
std::vector<PathViewBox> PathViewBoxes(std::span<const Eigen::Vector3d, 4> path,
                                       const PathViewOptions& options = {});

}  // namespace horopter
