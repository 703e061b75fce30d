#include "client/preview.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <span>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/resting_poses.h"
#include "server/overlay/paint.h"
#include "server/overlay/scene_overlay.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

const cv::Scalar kPaper(245, 245, 245), kRed(40, 40, 220), kGreen(40, 160, 40), kBlue(220, 90, 30),
    kSymmetry(200, 40, 200), kTable(170, 170, 170);
constexpr DrawingColor kEdges{40, 120, 255}, kGripper{230, 110, 0};

struct View {
  PinholeCamera camera;
  Rigid3 camera_from_object;
  cv::Mat image;

  cv::Point At(const Eigen::Vector3d& point_in_object) const {
    const Eigen::Vector2d p = Project(camera, camera_from_object * point_in_object);
    return {static_cast<int>(std::lround(p.x())), static_cast<int>(std::lround(p.y()))};
  }
  void Line(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const cv::Scalar& color) {
    cv::line(image, At(a), At(b), color, 1, cv::LINE_AA);
  }
};

// Looks at `centre` from the direction `from` (unit, object frame), `up` upwards in the image; the
// part fills most of the tile.
View LookAt(const ObjectModel& model,
            const Eigen::Vector3d& centre,
            const Eigen::Vector3d& from,
            const Eigen::Vector3d& up,
            int side) {
  View view;
  const double size = std::max(model.diameter_m, 1e-6), distance = 3.0 * size;
  view.camera = CenteredCamera(side, side, 2.3 * side);
  const Eigen::Vector3d z = -from, x = z.cross(up).normalized(), y = z.cross(x);
  view.camera_from_object.R.row(0) = x;
  view.camera_from_object.R.row(1) = y;
  view.camera_from_object.R.row(2) = z;
  view.camera_from_object.t = Eigen::Vector3d(0, 0, distance) - view.camera_from_object.R * centre;
  view.image = cv::Mat(side, side, CV_8UC3, kPaper);
  return view;
}

// A face seen from inside is a hole in the mesh or turned: shaded in red alone.
cv::Vec3b ColorOf(double cosine) {
  const auto light = static_cast<uchar>(110.0 + 110.0 * std::abs(cosine));
  return cosine >= 0.0 ? cv::Vec3b(light, light, light) : cv::Vec3b(180, 160, light);
}

// Draws what of a triangle is nearer than `nearest` (1/z of each pixel, 0: nothing).
void FillTriangle(const PinholeCamera& camera,
                  const std::array<Eigen::Vector3d, 3>& corners,
                  cv::Mat_<float>* nearest,
                  cv::Mat* image) {
  Eigen::Vector2d p[3];
  for (size_t k = 0; k < 3; ++k) {
    if (!(corners[k].z() > 0.0)) return;
    p[k] = Project(camera, corners[k]);
  }
  const auto cross = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return a.x() * b.y() - a.y() * b.x();
  };
  const double area = cross(p[1] - p[0], p[2] - p[0]);
  if (!(std::abs(area) > 1e-9)) return;
  const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
  const cv::Vec3b color = ColorOf(-normal.dot(corners[0]) / (normal.norm() * corners[0].norm()));
  const Eigen::Vector2d low = p[0].cwiseMin(p[1]).cwiseMin(p[2]);
  const Eigen::Vector2d high = p[0].cwiseMax(p[1]).cwiseMax(p[2]);
  const int x1 = static_cast<int>(std::min(high.x(), image->cols - 1.0));
  const int y1 = static_cast<int>(std::min(high.y(), image->rows - 1.0));
  for (int y = std::max(0, static_cast<int>(std::ceil(low.y()))); y <= y1; ++y) {
    for (int x = std::max(0, static_cast<int>(std::ceil(low.x()))); x <= x1; ++x) {
      const Eigen::Vector2d at(x, y);
      const double u = cross(at - p[0], p[2] - p[0]) / area;
      const double v = cross(p[1] - p[0], at - p[0]) / area;
      if (u < 0.0 || v < 0.0 || u + v > 1.0) continue;
      // 1/z is linear in the image.
      const auto near = static_cast<float>((1.0 - u - v) / corners[0].z() + u / corners[1].z() +
                                           v / corners[2].z());
      if (near <= (*nearest)(y, x)) continue;
      (*nearest)(y, x) = near;
      image->at<cv::Vec3b>(y, x) = color;
    }
  }
}

void Shade(const TriangleMesh& mesh, View& view) {
  cv::Mat_<float> nearest(view.image.rows, view.image.cols, 0.0f);
  const auto n = static_cast<int>(mesh.vertices.size());
  for (const Eigen::Vector3i& t : mesh.triangles) {
    if (t.minCoeff() < 0 || t.maxCoeff() >= n) continue;
    std::array<Eigen::Vector3d, 3> corners;
    for (size_t k = 0; k < 3; ++k) {
      corners[k] =
          view.camera_from_object * mesh.vertices[static_cast<size_t>(t[static_cast<int>(k)])];
    }
    FillTriangle(view.camera, corners, &nearest, &view.image);
  }
}

void DrawFrame(const ObjectModel& model, View& view) {
  const double length = 0.15 * model.diameter_m;
  const Eigen::Vector3d o = Eigen::Vector3d::Zero();
  view.Line(o, length * Eigen::Vector3d::UnitX(), kRed);
  view.Line(o, length * Eigen::Vector3d::UnitY(), kGreen);
  view.Line(o, length * Eigen::Vector3d::UnitZ(), kBlue);
}

void DrawSymmetries(const ObjectModel& model, const Eigen::Vector3d& centre, View& view) {
  for (const DrawnAxis& axis : SymmetryAxes(model.symmetries)) {
    const Eigen::Vector3d middle =
        axis.point + axis.direction * axis.direction.dot(centre - axis.point);
    const Eigen::Vector3d end = middle + 0.55 * model.diameter_m * axis.direction;
    view.Line(middle - 0.55 * model.diameter_m * axis.direction, end, kSymmetry);
    cv::putText(view.image,
                absl::StrFormat("x%d", axis.order),
                view.At(end),
                cv::FONT_HERSHEY_SIMPLEX,
                0.45,
                kSymmetry,
                1,
                cv::LINE_AA);
  }
}

void DrawPart(const ObjectModel& model, View& view) {
  Shade(model.mesh, view);
  const OverlayObject object{&model, view.camera_from_object, "", kEdges};
  Drawing drawing{view.image.cols, view.image.rows, {}, {}};
  DrawWireframes(view.camera, std::span(&object, 1), &drawing);
  Paint(drawing, &view.image);
}

View TurntableView(const ObjectModel& model,
                   const Eigen::Vector3d& centre,
                   double azimuth,
                   double elevation,
                   const PreviewOptions& options) {
  const Eigen::Vector3d from(std::cos(elevation) * std::cos(azimuth),
                             std::cos(elevation) * std::sin(azimuth),
                             std::sin(elevation));
  View view = LookAt(model, centre, from, Eigen::Vector3d::UnitZ(), options.tile_px);
  DrawPart(model, view);
  DrawSymmetries(model, centre, view);
  const size_t grasps =
      std::min(model.grasps.size(), static_cast<size_t>(std::max(0, options.max_grasps)));
  Drawing drawing{options.tile_px, options.tile_px, {}, {}};
  for (size_t i = 0; i < grasps; ++i) {
    const Grasp& grasp = model.grasps[i];
    const Rigid3 camera_from_gripper = view.camera_from_object * grasp.object_from_gripper;
    const double length = 0.25 * model.diameter_m;
    if (IsSuction(grasp)) {
      DrawSuctionCup(
          view.camera, camera_from_gripper, CupRadius(grasp), length, kGripper, &drawing);
    } else {
      DrawGripper(
          view.camera, camera_from_gripper, grasp.jaw_opening_m, length, kGripper, &drawing);
    }
  }
  Paint(drawing, &view.image);
  DrawFrame(model, view);
  return view;
}

View RestingView(const ObjectModel& model,
                 const Eigen::Vector3d& centre,
                 const RestingPose& pose,
                 const PreviewOptions& options) {
  const Eigen::Vector3d up = -pose.down_in_object, side = up.unitOrthogonal();
  const double elevation = 0.5;
  View view = LookAt(
      model, centre, std::cos(elevation) * side + std::sin(elevation) * up, up, options.tile_px);
  const Eigen::Vector3d foot = centre + pose.height_m * pose.down_in_object,
                        across = up.cross(side);
  const double reach = 0.6 * model.diameter_m;
  constexpr int kLines = 6;
  for (int k = -kLines; k <= kLines; ++k) {
    const double at = reach * k / kLines;
    view.Line(foot + at * side - reach * across, foot + at * side + reach * across, kTable);
    view.Line(foot - reach * side + at * across, foot + reach * side + at * across, kTable);
  }
  DrawPart(model, view);
  Drawing caption{options.tile_px, options.tile_px, {}, {}};
  DrawCaption(absl::StrFormat("rests: %.0f %%", 100.0 * pose.share), &caption);
  Paint(caption, &view.image);
  return view;
}

}  // namespace

cv::Mat RenderPreview(const ObjectModel& model, const PreviewOptions& options) {
  Eigen::Vector3d low = Eigen::Vector3d::Zero(), high = low;
  if (!model.mesh.vertices.empty()) low = high = model.mesh.vertices[0];
  for (const Eigen::Vector3d& v : model.mesh.vertices)
    low = low.cwiseMin(v), high = high.cwiseMax(v);
  const Eigen::Vector3d middle = 0.5 * (low + high);
  std::vector<cv::Mat> tiles;
  for (const double elevation : {0.45, -0.45}) {
    for (int k = 0; k < options.columns; ++k) {
      const double azimuth = 0.5 + 2.0 * M_PI * k / options.columns;
      tiles.push_back(TurntableView(model, middle, azimuth, elevation, options).image);
    }
  }
  const std::vector<RestingPose> poses = RestingPoses(model.mesh);
  const Eigen::Vector3d centre = CentreOfMass(model.mesh).value_or(middle);
  for (int k = 0; k < options.columns; ++k) {
    if (static_cast<size_t>(k) < poses.size()) {
      tiles.push_back(RestingView(model, centre, poses[static_cast<size_t>(k)], options).image);
    } else {
      tiles.emplace_back(options.tile_px, options.tile_px, CV_8UC3, kPaper);
    }
  }
  const int rows = static_cast<int>(tiles.size()) / options.columns;
  cv::Mat sheet(rows * options.tile_px + 28,
                options.columns * options.tile_px,
                CV_8UC3,
                cv::Scalar(40, 40, 40));
  for (int i = 0; i < static_cast<int>(tiles.size()); ++i) {
    tiles[static_cast<size_t>(i)].copyTo(sheet({i % options.columns * options.tile_px,
                                                i / options.columns * options.tile_px + 28,
                                                options.tile_px,
                                                options.tile_px}));
  }
  const std::string title = absl::StrFormat(
      "%s %s: diameter %.1f mm, %d corners, %d edges, %d triangles, %d symmetries, %d grasps, "
      "rests "
      "in %d ways",
      model.id,
      model.display_name,
      model.diameter_m * 1e3,
      model.vertices.size(),
      model.edges.size(),
      model.mesh.triangles.size(),
      model.symmetries.size(),
      model.grasps.size(),
      poses.size());
  cv::putText(
      sheet, title, {8, 19}, cv::FONT_HERSHEY_SIMPLEX, 0.5, {255, 255, 255}, 1, cv::LINE_AA);
  return sheet;
}

}  // namespace horopter
