// Parts of simple solids and flat-shaded pictures of them.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "server/vision/recognition/aspects/aspect_blob.h"
#include "server/vision/recognition/aspects/aspect_fragments.h"
#include "tests/server/vision/recognition/aspects/solid_meshes.h"

namespace horopter {

struct PhotoPart {
  ObjectModel model;
  ObjectAspects object;
  PartFragments fragments;
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
  part.fragments = MakePartFragments(part.object.mesh, part.object.aspects);
  return part;
}

inline Rigid3 Turn(const Eigen::Vector3d& axis, double angle) {
  return {Eigen::AngleAxisd(angle, axis).toRotationMatrix(), Eigen::Vector3d::Zero()};
}

// Flat shading in front of a light table, slightly blurred and noisy; `parts` far to near.
inline cv::Mat PhotoOf(const std::vector<std::pair<const RenderMesh*, Rigid3>>& parts,
                       const PinholeCamera& camera) {
  constexpr int kFine = 4;  // drawn so much larger: filled outlines are half a pixel too wide
  cv::Mat image(kFine * camera.height, kFine * camera.width, CV_8UC3, cv::Scalar(170, 175, 180));
  const Eigen::Vector3d light = Eigen::Vector3d(0.3, -0.8, -0.5).normalized();
  for (const auto& [mesh, pose] : parts) {
    // Faces far to near, as these parts allow.
    std::vector<std::pair<double, int>> order;
    for (int t = 0; t < static_cast<int>(mesh->triangles.size()); ++t) {
      double depth = 0.0;
      for (int k = 0; k < 3; ++k)
        depth += (pose * mesh->vertices[mesh->triangles[t][k]].cast<double>()).z();
      const Eigen::Vector3d x = pose * mesh->vertices[mesh->triangles[t][0]].cast<double>();
      if ((pose.R * mesh->face_normals[t].cast<double>()).dot(x) < 0) order.push_back({-depth, t});
    }
    std::sort(order.begin(), order.end());
    for (const auto& [depth, t] : order) {
      std::vector<cv::Point> corners;
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector2d p =
            Project(camera, pose * mesh->vertices[mesh->triangles[t][k]].cast<double>());
        const Eigen::Vector2d fine = 16 * ((p.array() + 0.5) * kFine - 0.5);
        corners.emplace_back(static_cast<int>(std::lround(fine.x())),
                             static_cast<int>(std::lround(fine.y())));
      }
      const double shade =
          60 + 50 * (1 + (pose.R * mesh->face_normals[t].cast<double>()).dot(light));
      cv::fillConvexPoly(image, corners, cv::Scalar(shade, shade, shade), cv::LINE_8, 4);
    }
  }
  cv::resize(image, image, cv::Size(camera.width, camera.height), 0, 0, cv::INTER_AREA);
  cv::GaussianBlur(image, image, cv::Size(), 0.7);
  cv::Mat noise(image.size(), CV_8UC3);
  cv::RNG random(7);
  random.fill(noise, cv::RNG::UNIFORM, 0, 4);
  return image + noise;
}

}  // namespace horopter
