// Pictures of meshes as a camera takes them: flat shading before an even table, a little blur and
// noise.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

using PosedMesh = std::pair<const TriangleMesh*, Rigid3>;  // camera_from_object

// 8-bit BGR of the camera's size, without its lens. All of a mesh must lie before the camera.
inline cv::Mat ShadedPhoto(const std::vector<PosedMesh>& meshes,
                           const PinholeCamera& camera,
                           unsigned seed = 7) {
  constexpr int kFine = 3;  // drawn so much larger
  const int width = kFine * camera.width, height = kFine * camera.height;
  cv::Mat fine(height, width, CV_8UC3, cv::Scalar(170, 175, 180));
  std::vector<double> nearest(static_cast<std::size_t>(width) * height, 1e30);
  const Eigen::Vector3d light = Eigen::Vector3d(0.3, -0.8, -0.5).normalized();
  for (const auto& [mesh, pose] : meshes) {
    for (const Eigen::Vector3i& t : mesh->triangles) {
      std::array<Eigen::Vector3d, 3> x;
      std::array<Eigen::Vector2d, 3> p;
      for (int k = 0; k < 3; ++k) {
        x[k] = pose * mesh->vertices[t[k]];
        p[k] = ((Project(camera, x[k]).array() + 0.5) * kFine - 0.5).matrix();
      }
      const Eigen::Vector3d normal = (x[1] - x[0]).cross(x[2] - x[0]).normalized();
      if (!(normal.dot(x[0]) < 0)) continue;
      const double area =
          (p[1] - p[0]).x() * (p[2] - p[0]).y() - (p[1] - p[0]).y() * (p[2] - p[0]).x();
      if (area == 0) continue;
      const int shade = static_cast<int>(60 + 50 * (1 + normal.dot(light)));
      const Eigen::Vector2d low = p[0].cwiseMin(p[1]).cwiseMin(p[2]);
      const Eigen::Vector2d high = p[0].cwiseMax(p[1]).cwiseMax(p[2]);
      for (int v = std::max(0, static_cast<int>(std::ceil(low.y())));
           v <= std::min(height - 1, static_cast<int>(high.y()));
           ++v) {
        for (int u = std::max(0, static_cast<int>(std::ceil(low.x())));
             u <= std::min(width - 1, static_cast<int>(high.x()));
             ++u) {
          const auto side = [&](int i, int j) {
            return ((p[j] - p[i]).x() * (v - p[i].y()) - (p[j] - p[i]).y() * (u - p[i].x())) / area;
          };
          const double a = side(1, 2), b = side(2, 0), c = side(0, 1);
          if (a < 0 || b < 0 || c < 0) continue;
          const double z = 1.0 / (a / x[0].z() + b / x[1].z() + c / x[2].z());
          double& known = nearest[static_cast<std::size_t>(v) * width + u];
          if (z >= known) continue;
          known = z;
          fine.at<cv::Vec3b>(v, u) = cv::Vec3b::all(static_cast<unsigned char>(shade));
        }
      }
    }
  }
  cv::Mat image;
  cv::resize(fine, image, cv::Size(camera.width, camera.height), 0, 0, cv::INTER_AREA);
  cv::GaussianBlur(image, image, cv::Size(), 0.7);
  cv::Mat noise(image.size(), CV_8UC3);
  cv::RNG random(seed);
  random.fill(noise, cv::RNG::UNIFORM, 0, 4);
  return image + noise;
}

}  // namespace horopter
