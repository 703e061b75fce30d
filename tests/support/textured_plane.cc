#include "tests/support/textured_plane.h"

#include <Eigen/Dense>
#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "server/vision/matching/homography.h"

namespace horopter {

cv::Mat PlaneTexture(int seed, double contrast) {
  cv::Mat sum = cv::Mat::zeros(900, 900, CV_32F);
  cv::RNG rng(static_cast<uint64>(seed));
  for (double sigma : {2.0, 4.0, 9.0}) {
    cv::Mat noise(sum.size(), CV_32F);
    rng.fill(noise, cv::RNG::UNIFORM, -1.0, 1.0);
    cv::GaussianBlur(noise, noise, cv::Size(), sigma);
    cv::normalize(noise, noise, 0, 1, cv::NORM_MINMAX);
    sum += noise;
  }
  cv::Mat mean, deviation, texture;
  cv::meanStdDev(sum, mean, deviation);
  sum.convertTo(texture,
                CV_8U,
                contrast / deviation.at<double>(0),
                128.0 - contrast / deviation.at<double>(0) * mean.at<double>(0));
  return texture;
}

cv::Mat RenderPlane(const SyntheticScene& scene, int v, const cv::Mat& texture, double noise) {
  Eigen::Matrix3d world_from_texture;
  world_from_texture << 0.001, 0, -0.45, 0, 0.001, -0.45, 0, 0, 1;
  Eigen::Matrix3d columns;
  columns << scene.camera_from_world[v].R.col(0), scene.camera_from_world[v].R.col(1),
      scene.camera_from_world[v].t;
  const Eigen::Matrix3d H = scene.cameras[v].K() * columns * world_from_texture;
  cv::Mat map(3, 3, CV_64F), image;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) map.at<double>(r, c) = H(r, c);
  }
  cv::warpPerspective(texture,
                      image,
                      map,
                      {scene.cameras[v].width, scene.cameras[v].height},
                      cv::INTER_LINEAR,
                      cv::BORDER_CONSTANT,
                      cv::Scalar(128));
  cv::Mat grain(image.size(), CV_32F), value;
  cv::RNG rng(static_cast<uint64>(1000 + v));
  rng.fill(grain, cv::RNG::NORMAL, 0.0, noise);
  image.convertTo(value, CV_32F);
  value += grain;
  value.convertTo(image, CV_8U);
  return image;
}

double WorstTransfer(const SyntheticScene& scene, int a, int b, const Eigen::Matrix3d& b_from_a) {
  double worst = 0.0;
  for (double x : {-0.1, 0.0, 0.1}) {
    for (double y : {-0.1, 0.0, 0.1}) {
      const Eigen::Vector3d p(x, y, 0);
      worst =
          std::max(worst,
                   (Transfer(b_from_a, Project(scene.cameras[a], scene.camera_from_world[a] * p)) -
                    Project(scene.cameras[b], scene.camera_from_world[b] * p))
                       .norm());
    }
  }
  return worst;
}

}  // namespace horopter
