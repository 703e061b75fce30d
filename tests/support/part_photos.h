// Parts of simple solids and flat-shaded pictures of them.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <opencv2/core.hpp>
#include <utility>
#include <vector>

#include "server/vision/recognition/aspects/aspect_blob.h"
#include "server/vision/recognition/aspects/aspect_fragments.h"
#include "tests/support/shaded_photo.h"
#include "tests/support/solid_meshes.h"

namespace horopter {

struct PhotoPart {
  ObjectModel model;
  ObjectAspects object;
  ModelFragments fragments;
};

inline PhotoPart MakePart(const TriangleMesh& mesh, std::vector<Rigid3> symmetries = {}) {
  PhotoPart part;
  part.model.mesh = mesh;
  part.model.symmetries = std::move(symmetries);
  for (const auto& a : mesh.vertices) {
    for (const auto& b : mesh.vertices) {
      part.model.diameter_m = std::max(part.model.diameter_m, (a - b).norm());
    }
  }
  ObjectAspectOptions options;
  options.aspects.directions = 150;
  part.object = *MakeObjectAspects(part.model, options);
  part.fragments = MakeModelFragments(part.object.mesh, part.object.aspects);
  return part;
}

inline Rigid3 Turn(const Eigen::Vector3d& axis, double angle) {
  return {Eigen::AngleAxisd(angle, axis).toRotationMatrix(), Eigen::Vector3d::Zero()};
}

// An angle with arms of different length, a block of these half edges and an upright cylinder, each
// with its symmetries.
inline std::vector<PhotoPart> AngleBlockCylinder(const Eigen::Vector3d& block_half,
                                                 double cylinder_radius,
                                                 double cylinder_half) {
  std::vector<PhotoPart> parts;
  parts.push_back(MakePart(SweptMesh(
      {{-0.03, -0.02}, {0.04, -0.02}, {0.04, 0.0}, {-0.01, 0.0}, {-0.01, 0.03}, {-0.03, 0.03}},
      0.012)));
  parts.push_back(MakePart(BoxMesh(block_half),
                           {Turn(Eigen::Vector3d::UnitX(), M_PI),
                            Turn(Eigen::Vector3d::UnitY(), M_PI),
                            Turn(Eigen::Vector3d::UnitZ(), M_PI)}));
  std::vector<Rigid3> round;
  for (int i = 0; i < 36; ++i) {
    const Rigid3 turn = Turn(Eigen::Vector3d::UnitZ(), i * M_PI / 18);
    if (i > 0) round.push_back(turn);
    round.push_back(turn * Turn(Eigen::Vector3d::UnitX(), M_PI));
  }
  parts.push_back(MakePart(CylinderMesh(cylinder_radius, cylinder_half, 64), round));
  return parts;
}

// Render meshes as ShadedPhoto takes them.
inline cv::Mat PhotoOf(const std::vector<std::pair<const RenderMesh*, Rigid3>>& parts,
                       const PinholeCamera& camera) {
  std::vector<TriangleMesh> meshes(parts.size());
  std::vector<PosedMesh> posed;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    for (const auto& v : parts[i].first->vertices) meshes[i].vertices.push_back(v.cast<double>());
    for (const auto& t : parts[i].first->triangles)
      meshes[i].triangles.push_back(Eigen::Vector3i(t[0], t[1], t[2]));
    posed.emplace_back(&meshes[i], parts[i].second);
  }
  return ShadedPhoto(posed, camera);
}

}  // namespace horopter
