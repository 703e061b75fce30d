#include "tests/support/boxes_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "tests/support/random.h"
#include "tests/support/textured_plane.h"

namespace horopter {

cv::Mat RenderBoxes(
    const SyntheticScene& scene, int v, unsigned seed, int boxes, const cv::Mat& texture) {
  cv::Mat image(
      scene.cameras[v].height, scene.cameras[v].width, CV_8UC3, cv::Scalar(105, 105, 105));
  if (!texture.empty())
    cv::cvtColor(RenderPlane(scene, v, texture, 0.0), image, cv::COLOR_GRAY2BGR);
  Random rng(seed);
  struct Face {
    double distance;
    std::vector<cv::Point> corners;
    cv::Scalar colour;
  };
  std::vector<Face> faces;
  for (int k = 0; k < boxes; ++k) {
    const auto uniform = [&](double a, double b) { return rng.Uniform(a, b); };
    const double cx = 0.13 * (k % 3 - 1) + uniform(-0.02, 0.02);
    const double cy = 0.13 * (k / 3 - 1) + uniform(-0.02, 0.02);
    const double hx = uniform(0.02, 0.05), hy = uniform(0.02, 0.05), hz = uniform(0.03, 0.1);
    const double turn = uniform(0.0, 1.5);
    const auto corner = [&](int i) {
      const double x = (i & 1 ? hx : -hx), y = (i & 2 ? hy : -hy);
      return Eigen::Vector3d(cx + std::cos(turn) * x - std::sin(turn) * y,
                             cy + std::sin(turn) * x + std::cos(turn) * y,
                             i & 4 ? hz : 0.0);
    };
    const int sides[5][4] = {{4, 5, 7, 6}, {0, 1, 5, 4}, {1, 3, 7, 5}, {3, 2, 6, 7}, {2, 0, 4, 6}};
    for (const auto& side : sides) {
      const cv::Scalar colour(uniform(20, 240), uniform(20, 240), uniform(20, 240));
      Face face{0.0, {}, colour};
      Eigen::Vector3d in_camera[4];
      for (int i = 0; i < 4; ++i) {
        in_camera[i] = scene.camera_from_world[v] * corner(side[i]);
        const Eigen::Vector2d p = Project(scene.cameras[v], in_camera[i]);
        face.corners.emplace_back(cvRound(16 * p.x()), cvRound(16 * p.y()));
        face.distance += in_camera[i].norm() / 4;
      }
      // Faces seen from behind are hidden.
      const Eigen::Vector3d normal =
          (in_camera[1] - in_camera[0]).cross(in_camera[3] - in_camera[0]);
      if (normal.dot(in_camera[0]) < 0.0) faces.push_back(face);
    }
  }
  std::sort(faces.begin(), faces.end(), [](const Face& a, const Face& b) {
    return a.distance > b.distance;
  });
  for (const Face& face : faces)
    cv::fillConvexPoly(image, face.corners, face.colour, cv::LINE_AA, 4);
  cv::GaussianBlur(image, image, cv::Size(), 0.7);
  cv::Mat noise(image.size(), CV_16SC3);
  cv::theRNG().state = seed + 7 * v;
  cv::randn(noise, 0, 2);
  cv::add(image, noise, image, cv::noArray(), CV_8UC3);
  return image;
}

}  // namespace horopter
