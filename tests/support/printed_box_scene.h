// A box with printed faces on a table, rendered from four cameras that know where they are.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/synthetic_part.h"

namespace horopter {

inline constexpr double kPrintedSide = 0.09, kPrintedHeight = 0.06;

// Smooth random texture over a plane, 0..1.
class Print {
 public:
  explicit Print(unsigned seed) : cells_(128, 128, CV_32F) {
    cv::RNG rng(seed);
    rng.fill(cells_, cv::RNG::UNIFORM, 0.0, 1.0);
    cv::GaussianBlur(cells_, cells_, {}, 1.0);
    cv::normalize(cells_, cells_, 0.0, 1.0, cv::NORM_MINMAX);
  }
  // x, y in metres; a cell is 2 mm.
  double At(double x, double y) const {
    const double u = x / 0.002 + 1000.0, v = y / 0.002 + 1000.0;
    const int i = static_cast<int>(u), k = static_cast<int>(v);
    const double fx = u - i, fy = v - k;
    const auto cell = [&](int a, int b) { return cells_.at<float>(b % 128, a % 128); };
    return (1 - fy) * ((1 - fx) * cell(i, k) + fx * cell(i + 1, k)) +
           fy * ((1 - fx) * cell(i, k + 1) + fx * cell(i + 1, k + 1));
  }

 private:
  cv::Mat cells_;
};

struct Looks {
  bool printed_box = true;
  bool printed_table = false;
  bool box_is_there = true;
  double noise = 2.0;  // grey levels
  unsigned seed = 1;
};

// A box that stands on the table z = 0 of the scene, seen by four cameras that know where they are.
struct PrintedBoxScene {
  std::vector<std::shared_ptr<const PreparedObject>> objects{
      PrepareObject(Prism("box",
                          {{0, 0},
                           {kPrintedSide, 0},
                           {kPrintedSide, 0.8 * kPrintedSide},
                           {0, 0.8 * kPrintedSide}},
                          kPrintedHeight))
          .value()};
  std::vector<cv::Mat> images;
  std::vector<CalibratedCamera> views;  // the box stands in the origin of their scene

  explicit PrintedBoxScene(const Looks& looks) {
    for (int v = 0; v < 4; ++v) {
      const double a = 0.35 + 0.2 * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 900 + 20 * v);
      const Rigid3 camera_from_scene =
          LookAt({0.5 * std::sin(a), -0.5 * std::cos(a), 0.4}, {0.04, 0.03, 0.03});
      views.push_back({camera, camera_from_scene});
      images.push_back(Render(looks, camera, camera_from_scene, looks.seed + v));
    }
  }

  // Box faces and table by the nearest hit of each pixel's ray.
  static cv::Mat Render(const Looks& looks,
                        const PinholeCamera& camera,
                        const Rigid3& camera_from_scene,
                        unsigned seed) {
    const Print print(looks.seed), table(looks.seed + 100);
    const Rigid3 scene_from_camera = camera_from_scene.Inverse();
    const Eigen::Vector3d c = scene_from_camera.t,
                          high(kPrintedSide, 0.8 * kPrintedSide, kPrintedHeight);
    cv::Mat image(camera.height, camera.width, CV_32F);
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d ray =
            scene_from_camera.R * NormalizedPoint(camera, {x, y}).homogeneous();
        double near = -c.z() / ray.z();
        const Eigen::Vector3d foot = c + near * ray;
        double value = looks.printed_table ? 60 + 120 * table.At(foot.x(), foot.y()) : 120;
        for (int axis = 0; axis < 3 && looks.box_is_there; ++axis) {
          for (const double side : {0.0, high[axis]}) {
            const double t = (side - c[axis]) / ray[axis];
            const Eigen::Vector3d p = c + t * ray;
            const int i = (axis + 1) % 3, k = (axis + 2) % 3;
            if (!(t > 0) || t >= near || p[i] < 0 || p[k] < 0 || p[i] > high[i] || p[k] > high[k])
              continue;
            near = t;
            value = 80 + 20 * axis + (looks.printed_box ? 100 * print.At(p[i], p[k] + axis) : 0);
          }
        }
        image.at<float>(y, x) = static_cast<float>(value);
      }
    }
    cv::Mat noise(image.size(), CV_32F), grey;
    cv::RNG rng(seed);
    rng.fill(noise, cv::RNG::NORMAL, 0.0, looks.noise);
    cv::Mat(image + noise).convertTo(grey, CV_8U);
    return grey;
  }
};

}  // namespace horopter
