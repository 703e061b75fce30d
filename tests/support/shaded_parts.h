// Photographs of parts: flat shading by a software rendering in front of a plain table.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <opencv2/core.hpp>
#include <span>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/rendered_view.h"

namespace horopter {

struct ShadedPart {
  const ObjectModel* model = nullptr;
  Rigid3 camera_from_object;
};

// BGR; nearer parts hide farther ones. Drawn three times as large and averaged, with noise of the
// seed, three grey levels.
inline cv::Mat PhotographParts(const PinholeCamera& camera,
                               std::span<const ShadedPart> parts,
                               unsigned seed = 1) {
  constexpr int kFine = 3;
  PinholeCamera fine{camera.width * kFine,
                     camera.height * kFine,
                     camera.focal_px * kFine,
                     (camera.cx + 0.5) * kFine - 0.5,
                     (camera.cy + 0.5) * kFine - 0.5,
                     camera.k1};
  cv::Mat_<float> shade(fine.height, fine.width, 175.0f), nearest(fine.height, fine.width, 0.0f);
  const Eigen::Vector3d light = Eigen::Vector3d(0.3, -0.8, -0.5).normalized();
  for (const ShadedPart& part : parts) {
    const RenderMesh mesh = *MakeRenderMesh(part.model->mesh, part.model->diameter_m);
    RenderOptions options;
    options.render_px = 1e4;  // max_scale decides
    const RenderedView view = Render(mesh, fine, part.camera_from_object, options).view;
    for (int y = 0; y < view.height; ++y) {
      for (int x = 0; x < view.width; ++x) {
        if (!view.Covered(x, y)) continue;
        const int u = static_cast<int>(view.origin.x() + x / view.scale + 0.5);
        const int v = static_cast<int>(view.origin.y() + y / view.scale + 0.5);
        if (u < 0 || v < 0 || u >= fine.width || v >= fine.height) continue;
        const std::size_t at = static_cast<std::size_t>(y) * view.width + x;
        if (view.inverse_depth[at] <= nearest(v, u)) continue;
        nearest(v, u) = view.inverse_depth[at];
        const Eigen::Vector3d normal =
            part.camera_from_object.R * mesh.face_normals[view.triangle[at]].cast<double>();
        shade(v, u) = static_cast<float>(25.0 + 60.0 * (1.0 + normal.dot(light)));
      }
    }
  }
  cv::Mat image(camera.height, camera.width, CV_8UC3);
  cv::RNG rng(seed);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const cv::Mat block = shade(cv::Rect(x * kFine, y * kFine, kFine, kFine));
      const double mean = cv::mean(block)[0] + rng.gaussian(3.0);
      image.at<cv::Vec3b>(y, x) = cv::Vec3b::all(cv::saturate_cast<uchar>(mean));
    }
  }
  return image;
}

}  // namespace horopter
