// Meshes of scanned surfaces: how noisy they are, and the surface beneath. Zheng, Fu, Au, Tai 2011:
// bilateral normal filtering for mesh denoising; Sun, Rosin, Martin, Langbein 2007: vertices.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// What tells a scan from a tessellated design: vertices all over the surface, not at its edges
// alone, and neighbours that lie on no smooth surface.
struct SurfaceNoise {
  // Of the area, what belongs to vertices whose second neighbourhoods turn by less than 50 degrees:
  // a design has most of its vertices on its edges.
  double smooth_share = 0.0;
  // How far neighbourhoods are off their paraboloids, rms in mean edge lengths of the vertex: the
  // first quartile of that area, 0 where a fourth of it is plane or evenly curved.
  double roughness = 0.0;
  double deviation = 0.0;  // the same in the mesh's unit, the median of that area
};

// Of a welded mesh. Deterministic; of large meshes every n-th vertex is looked at.
SurfaceNoise MeasureSurfaceNoise(const TriangleMesh& mesh);

// More than .5 and more than .007: nine scans (LM-O, benchvise) have .89 - 1.0 and .009 - .041; of
// 28 designs (cad-dev, tools) two have .58 and .68 of the first, with .0002 and .0044, the rest
// less.
bool IsScan(const SurfaceNoise& noise);

// The surface beneath the noise: unit normals of the triangles, which tell creases, and the mesh
// with vertices moved towards them by at most four deviations: what is larger than noise stays.
struct DenoisedSurface {
  std::vector<Eigen::Vector3d> normals;
  TriangleMesh mesh;
};

DenoisedSurface Denoise(const TriangleMesh& mesh, const SurfaceNoise& noise);

}  // namespace horopter
