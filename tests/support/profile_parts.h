// Parts as experiments on invariants want them: extruded L, T, U, step and wedge profiles, some
// with a clipped corner or a boss; and scenes of them as points and edges.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/rigid3.h"
#include "tests/support/random.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {

struct ProfilePartOptions {
  double clipped_share = 0.5;  // of parts with a clipped corner
  double boss_share = 0.5;     // of parts with a boss on the cap
};

// 50 - 110 mm wide, extruded by 30 - 80 mm; 8 to 26 vertices. The same seed gives the same part.
// Vertices, straight edges and diameter are set, there is no mesh.
ObjectModel ProfilePart(unsigned seed, const ProfilePartOptions& options = {});

struct ProfileSceneOptions {
  unsigned seed = 1;
  int parts = 3;
  int views = 6;
  double sigma_px = 0.5;
  double missing_share = 0.2;   // of the observations
  double deleted_share = 0.25;  // of the vertices: seen in no view
  double clutter_share = 0.2;   // points that are no vertex, of the number of vertices
  double outlier_share = 0.0;   // of the observations
};

// Some of `catalog`, all different, on a circle of 120 mm, extruded upwards.
struct ProfileScene {
  std::vector<int> objects;  // index into the catalog, per part
  std::vector<Rigid3> world_from_object;
  // Per point of the tracks: part and vertex, -1 for clutter.
  std::vector<int> part_of_point, vertex_of_point;
  std::vector<std::array<int, 2>> edges;  // true edges of which both ends are points
  SyntheticTracks tracks;
};
ProfileScene MakeProfileScene(const std::vector<ObjectModel>& catalog,
                              const ProfileSceneOptions& options);

}  // namespace horopter
