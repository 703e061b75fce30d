// Visible edges of a data set's parts: what they cost, and how they lie on the true images.
//
//   visible_edges_report DATASET                       one line a part: triangles, times, bytes
//   visible_edges_report DATASET SPLIT                 how far image edges are from visible ones at
//                                                      the true poses, of parts seen whole
//   visible_edges_report DATASET SPLIT SCENE IMAGE OUT.png [RENDER_PX [ZOOM [PART]]]
//                                                      edges at the true poses, drawn on the image
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/vision/recognition/aspects/aspect_blob.h"

namespace horopter {
namespace {

double Seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

absl::StatusOr<ObjectModel> Load(const BopObject& object) {
  CadImportOptions options;
  options.unit = "mm";
  absl::StatusOr<CadImport> import = ImportCad(object.mesh_path, options);
  if (!import.ok()) return import.status();
  import->model.symmetries = object.symmetries;
  if (object.diameter_m > 0.0) import->model.diameter_m = object.diameter_m;
  return std::move(import->model);
}

// Milliseconds a call over views all around, and edge points a view.
struct EdgeCost {
  double ms = 0.0;
  double points = 0.0;
};

EdgeCost MeasureEdges(const ObjectAspects& object, double render_px) {
  const PinholeCamera camera = CenteredCamera(640, 480, 700.0);
  const int count = static_cast<int>(object.aspects.aspects.size());
  const int step = std::max(1, count / 40);
  EdgeCost cost;
  int calls = 0;
  const double start = Seconds();
  for (int i = 0; i < count; i += step, ++calls) {
    Rigid3 pose = AspectPose(object.aspects, i);
    pose.t *= 700.0 / 250.0 / 4.0;  // 250 image pixels a diameter
    pose.t = pose.R * -object.aspects.center.cast<double>() +
             Eigen::Vector3d(0, 0, object.aspects.diameter_m * 700.0 / 250.0);
    VisibleEdgeOptions options;
    options.render_px = render_px;
    cost.points +=
        static_cast<double>(FindVisibleEdges(object.mesh, camera, pose, options).points.size());
  }
  cost.ms = 1e3 * (Seconds() - start) / calls;
  cost.points /= calls;
  return cost;
}

// How far contours of the decimated mesh at 200 px a diameter are from those of the given mesh at
// 1000 px, in pixels of the former: the largest but one in ten, over ten views.
double ContourError(const ObjectAspects& object, const RenderMesh& given) {
  const PinholeCamera camera = CenteredCamera(640, 480, 700.0);
  std::vector<double> errors;
  const int count = static_cast<int>(object.aspects.aspects.size());
  for (int i = 0; i < count; i += std::max(1, count / 10)) {
    Rigid3 pose;
    pose.R = AspectPose(object.aspects, i).R;
    pose.t = pose.R * -object.aspects.center.cast<double>() +
             Eigen::Vector3d(0, 0, object.aspects.diameter_m * 700.0 / 200.0);
    VisibleEdgeOptions options;
    options.creases = false;
    options.render_px = 200;
    const VisibleEdges coarse = FindVisibleEdges(object.mesh, camera, pose, options);
    options.render_px = 1000;
    options.max_scale = 5.0;
    options.occlusion_jump_px *= 0.5 * options.max_scale;
    const VisibleEdges fine = FindVisibleEdges(given, camera, pose, options);
    for (const VisibleEdgePoint& p : coarse.points) {
      float nearest = 1e9f;
      for (const VisibleEdgePoint& q : fine.points) {
        nearest = std::min(nearest, (p.image - q.image).squaredNorm());
      }
      errors.push_back(std::sqrt(nearest));
    }
  }
  std::sort(errors.begin(), errors.end());
  return errors.empty() ? 0.0 : errors[errors.size() * 9 / 10];
}

int ReportCosts(const BopDataset& data) {
  std::printf("%-4s %-20s %8s %7s %6s %7s %7s %7s %8s %6s %8s %6s %8s %6s\n",
              "id",
              "name",
              "given",
              "drawn",
              "closed",
              "mesh_s",
              "all_s",
              "aspects",
              "bytes",
              "ms110",
              "points",
              "ms200",
              "points",
              "err90");
  for (const BopObject& object : data.objects) {
    const absl::StatusOr<ObjectModel> model = Load(object);
    if (!model.ok()) {
      std::printf("%s: %s\n", object.name.c_str(), std::string(model.status().message()).c_str());
      continue;
    }
    const double start = Seconds();
    const auto mesh = MakeRenderMesh(model->mesh, model->diameter_m);
    const double mesh_s = Seconds() - start;
    const auto aspects = MakeObjectAspects(*model);
    const double all_s = Seconds() - start - mesh_s;
    if (!mesh.ok() || !aspects.ok()) return 1;
    const std::size_t bytes = EncodeObjectAspects(*aspects, *model).size();
    RenderMeshOptions given;
    given.tolerance = given.coarse_tolerance = 1e-6;
    const auto full = MakeRenderMesh(model->mesh, model->diameter_m, given);
    if (!full.ok()) return 1;
    const EdgeCost small = MeasureEdges(*aspects, 110), large = MeasureEdges(*aspects, 200);
    std::printf("%-4d %-20s %8zu %7zu %6d %7.3f %7.2f %7zu %8zu %6.2f %8.0f %6.2f %8.0f %6.2f\n",
                object.obj_id,
                object.name.c_str(),
                model->mesh.triangles.size(),
                mesh->triangles.size(),
                mesh->closed,
                mesh_s,
                all_s,
                aspects->aspects.aspects.size(),
                bytes,
                small.ms,
                small.points,
                large.ms,
                large.points,
                ContourError(*aspects, *full));
    std::fflush(stdout);
  }
  return 0;
}

cv::Scalar ColorOf(VisibleEdgeKind kind) {
  if (kind == VisibleEdgeKind::kSilhouette) return {0, 0, 255};
  return kind == VisibleEdgeKind::kOcclusion ? cv::Scalar(0, 255, 255) : cv::Scalar(255, 0, 255);
}

// Beside the image as it is: silhouettes red, occlusions yellow, creases magenta.
void Paint(const cv::Mat& pixels,
           const std::vector<VisibleEdgePoint>& points,
           int zoom,
           const std::string& path) {
  cv::Rect box(0, 0, pixels.cols, pixels.rows);
  if (!points.empty()) {
    Eigen::Vector2f low = points[0].image, high = low;
    for (const VisibleEdgePoint& p : points) {
      low = low.cwiseMin(p.image);
      high = high.cwiseMax(p.image);
    }
    const cv::Point a(static_cast<int>(low.x()) - 8, static_cast<int>(low.y()) - 8);
    const cv::Point b(static_cast<int>(high.x()) + 9, static_cast<int>(high.y()) + 9);
    box &= cv::Rect(a, b);
  }
  cv::Mat plain, drawn, out;
  cv::resize(pixels(box), plain, {}, zoom, zoom, cv::INTER_NEAREST);
  drawn = plain.clone();
  for (const VisibleEdgePoint& p : points) {
    const Eigen::Vector2f at = (p.image - Eigen::Vector2f(box.x, box.y)).array() + 0.5f;
    const cv::Rect dot(static_cast<int>(at.x() * zoom), static_cast<int>(at.y() * zoom), 1, 1);
    if ((dot & cv::Rect({}, drawn.size())) == dot) drawn(dot) = ColorOf(p.kind);
  }
  cv::hconcat(plain, drawn, out);
  cv::imwrite(path, out);
}

int Draw(const BopDataset& data, int argc, char** argv) {
  const absl::StatusOr<BopScene> scene = ReadBopScene(data.folder, argv[2], std::atoi(argv[3]));
  if (!scene.ok()) return 1;
  VisibleEdgeOptions options;
  if (argc > 6) options.render_px = std::atof(argv[6]);
  const int zoom = argc > 7 ? std::atoi(argv[7]) : 3;
  const int only = argc > 8 ? std::atoi(argv[8]) : 0;
  for (const BopImage& image : scene->images) {
    if (image.im_id != std::atoi(argv[4])) continue;
    std::vector<VisibleEdgePoint> points;
    for (const BopInstance& instance : image.instances) {
      if (only > 0 && instance.obj_id != only) continue;
      const absl::StatusOr<ObjectModel> model = Load(*data.Find(instance.obj_id));
      if (!model.ok()) return 1;
      const auto mesh = MakeRenderMesh(model->mesh, model->diameter_m);
      if (!mesh.ok()) return 1;
      const VisibleEdges edges =
          FindVisibleEdges(*mesh, image.camera, instance.camera_from_object, options);
      points.insert(points.end(), edges.points.begin(), edges.points.end());
      std::printf("part %d: %zu triangles, scale %.2f, %zu points, %d chains\n",
                  instance.obj_id,
                  mesh->triangles.size(),
                  edges.view.scale,
                  edges.points.size(),
                  edges.chains);
    }
    Paint(cv::imread(image.path), points, zoom, argv[5]);
    return 0;
  }
  return 1;
}

// How far along the edge's normal the image's gradient is largest, px; nothing if it is weak.
std::optional<double> EdgeOffset(const cv::Mat& gray, const VisibleEdgePoint& p) {
  constexpr int kReach = 8;  // half pixels
  const Eigen::Vector2f normal(-p.tangent.y(), p.tangent.x());
  std::array<double, 2 * kReach + 3> value;
  for (int i = 0; i < static_cast<int>(value.size()); ++i) {
    const Eigen::Vector2f at = p.image + 0.5f * static_cast<float>(i - kReach - 1) * normal;
    const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y()));
    if (x < 0 || y < 0 || x + 1 >= gray.cols || y + 1 >= gray.rows) return std::nullopt;
    const float a = at.x() - static_cast<float>(x), b = at.y() - static_cast<float>(y);
    value[i] = (1 - b) * ((1 - a) * gray.at<float>(y, x) + a * gray.at<float>(y, x + 1)) +
               b * ((1 - a) * gray.at<float>(y + 1, x) + a * gray.at<float>(y + 1, x + 1));
  }
  const auto slope = [&](int i) { return std::abs(value[i + 2] - value[i]); };
  int best = 1;
  for (int i = 1; i + 1 <= 2 * kReach - 1; ++i) {
    if (slope(i) > slope(best)) best = i;
  }
  if (slope(best) < 12.0 || best == 1 || best == 2 * kReach - 1) return std::nullopt;
  const double bend = slope(best - 1) - 2.0 * slope(best) + slope(best + 1);
  const double peak = bend < 0.0 ? 0.5 * (slope(best - 1) - slope(best + 1)) / bend : 0.0;
  return 0.5 * (best + peak - kReach);
}

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

int ReportAccuracy(const BopDataset& data, const std::string& split) {
  const auto scenes = ListBopScenes(data.folder, split);
  if (!scenes.ok()) return 1;
  std::map<int, RenderMesh> meshes;
  std::map<std::pair<int, int>, std::vector<double>> offsets;  // part (0: all), kind
  Eigen::Matrix2d nn = Eigen::Matrix2d::Zero();
  Eigen::Vector2d nd = Eigen::Vector2d::Zero();
  for (const int id : *scenes) {
    const absl::StatusOr<BopScene> scene = ReadBopScene(data.folder, split, id);
    if (!scene.ok()) return 1;
    for (const BopImage& image : scene->images) {
      cv::Mat gray;
      cv::imread(image.path, cv::IMREAD_GRAYSCALE).convertTo(gray, CV_32F);
      cv::GaussianBlur(gray, gray, {}, 0.7);
      for (const BopInstance& instance : image.instances) {
        if (instance.visib_fract < 0.97) continue;
        const int part = instance.obj_id;
        if (meshes.count(part) == 0) {
          const absl::StatusOr<ObjectModel> model = Load(*data.Find(part));
          if (!model.ok()) return 1;
          const auto mesh = MakeRenderMesh(model->mesh, model->diameter_m);
          if (!mesh.ok()) return 1;
          meshes[part] = *mesh;
        }
        VisibleEdgeOptions options;
        options.render_px = 200;
        const VisibleEdges edges =
            FindVisibleEdges(meshes[part], image.camera, instance.camera_from_object, options);
        for (const VisibleEdgePoint& p : edges.points) {
          const std::optional<double> offset = EdgeOffset(gray, p);
          if (!offset) continue;
          for (const int key : {0, part}) {
            offsets[{key, static_cast<int>(p.kind)}].push_back(*offset);
          }
          if (p.kind != VisibleEdgeKind::kSilhouette || std::abs(*offset) > 1.5) continue;
          const Eigen::Vector2d n(-p.tangent.y(), p.tangent.x());
          nn += n * n.transpose();
          nd += n * *offset;
        }
      }
    }
  }
  const Eigen::Vector2d shift = nn.inverse() * nd;
  std::printf("images against edges: shift %.3f %.3f px\n", shift.x(), shift.y());
  std::printf("part kind  points  inward  |offset| px: median, 75 %%, 90 %%; within 1 px\n");
  for (auto& [key, values] : offsets) {
    const double median = Quantile(values, 0.5);
    double within = 0;
    for (double& v : values) within += std::abs(v) <= 1.0, v = std::abs(v);
    std::printf("%4d %4d %7zu %7.2f %7.2f %5.2f %5.2f %5.2f\n",
                key.first,
                key.second,
                values.size(),
                median,
                Quantile(values, 0.5),
                Quantile(values, 0.75),
                Quantile(values, 0.9),
                within / static_cast<double>(values.size()));
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  if (argc < 2 || (argc > 3 && argc < 6)) return 2;
  const absl::StatusOr<horopter::BopDataset> data = horopter::ReadBopDataset(argv[1]);
  if (!data.ok()) {
    std::printf("%s\n", std::string(data.status().message()).c_str());
    return 1;
  }
  if (argc == 3) return horopter::ReportAccuracy(*data, argv[2]);
  return argc == 2 ? horopter::ReportCosts(*data) : horopter::Draw(*data, argc, argv);
}
