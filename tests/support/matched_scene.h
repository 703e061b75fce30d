// A part in general position before several cameras, with its features matched as they truly are.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/recognition/aspect_scenes/scene_judgement.h"
#include "server/vision/recognition/recognition.h"
#include "tests/support/projection_distance.h"
#include "tests/support/synthetic_part.h"

namespace horopter {

// A prism whose cap is turned, shrunk and tilted: its vertices are in general position, so that it
// has projective keys; `seed` makes different ones. The faces between base and cap are not plane.
inline ObjectModel TwistedPrism(unsigned seed, int corners = 6) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::vector<Eigen::Vector2d> polygon;
  for (int i = 0; i < corners; ++i) {
    const double a = 2.0 * M_PI * (i + 0.5 * unit(rng)) / corners;
    const double r = 0.035 + 0.02 * unit(rng);
    polygon.emplace_back(r * std::cos(a), r * std::sin(a));
  }
  ObjectModel m = Prism("twisted_" + std::to_string(seed), polygon, 0.05);
  for (int i = corners; i < 2 * corners; ++i) {
    Eigen::Vector3d& v = m.vertices[i];
    const double turn = 0.35, shrink = 0.6 + 0.3 * unit(rng);
    const Eigen::Vector2d p = shrink * (Eigen::Rotation2Dd(turn) * v.head<2>());
    v = {p.x(), p.y(), 0.04 + 0.25 * p.x() + 0.02 * unit(rng)};
  }
  m.mesh.vertices = m.vertices;
  for (ModelEdge& e : m.edges) {
    e.polyline = {m.vertices[e.start_vertex], m.vertices[e.end_vertex]};
  }
  m.diameter_m = 0.0;
  for (const auto& a : m.vertices) {
    for (const auto& b : m.vertices) m.diameter_m = std::max(m.diameter_m, (a - b).norm());
  }
  return m;
}

struct MatchedScene {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  Rigid3 world_from_object;  // of objects[0], the only one that is there
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
  std::vector<ImageFeatures> features;
  MatchingResult matching;        // all pairs of views, with their true F
  Reconstruction reconstruction;  // the true cameras in a frame of unknown scale

  RecognitionInput Input() const {
    RecognitionInput input;
    input.features = features;
    input.matching = &matching;
    input.reconstruction = &reconstruction;
    input.objects = objects;
    return input;
  }

  // Largest error of a scene's first object, which is objects[0], over its views, pixels.
  double LargestError(const AspectScene& scene) const {
    double largest = 0.0;
    for (std::size_t v = 0; v < cameras.size(); ++v) {
      if (!scene.views[v]) continue;
      largest = std::max(largest,
                         ProjectionDistance(*objects[0],
                                            scene.views[v]->camera,
                                            scene.views[v]->camera_from_scene *
                                                scene.objects.front().scene_from_object,
                                            cameras[v],
                                            camera_from_world[v] * world_from_object));
    }
    return largest;
  }
};

namespace matched_scene_internal {

// Index of the model vertex or edge that each junction or segment shows, by place.
inline std::vector<int> ShownVertices(const MatchedScene& scene, int v) {
  std::vector<int> out;
  const ObjectModel& model = scene.objects[0]->model;
  const Rigid3 pose = scene.camera_from_world[v] * scene.world_from_object;
  for (const Junction& j : scene.features[v].junctions) {
    int best = -1;
    double nearest = 6.0;
    for (int i = 0; i < static_cast<int>(model.vertices.size()); ++i) {
      const double d = (Project(scene.cameras[v], pose * model.vertices[i]) - j.point).norm();
      if (d < nearest) nearest = d, best = i;
    }
    out.push_back(best);
  }
  return out;
}

inline std::vector<int> ShownEdges(const MatchedScene& scene, int v) {
  std::vector<int> out;
  const ObjectModel& model = scene.objects[0]->model;
  const Rigid3 pose = scene.camera_from_world[v] * scene.world_from_object;
  for (const Segment& s : scene.features[v].segments) {
    int best = -1;
    double nearest = 8.0;
    for (int i = 0; i < static_cast<int>(model.edges.size()); ++i) {
      const auto end = [&](const Eigen::Vector3d& x) {
        return Project(scene.cameras[v], pose * x);
      };
      const double d = (end(model.edges[i].polyline.front()) - s.start).norm() +
                       (end(model.edges[i].polyline.back()) - s.end).norm();
      if (d < nearest) nearest = d, best = i;
    }
    out.push_back(best);
  }
  return out;
}

}  // namespace matched_scene_internal

// objects[0] stands in the middle; the others are only enrolled. Cameras on an arc of about 0.6 m.
inline MatchedScene MakeMatchedScene(std::vector<std::shared_ptr<const PreparedObject>> objects,
                                     int views,
                                     double noise_px,
                                     unsigned seed) {
  MatchedScene scene;
  scene.objects = std::move(objects);
  scene.world_from_object.R =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(0.2, 0.1, 1.0).normalized()).toRotationMatrix();
  std::mt19937 rng(seed);
  const double units = 3.7;
  const Eigen::Matrix3d turned =
      Eigen::AngleAxisd(1.1, Eigen::Vector3d(0.3, 1.0, -0.4).normalized()).toRotationMatrix();
  for (int v = 0; v < views; ++v) {
    const double a = -0.9 + 0.35 * v;
    scene.cameras.push_back(CenteredCamera(640, 480, 900.0 + 25 * v));
    scene.camera_from_world.push_back(
        LookAt({0.45 * std::sin(a), -0.45 * std::cos(a), 0.36 + 0.03 * (v % 2)}, {0, 0, 0.02}));
    ImageFeatures f;
    AddSyntheticFeatures(*scene.objects[0],
                         scene.cameras[v],
                         scene.camera_from_world[v] * scene.world_from_object,
                         noise_px,
                         &rng,
                         &f);
    scene.features.push_back(std::move(f));
    CalibratedView view;
    view.camera = scene.cameras[v];
    view.camera_from_scene.R = scene.camera_from_world[v].R * turned;
    view.camera_from_scene.t = units * scene.camera_from_world[v].t;
    view.focal_log_sigma = 0.05;
    scene.reconstruction.views.push_back(view);
  }
  scene.reconstruction.trusted = true;
  scene.matching.component.assign(views, -1);
  scene.matching.view_from_plane.assign(views, Eigen::Matrix3d::Identity());
  std::vector<std::vector<int>> vertices, edges;
  for (int v = 0; v < views; ++v) {
    vertices.push_back(matched_scene_internal::ShownVertices(scene, v));
    edges.push_back(matched_scene_internal::ShownEdges(scene, v));
  }
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      PairGeometry& pair = scene.matching.pairs.emplace_back();
      pair.view_a = a;
      pair.view_b = b;
      const Rigid3 b_from_a = scene.camera_from_world[b] * scene.camera_from_world[a].Inverse();
      pair.F =
          Eigen::Matrix3d(scene.cameras[b].K().inverse().transpose() * CrossMatrix(b_from_a.t) *
                          b_from_a.R * scene.cameras[a].K().inverse());
      for (int i = 0; i < static_cast<int>(vertices[a].size()); ++i) {
        for (int k = 0; k < static_cast<int>(vertices[b].size()); ++k) {
          if (vertices[a][i] >= 0 && vertices[a][i] == vertices[b][k])
            pair.matches.push_back({i, k, 5.0});
        }
      }
      for (int i = 0; i < static_cast<int>(edges[a].size()); ++i) {
        for (int k = 0; k < static_cast<int>(edges[b].size()); ++k) {
          if (edges[a][i] >= 0 && edges[a][i] == edges[b][k]) pair.segments.push_back({i, k, 5.0});
        }
      }
    }
  }
  return scene;
}

}  // namespace horopter
