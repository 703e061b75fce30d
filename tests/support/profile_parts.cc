#include "tests/support/profile_parts.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <string>
#include <utility>

namespace horopter {
namespace {

struct Profile {
  std::vector<Eigen::Vector2d> polygon;  // unit size
  Eigen::Vector2d boss_low, boss_high;   // a rectangle inside it
};

Profile DrawProfile(int kind, Random* random) {
  const double a = random->Uniform(0.2, 0.45), b = random->Uniform(0.2, 0.45);
  switch (kind) {
    case 0:  // L
      return {
          {{0, 0}, {1, 0}, {1, a}, {b, a}, {b, 1}, {0, 1}}, {b + 0.05, 0.15 * a}, {0.95, 0.85 * a}};
    case 1:  // T
      return {{{0, 1 - a},
               {0.5 - b / 2, 1 - a},
               {0.5 - b / 2, 0},
               {0.5 + b / 2, 0},
               {0.5 + b / 2, 1 - a},
               {1, 1 - a},
               {1, 1},
               {0, 1}},
              {0.1, 1 - 0.85 * a},
              {0.9, 1 - 0.15 * a}};
    case 2:  // U
      return {{{0, 0}, {1, 0}, {1, 1}, {1 - a, 1}, {1 - a, b}, {a * 0.8, b}, {a * 0.8, 1}, {0, 1}},
              {0.1, 0.15 * b},
              {0.9, 0.85 * b}};
    case 3: {  // step
      const double c = random->Uniform(0.5, 0.8);
      return {{{0, 0}, {1, 0}, {1, a}, {c, a}, {c, a + b}, {0, a + b}},
              {0.1, 0.1 * (a + b)},
              {0.9 * c, 0.9 * (a + b)}};
    }
    default:  // wedge
      return {{{0, 0}, {1, 0}, {1, a}, {0, 1}}, {0.1, 0.1 * a}, {0.9, 0.9 * a}};
  }
}

struct Draft {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::pair<int, int>> edges;
};

void AddPrism(const std::vector<Eigen::Vector2d>& polygon, double low, double high, Draft* draft) {
  const int n = static_cast<int>(polygon.size());
  const int first = static_cast<int>(draft->vertices.size());
  for (const double z : {low, high}) {
    for (const Eigen::Vector2d& p : polygon) draft->vertices.emplace_back(p.x(), p.y(), z);
  }
  for (int i = 0; i < n; ++i) {
    const int j = (i + 1) % n;
    draft->edges.emplace_back(first + i, first + j);
    draft->edges.emplace_back(first + n + i, first + n + j);
    draft->edges.emplace_back(first + i, first + n + i);
  }
}

// Vertex v, where three edges meet, is cut off at `lengths` along them.
void ClipCorner(int v, const std::array<double, 3>& lengths, Draft* draft) {
  const Eigen::Vector3d corner = draft->vertices[v];
  std::array<int, 3> cut{v, 0, 0};
  for (int k = 1; k < 3; ++k) {
    cut[k] = static_cast<int>(draft->vertices.size());
    draft->vertices.push_back(corner);
  }
  int k = 0;
  for (auto& [a, b] : draft->edges) {
    if (k == 3 || (a != v && b != v)) continue;
    const Eigen::Vector3d along = draft->vertices[a == v ? b : a] - corner;
    const double length = std::min(lengths[k], 0.4 * along.norm());
    draft->vertices[cut[k]] = corner + length * along.normalized();
    (a == v ? a : b) = cut[k];
    ++k;
  }
  for (int i = 0; i < 3; ++i) draft->edges.emplace_back(cut[i], cut[(i + 1) % 3]);
}

double Diameter(const std::vector<Eigen::Vector3d>& vertices) {
  double diameter = 0.0;
  for (const auto& a : vertices) {
    for (const auto& b : vertices) diameter = std::max(diameter, (a - b).norm());
  }
  return diameter;
}

}  // namespace

ObjectModel ProfilePart(unsigned seed, const ProfilePartOptions& options) {
  Random random(seed * 2654435761u + 12345u);
  Profile profile = DrawProfile(random.Index(5), &random);
  const Eigen::Vector2d size(random.Uniform(0.05, 0.11), random.Uniform(0.05, 0.11));
  const double height = random.Uniform(0.03, 0.08);
  const auto scaled = [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
    return (p - Eigen::Vector2d(0.5, 0.5)).cwiseProduct(size);
  };
  for (Eigen::Vector2d& p : profile.polygon) p = scaled(p);
  Draft draft;
  AddPrism(profile.polygon, 0.0, height, &draft);
  const int corners = static_cast<int>(profile.polygon.size());
  const bool clipped = random.Uniform(0, 1) < options.clipped_share;
  const bool boss = random.Uniform(0, 1) < options.boss_share;
  if (clipped) {
    std::array<double, 3> lengths;
    for (double& l : lengths) l = random.Uniform(0.006, 0.014);
    ClipCorner(corners + random.Index(corners), lengths, &draft);
  }
  if (boss) {
    const Eigen::Vector2d low = scaled(profile.boss_low), high = scaled(profile.boss_high);
    const Eigen::Vector2d extent = high - low;
    const double left = random.Uniform(0.0, 0.5), down = random.Uniform(0.0, 0.4);
    const Eigen::Vector2d from = low + Eigen::Vector2d(left, down).cwiseProduct(extent);
    const Eigen::Vector2d to =
        from +
        Eigen::Vector2d(random.Uniform(0.3, 0.5), random.Uniform(0.4, 0.6)).cwiseProduct(extent);
    AddPrism({from, {to.x(), from.y()}, to, {from.x(), to.y()}},
             height,
             height + random.Uniform(0.008, 0.02),
             &draft);
  }
  ObjectModel model;
  model.id = "profile_" + std::to_string(seed);
  model.vertices = draft.vertices;
  for (const auto& [a, b] : draft.edges) {
    ModelEdge edge;
    edge.start_vertex = a;
    edge.end_vertex = b;
    edge.dihedral_rad = 0.5 * std::numbers::pi;
    edge.polyline = {model.vertices[a], model.vertices[b]};
    model.edges.push_back(edge);
  }
  model.diameter_m = Diameter(model.vertices);
  return model;
}

ProfileScene MakeProfileScene(const std::vector<ObjectModel>& catalog,
                              const ProfileSceneOptions& options) {
  Random random(options.seed * 7919u + 3u);
  ProfileScene scene;
  SyntheticTracksOptions tracks;
  tracks.seed = options.seed;
  tracks.views = options.views;
  for (int part = 0; part < options.parts; ++part) {
    int object = random.Index(static_cast<int>(catalog.size()));
    while (std::find(scene.objects.begin(), scene.objects.end(), object) != scene.objects.end()) {
      object = (object + 1) % static_cast<int>(catalog.size());
    }
    scene.objects.push_back(object);
    const double place = 2.0 * std::numbers::pi * part / options.parts;
    Rigid3 pose;
    pose.R =
        Eigen::AngleAxisd(random.Uniform(0.0, 2.0 * std::numbers::pi), Eigen::Vector3d::UnitZ())
            .toRotationMatrix();
    pose.t = 0.12 * Eigen::Vector3d(std::cos(place), std::sin(place), 0.0);
    scene.world_from_object.push_back(pose);
    const ObjectModel& model = catalog[object];
    std::map<int, int> point_of_vertex;
    const auto add = [&](const Eigen::Vector3d& point, int vertex) {
      tracks.given_points.push_back(point);
      scene.part_of_point.push_back(part);
      scene.vertex_of_point.push_back(vertex);
    };
    Eigen::Vector3d low = model.vertices[0], high = low;
    for (int v = 0; v < static_cast<int>(model.vertices.size()); ++v) {
      low = low.cwiseMin(model.vertices[v]);
      high = high.cwiseMax(model.vertices[v]);
      if (random.Uniform(0, 1) < options.deleted_share) continue;
      point_of_vertex[v] = static_cast<int>(tracks.given_points.size());
      add(pose * model.vertices[v], v);
    }
    const double clutter = options.clutter_share * static_cast<double>(model.vertices.size());
    for (int k = 0; k < static_cast<int>(clutter + 0.5); ++k) {
      const Eigen::Vector3d share(
          random.Uniform(-0.1, 1.1), random.Uniform(-0.1, 1.1), random.Uniform(0, 1.1));
      add(pose * Eigen::Vector3d(low + share.cwiseProduct(high - low)), -1);
    }
    for (const ModelEdge& edge : model.edges) {
      const auto a = point_of_vertex.find(edge.start_vertex),
                 b = point_of_vertex.find(edge.end_vertex);
      tracks.given_lines.emplace_back(pose * edge.polyline.front(), pose * edge.polyline.back());
      if (a != point_of_vertex.end() && b != point_of_vertex.end()) {
        scene.edges.push_back({a->second, b->second});
      }
    }
  }
  scene.tracks = MakeSyntheticTracks(
      tracks, {options.seed, options.sigma_px, options.missing_share, options.outlier_share});
  return scene;
}

}  // namespace horopter
