// Objects that no CAD file describes: an accepted calibrated reconstruction, and a range image.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/wireframe.h"

namespace horopter {

// A calibrated reconstruction as JSON:
//
//   {"format": "horopter_reconstruction", "unit": "mm",
//    "points": [[x, y, z], ..],                      optional: corners that segments name by index
//    "segments": [[0, 1], [[x, y, z], [x, y, z]], ..]}   ends as indices, as coordinates, or mixed
//
// Ends nearer than a thousandth of the extent are one corner, at their mean.
struct ReconstructionFile {
  Wireframe wireframe;  // in the file's unit
  std::string unit;     // "" when the file does not say
};

// Errors: NOT_FOUND, INVALID_ARGUMENT naming the file and what is wrong with it.
absl::StatusOr<ReconstructionFile> ReadReconstruction(const std::string& path);

struct RangeImageOptions {
  // Planes with fewer points than this share of all are not looked at. Raising it drops small
  // faces.
  double min_plane_share = 0.01;
  // Neighbouring points are at most this share of the extent apart; of sparse points the distance
  // is taken from themselves. Raising it bridges gaps between faces and blurs small ones.
  double spacing_share = 1.0 / 60.0;
  unsigned seed = 1;
};

// Points of a part's surface -> planes -> edges where two of them meet -> corners where three do.
// The points must cover the part all round; curved surfaces give no edges. Errors: INVALID_ARGUMENT
// (too few points, no extent, fewer than four planes or six edges).
struct RangeImageModel {
  Wireframe wireframe;
  int planes = 0;
  double explained = 0.0;  // share of the points that lie on the planes
};
absl::StatusOr<RangeImageModel> ModelFromPoints(const std::vector<Eigen::Vector3d>& points,
                                                const RangeImageOptions& options = {});

}  // namespace horopter
