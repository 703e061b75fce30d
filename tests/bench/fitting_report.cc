// Lines by the Hough transform beside the features stage, and ellipses by direct and by geometric
// fit, on shapes of known geometry:
//   fitting_report
// Seeds are fixed, so every run prints the same (but the times).
#include <Eigen/Cholesky>
#include <algorithm>
#include <cstdio>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/vision/features/conic_fit.h"
#include "server/vision/features/features.h"
#include "tests/bench/hough_lines.h"
#include "tests/bench/joined_shapes.h"

namespace horopter {
namespace {

// Along the edge: variance 0.8^2 rendered, 1 / 12 of the pixel, 1 of the edge filter's smoothing, 2
// / 3 of its 3x3 differences.
constexpr double kBlurPx = 1.546;

// Grey image of what `inside` holds of the plane: 8 x 8 samples per boundary pixel, blur 0.8,
// noise. (OpenCV's fillPoly widens a shape by 0.06 px: more than the fits compared here err.)
template <typename Inside>
cv::Mat RenderInside(const Inside& inside, double noise, std::mt19937* rng) {
  cv::Mat image(240, 320, CV_32FC1);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const bool corner = inside(x - 0.5, y - 0.5);
      int covered = corner ? 64 : 0;
      if (inside(x + 0.5, y - 0.5) != corner || inside(x - 0.5, y + 0.5) != corner ||
          inside(x + 0.5, y + 0.5) != corner) {
        covered = 0;
        for (int s = 0; s < 64; ++s) {
          covered += inside(x + (s % 8 - 3.5) / 8.0, y + (s / 8 - 3.5) / 8.0) ? 1 : 0;
        }
      }
      image.at<float>(y, x) = 60.0f + 90.0f * static_cast<float>(covered) / 64.0f;
    }
  }
  cv::GaussianBlur(image, image, cv::Size(), 0.8);
  std::normal_distribution<float> normal(0.0f, static_cast<float>(noise));
  for (auto it = image.begin<float>(); noise > 0.0 && it != image.end<float>(); ++it) {
    *it += normal(*rng);
  }
  cv::Mat out;
  image.convertTo(out, CV_8U);
  return out;
}

// One way to find lines and corners, over all shapes.
struct LineScore {
  int sides = 0, corners = 0, corners_found = 0, spurious = 0;
  std::vector<double> angles, offsets;
  double square = 0.0;
  double seconds = 0.0;
};

double Median(std::vector<double> values) {
  if (values.empty()) return std::nan("");
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

// The longest segment within 2 px and 5 degrees of each side, and the corner nearest to each join.
void JudgeLines(const Shape& shape,
                const std::vector<Segment>& segments,
                const std::vector<Eigen::Vector2d>& corners,
                LineScore* score) {
  const size_t n = shape.joins.size();
  for (size_t k = 0; k < n; ++k) {
    const Eigen::Vector2d a = shape.joins[k], b = shape.joins[(k + 1) % n];
    const Eigen::Vector2d side = (b - a).normalized();
    double longest = 0.0, angle = 0.0, offset = 0.0;
    for (const Segment& s : segments) {
      const Eigen::Vector2d d = (s.end - s.start).normalized(), q = 0.5 * (s.start + s.end) - a;
      const double turn = std::abs(std::asin(std::clamp(Cross(d, side), -1.0, 1.0)));
      if (turn < 0.087 && std::abs(Cross(side, q)) < 2.0 && s.Length() > longest) {
        longest = s.Length();
        angle = turn;
        offset = std::abs(Cross(side, q));
      }
    }
    ++score->sides;
    if (longest > 0.0) {
      score->angles.push_back(angle);
      score->offsets.push_back(offset);
    }
    ++score->corners;
    double nearest = 1e9;
    for (const Eigen::Vector2d& c : corners) nearest = std::min(nearest, (c - a).norm());
    if (nearest < 3.0) {
      ++score->corners_found;
      score->square += nearest * nearest;
    }
  }
  for (const Eigen::Vector2d& c : corners) {
    double nearest = 1e9;
    for (const Eigen::Vector2d& j : shape.joins) nearest = std::min(nearest, (c - j).norm());
    score->spurious += nearest >= 3.0 ? 1 : 0;
  }
}

void ReportHough() {
  std::printf("| shape | noise | ours | Hough |\n|---|---|---|---|\n");
  double seconds[2] = {};
  int images = 0;
  const std::pair<const char*, MakeShape> shapes[] = {{"corners 60-120 deg", Polygon},
                                                      {"corners 20-30 deg", ObtusePolygon}};
  for (const auto& [name, make] : shapes) {
    for (double noise : {0.0, 2.0, 4.0, 8.0}) {
      LineScore scores[2];
      std::mt19937 rng(kSeed);
      for (int k = 0; k < kShapes; ++k) {
        const Shape shape = make(&rng);
        const auto inside = [&](double x, double y) {
          const size_t n = shape.joins.size();
          bool all = true;
          for (size_t i = 0; i < n && all; ++i) {
            const Eigen::Vector2d &a = shape.joins[i], &b = shape.joins[(i + 1) % n];
            all = Cross(b - a, Eigen::Vector2d(x, y) - a) > 0.0;
          }
          return all;
        };
        const cv::Mat grey = RenderInside(inside, noise, &rng);
        ++images;
        std::vector<Eigen::Vector2d> corners[2];
        auto start = std::chrono::steady_clock::now();
        const auto ours = DetectFeatures(grey, {});
        seconds[0] += Since(start);
        for (const Junction& j : ours->junctions) corners[0].push_back(j.point);
        JudgeLines(shape, ours->segments, corners[0], &scores[0]);
        start = std::chrono::steady_clock::now();
        const auto chains = LinkEdges(MakeGradientFields(grey, {})[0], {});
        const auto hough = DetectHoughLines(chains, grey.cols, grey.rows, {});
        seconds[1] += Since(start);
        for (const HoughVertex& v : hough->vertices) corners[1].push_back(v.point);
        JudgeLines(shape, hough->segments, corners[1], &scores[1]);
      }
      std::printf("| %s | %.0f |", name, noise);
      for (const LineScore& s : scores) {
        std::printf(" %.2f, %.2f mrad, %.3f px; %.2f, %.3f px, %d |",
                    1.0 * s.angles.size() / s.sides,
                    1e3 * Median(s.angles),
                    Median(s.offsets),
                    1.0 * s.corners_found / s.corners,
                    std::sqrt(s.square / s.corners_found),
                    s.spurious);
      }
      std::printf("\n");
    }
  }
  std::printf("\nms per image, 320x240: ours %.1f, Hough %.1f\n",
              1e3 * seconds[0] / images,
              1e3 * seconds[1] / images);
}

// Semi-axes and centre of rendered ellipses, and how often the stated ellipsoid holds them.
void ReportEllipses() {
  std::printf("| noise | direct: centre, axes px | geometric: centre, axes px | in 95 %% |\n");
  std::printf("|---|---|---|---|\n");
  for (double noise : {0.0, 2.0, 4.0, 8.0}) {
    std::mt19937 rng(kSeed);
    std::uniform_real_distribution<double> u(0.0, 1.0);
    std::vector<double> centre[2], axes[2];
    int held = 0, total = 0;
    for (int k = 0; k < 4 * kShapes; ++k) {
      EllipseArc truth;
      truth.center = {155 + 10 * u(rng), 115 + 10 * u(rng)};
      truth.semi_major_px = 20 + 60 * u(rng);
      truth.semi_minor_px = truth.semi_major_px * (0.4 + 0.5 * u(rng));
      truth.angle_rad = M_PI * u(rng);
      const double c = std::cos(truth.angle_rad), sn = std::sin(truth.angle_rad);
      const auto inside = [&](double x, double y) {
        const double u0 = x - truth.center.x(), v0 = y - truth.center.y();
        return std::hypot((c * u0 + sn * v0) / truth.semi_major_px,
                          (-sn * u0 + c * v0) / truth.semi_minor_px) < 1.0;
      };
      for (const EdgeChain& chain : Chains(RenderInside(inside, noise, &rng))) {
        if (chain.points.size() < 3.0 * truth.semi_major_px) continue;
        ConicFitOptions options;
        options.correlated_noise = true;
        options.blur_sigma_px = kBlurPx;
        const auto direct = FitEllipse(chain.points);
        const auto fit = FitEllipseGeometric(chain.points, options);
        if (!direct || !fit.ok()) continue;
        const EllipseArc* arcs[2] = {&*direct, &fit->arc};
        for (int m = 0; m < 2; ++m) {
          centre[m].push_back((arcs[m]->center - truth.center).norm());
          axes[m].push_back(std::hypot(arcs[m]->semi_major_px - truth.semi_major_px,
                                       arcs[m]->semi_minor_px - truth.semi_minor_px));
        }
        Eigen::Matrix<double, 5, 1> d;
        d << fit->arc.center - truth.center, fit->arc.semi_major_px - truth.semi_major_px,
            fit->arc.semi_minor_px - truth.semi_minor_px,
            std::remainder(fit->arc.angle_rad - truth.angle_rad, M_PI);
        ++total;
        held += d.dot(fit->covariance.ldlt().solve(d)) < 11.07 ? 1 : 0;
      }
    }
    std::printf("| %.0f | %.3f, %.3f | %.3f, %.3f | %.2f of %d |\n",
                noise,
                Median(centre[0]),
                Median(axes[0]),
                Median(centre[1]),
                Median(axes[1]),
                1.0 * held / total,
                total);
  }
}

}  // namespace
}  // namespace horopter

int main() {
  std::printf("Lines: sides found, median angle and offset error; corners found within 3 px, ");
  std::printf("rms distance, other corners\n\n");
  horopter::ReportHough();
  std::printf("\nEllipses: median errors\n\n");
  horopter::ReportEllipses();
  return 0;
}
