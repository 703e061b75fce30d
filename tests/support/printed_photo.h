// A photograph of a mesh with something printed on it.
#pragma once

#include <Eigen/Geometry>
#include <functional>

#include "server/vision/geometry/depth_buffer.h"
#include "tests/support/shaded_photo.h"

namespace horopter {

// How bright the print makes a place, object frame: 0 .. 1.
using PrintPattern = std::function<double(const Eigen::Vector3d&)>;

// A photograph of a printed mesh.
inline cv::Mat PrintedPhoto(const TriangleMesh& mesh,
                            const PrintPattern& print,
                            const PinholeCamera& camera,
                            const Rigid3& camera_from_object) {
  cv::Mat photo = ShadedPhoto({{&mesh, camera_from_object}}, camera);
  DepthBuffer depth = MakeDepthBuffer(camera.width, camera.height);
  RenderDepth(mesh, camera, camera_from_object, &depth);
  const Rigid3 object_from_camera = camera_from_object.Inverse();
  const int channels = photo.channels();
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const double z = depth.At(x, y);
      if (z >= DepthBuffer::kNoDepth) continue;
      const Eigen::Vector3d at =
          object_from_camera *
          Eigen::Vector3d(z * NormalizedPoint(camera, Eigen::Vector2d(x, y)).homogeneous());
      std::uint8_t* pixel = photo.ptr(y) + static_cast<std::ptrdiff_t>(x) * channels;
      for (int c = 0; c < channels; ++c) pixel[c] = static_cast<std::uint8_t>(pixel[c] * print(at));
    }
  }
  return photo;
}

}  // namespace horopter
