#include "tests/support/synthetic_metric_scene.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <map>
#include <random>

#include "server/vision/geometry/pose_perturbation.h"
#include "tests/support/synthetic_part.h"
#include "tests/support/view_sphere.h"

namespace horopter {
namespace {

class Source {
 public:
  explicit Source(unsigned seed) : rng_(seed) {}
  double Uniform(double a, double b) { return std::uniform_real_distribution<double>(a, b)(rng_); }
  double Normal(double sigma) { return sigma * std::normal_distribution<double>()(rng_); }
  Eigen::Vector3d Normal3(double sigma) {
    const double x = Normal(sigma), y = Normal(sigma);
    return {x, y, Normal(sigma)};
  }
  Rigid3 Disturbed(const Rigid3& pose, double turn, double shift) {
    return {RotationFromVector(Normal3(turn)) * pose.R, pose.t + Normal3(shift)};
  }

 private:
  std::mt19937 rng_;
};

bool Inside(const PinholeCamera& c, const Eigen::Vector2d& u) {
  return u.x() >= 0 && u.y() >= 0 && u.x() <= c.width - 1 && u.y() <= c.height - 1;
}

// The visible edges as segments, cut off where they leave the image; curves as their chords.
void AddEdges(const PreparedObject& object,
              const std::vector<Eigen::Vector3d>& displaced,
              const PinholeCamera& camera,
              const Rigid3& camera_from_object,
              double sigma_px,
              Source* source,
              ImageFeatures* features) {
  const Eigen::Vector3d to_camera =
      camera_from_object.R.transpose() * -camera_from_object.t - object.center;
  const std::vector<double> seen = EdgesSeenFrom(object, to_camera);
  for (int e = 0; e < static_cast<int>(object.model.edges.size()); ++e) {
    const auto& line = object.model.edges[e].polyline;
    if (seen[e] < (line.size() > 2 ? 0.4 : 0.9)) continue;
    // One error of the ends across the edge for all chords of a curve.
    const Eigen::Vector2d off(source->Normal(sigma_px), source->Normal(sigma_px));
    for (std::size_t i = 0; i + 1 < line.size(); ++i) {
      constexpr int kPieces = 24;
      Eigen::Vector2d first = Eigen::Vector2d::Zero(), last = first;
      int inside = 0;
      for (int j = 0; j <= kPieces; ++j) {
        const Eigen::Vector3d x = line[i] + (line[i + 1] - line[i]) * (j / double(kPieces));
        const Eigen::Vector3d p = camera_from_object * (x + displaced[e]);
        if (p.z() < 0.01 || !Inside(camera, Project(camera, p))) continue;
        last = Project(camera, p);
        if (inside++ == 0) first = last;
      }
      if (inside < 2) continue;
      Segment s;
      s.start = first + off;
      s.end = last + (line.size() > 2
                          ? off
                          : Eigen::Vector2d(source->Normal(sigma_px), source->Normal(sigma_px)));
      s.contrast = 40;
      if (s.Length() > 1.0) features->segments.push_back(s);
    }
  }
}

// Pixels of view v from (x, y, 1) of the plane z = 0.
Eigen::Matrix3d PlaneToPixels(const MetricSceneTruth& scene, int v) {
  const Rigid3& pose = scene.camera_from_world[v];
  Eigen::Matrix3d H;
  H << pose.R.col(0), pose.R.col(1), pose.t;
  return scene.cameras[v].K() * H;
}

void AddTable(MetricSceneTruth* scene, Source* source) {
  constexpr int kPoints = 40;
  constexpr double kSigmaPx = 0.3;
  for (std::size_t v = 0; v + 1 < scene->cameras.size(); ++v) {
    PlaneHomography pair;
    pair.view_a = static_cast<int>(v);
    pair.view_b = static_cast<int>(v) + 1;
    pair.b_from_a =
        PlaneToPixels(*scene, pair.view_b) * PlaneToPixels(*scene, pair.view_a).inverse();
    for (int i = 0; i < kPoints; ++i) {
      const double x = source->Uniform(-0.15, 0.15), y = source->Uniform(-0.15, 0.15);
      const auto pixel = [&](int view) {
        const Eigen::Vector2d u = Project(
            scene->cameras[view], scene->camera_from_world[view] * Eigen::Vector3d(x, y, 0));
        return Eigen::Vector2d(u.x() + source->Normal(kSigmaPx), u.y() + source->Normal(kSigmaPx));
      };
      pair.inliers_a.push_back(pixel(pair.view_a));
      pair.inliers_b.push_back(pixel(pair.view_b));
    }
    scene->matching.planes.push_back(pair);
  }
}

}  // namespace

RecognitionInput MetricSceneTruth::Input() const {
  RecognitionInput input;
  input.features = features;
  input.matching = &matching;
  input.objects = objects;
  return input;
}

MetricSceneTruth MakeMetricScene(const MetricSceneOptions& options) {
  Source source(options.seed);
  MetricSceneTruth scene;
  scene.objects = options.parts;
  const int n = static_cast<int>(options.parts.size());
  std::vector<std::vector<Eigen::Vector3d>> displaced(n);
  const double start = source.Uniform(0.0, 2.0 * M_PI);
  for (int k = 0; k < n; ++k) {
    const double at = start + 2.0 * M_PI * k / n;
    Rigid3 pose;
    pose.R = RotationFromVector({0, 0, source.Uniform(0.0, 2.0 * M_PI)});
    const double radius = n > 1 ? 0.08 : 0.0;
    pose.t = Eigen::Vector3d(radius * std::cos(at), radius * std::sin(at), 0.0);
    // The middle of the part on the circle.
    pose.t -=
        pose.R * Eigen::Vector3d(options.parts[k]->center.x(), options.parts[k]->center.y(), 0);
    scene.world_from_object.push_back(pose);
    for (std::size_t e = 0; e < options.parts[k]->model.edges.size(); ++e) {
      displaced[k].push_back(source.Normal3(options.cad_sigma_m));
    }
  }
  for (int v = 0; v < options.views; ++v) {
    const double share = options.views > 1 ? v / (options.views - 1.0) - 0.5 : 0.0;
    const double azimuth = options.arc_rad * share, up = source.Uniform(0.6, 0.9);
    const double d = options.distance_m * source.Uniform(0.9, 1.1);
    const Eigen::Vector3d eye(d * std::cos(up) * std::sin(azimuth),
                              -d * std::cos(up) * std::cos(azimuth),
                              d * std::sin(up));
    PinholeCamera camera = CenteredCamera(
        640, 480, 640.0 * source.Uniform(options.min_focal_widths, options.max_focal_widths));
    camera.cx += source.Normal(options.center_sigma * 640.0);
    camera.cy += source.Normal(options.center_sigma * 640.0);
    if (options.one_camera && v > 0) camera = scene.cameras[0];
    Rigid3 pose = LookAt(eye, {source.Uniform(-0.01, 0.01), source.Uniform(-0.01, 0.01), 0.02});
    if (!options.rig_cameras.empty()) {
      camera = options.rig_cameras[v];
      pose = options.rig_from_world[v];
    }
    scene.cameras.push_back(camera);
    scene.camera_from_world.push_back(pose);
    ImageFeatures f;
    f.width = 640;
    f.height = 480;
    for (int k = 0; k < n; ++k) {
      AddEdges(*options.parts[k],
               displaced[k],
               camera,
               scene.camera_from_world[v] * scene.world_from_object[k],
               options.end_sigma_px,
               &source,
               &f);
    }
    scene.features.push_back(std::move(f));
  }
  if (options.table) AddTable(&scene, &source);
  scene.recognition.state = RecognitionState::kRecognized;
  for (int v = 0; v < options.views; ++v) {
    CalibratedCamera view{scene.cameras[v], scene.camera_from_world[v]};
    view.camera.cx = 0.5 * 639.0;
    view.camera.cy = 0.5 * 479.0;
    if (!options.rig_cameras.empty()) {
      // Recognition fits what it sees: a turn stands for the offset of the principal point.
      const Eigen::Vector2d off(scene.cameras[v].cx - view.camera.cx,
                                scene.cameras[v].cy - view.camera.cy);
      const Rigid3 turn{RotationFromVector(
                            {-off.y() / view.camera.focal_px, off.x() / view.camera.focal_px, 0.0}),
                        Eigen::Vector3d::Zero()};
      view.camera_from_scene = turn * view.camera_from_scene;
    }
    scene.recognition.views.push_back(view);
  }
  for (int k = 0; k < n; ++k) {
    SceneObject o;
    o.object = k;
    o.score = 0.9 - 0.01 * k;
    o.scene_from_object =
        source.Disturbed(scene.world_from_object[k], options.start_turn_rad, options.start_shift_m);
    scene.recognition.objects.push_back(o);
  }
  return scene;
}

ObjectModel Cylinder(double radius_m, double height_m) {
  constexpr int kSides = 48;
  std::vector<Eigen::Vector2d> polygon;
  for (int i = 0; i < kSides; ++i) {
    const double a = 2.0 * M_PI * i / kSides;
    polygon.emplace_back(radius_m * std::cos(a), radius_m * std::sin(a));
  }
  ObjectModel m = Prism("cylinder", polygon, height_m);
  m.edges.clear();
  for (int level = 0; level < 2; ++level) {
    ModelEdge e;
    e.kind = CurveKind::kCircle;
    e.dihedral_rad = 1.5708;
    for (int i = 0; i <= kSides; ++i) e.polyline.push_back(m.vertices[level * kSides + i % kSides]);
    m.edges.push_back(e);
  }
  m.vertices.clear();
  for (int i = 1; i < 36; ++i) {
    m.symmetries.push_back({RotationFromVector({0, 0, 2.0 * M_PI * i / 36}), {0, 0, 0}});
  }
  return m;
}

ObjectModel Scaled(ObjectModel m, double factor) {
  for (auto& v : m.vertices) v *= factor;
  for (auto& v : m.mesh.vertices) v *= factor;
  for (ModelEdge& e : m.edges) {
    for (auto& p : e.polyline) p *= factor;
  }
  for (Rigid3& S : m.symmetries) S.t *= factor;
  m.diameter_m *= factor;
  return m;
}

}  // namespace horopter
