// Reports what matching and reconstruction reach on a data set in BOP layout, against its ground
// truth:
//   matching_report DATASET SPLIT [SCENE...]
// Ground truth is used for the report only. The table is the plane z = 0 of the data set's world
// frame.
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/base/status_macros.h"
#include "server/vision/features/features.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/matching.h"
#include "server/vision/reconstruction/bundle_adjustment.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {
namespace {

struct Scene {
  int id = 0;
  std::string tier;
  std::vector<cv::Mat> images;
  std::vector<BopImage> truth;
};

Eigen::Vector2d ProjectWorld(const BopImage& view, const Eigen::Vector3d& point_in_world) {
  return Project(view.camera, view.camera_from_world * point_in_world);
}

bool InImage(const BopImage& view, const Eigen::Vector3d& point_in_camera) {
  if (point_in_camera.z() <= 0.0) return false;
  const Eigen::Vector2d p = Project(view.camera, point_in_camera);
  return p.x() >= 0 && p.y() >= 0 && p.x() <= view.camera.width - 1 &&
         p.y() <= view.camera.height - 1;
}

// Median and 90 % transfer error over table points seen in both views, pixels; negative: none.
std::pair<double, double> PlaneError(const BopImage& a,
                                     const BopImage& b,
                                     const Eigen::Matrix3d& H) {
  std::vector<double> errors;
  for (int x = -10; x <= 10; ++x) {
    for (int y = -10; y <= 10; ++y) {
      const Eigen::Vector3d p(0.02 * x, 0.02 * y, 0);
      if (!InImage(a, a.camera_from_world * p) || !InImage(b, b.camera_from_world * p)) continue;
      const double e = (Transfer(H, ProjectWorld(a, p)) - ProjectWorld(b, p)).norm();
      errors.push_back(std::isfinite(e) ? e : 1e9);
    }
  }
  if (errors.empty()) return {-1, -1};
  std::sort(errors.begin(), errors.end());
  return {errors[errors.size() / 2], errors[errors.size() * 9 / 10]};
}

double LineDistance(const Eigen::Vector3d& line, const Eigen::Vector2d& x) {
  return std::abs(line.dot(x.homogeneous())) / line.head<2>().norm();
}

// Larger distance (px) of the two points of a match from their epipolar lines.
double EpipolarDistance(const Eigen::Matrix3d& F,
                        const Eigen::Vector2d& a,
                        const Eigen::Vector2d& b) {
  const double in_b = LineDistance(F * a.homogeneous(), b);
  const double in_a = LineDistance(F.transpose() * b.homogeneous(), a);
  return std::max(in_a, in_b);
}

Eigen::Matrix3d TrueFundamental(const BopImage& a, const BopImage& b) {
  const Rigid3 b_from_a = b.camera_from_world * a.camera_from_world.Inverse();
  Eigen::Matrix3d t;
  t << 0, -b_from_a.t.z(), b_from_a.t.y(), b_from_a.t.z(), 0, -b_from_a.t.x(), -b_from_a.t.y(),
      b_from_a.t.x(), 0;
  return b.camera.K().inverse().transpose() * t * b_from_a.R * a.camera.K().inverse();
}

using Models = std::map<int, std::vector<Eigen::Vector3d>>;  // obj_id -> vertices, object frame

// Share of the annotated parts' vertices (inside both images, hidden ones too) within 2 px of F,
// and the 95 % distance.
std::pair<double, double> FundamentalQuality(const Models& models,
                                             const BopImage& a,
                                             const BopImage& b,
                                             const Eigen::Matrix3d& F) {
  std::vector<double> distances;
  for (size_t k = 0; k < std::min(a.instances.size(), b.instances.size()); ++k) {
    if (a.instances[k].visib_fract < 0.1 || b.instances[k].visib_fract < 0.1) continue;
    const auto model = models.find(a.instances[k].obj_id);
    if (model == models.end()) continue;
    for (const Eigen::Vector3d& v : model->second) {
      const Eigen::Vector3d in_a = a.instances[k].camera_from_object * v;
      const Eigen::Vector3d in_b = b.instances[k].camera_from_object * v;
      if (!InImage(a, in_a) || !InImage(b, in_b)) continue;
      distances.push_back(EpipolarDistance(F, Project(a.camera, in_a), Project(b.camera, in_b)));
    }
  }
  if (distances.empty()) return {0, -1};
  std::sort(distances.begin(), distances.end());
  const auto within = std::lower_bound(distances.begin(), distances.end(), 2.0) - distances.begin();
  return {static_cast<double>(within) / static_cast<double>(distances.size()),
          distances[distances.size() * 95 / 100]};
}

struct Tally {
  int neighbours = 0, neighbours_right = 0, neighbours_found = 0, neighbours_chained = 0;
  int pairs = 0, found = 0, right = 0;
  std::vector<double> errors;
  int f_found = 0, f_right = 0, f_neighbours_found = 0, f_neighbours_right = 0;
  int matches = 0, matches_right = 0;
  int scenes = 0, scenes_all_in = 0, scenes_registered_right = 0, trusted = 0;
  std::vector<double> focal_errors, trusted_focal_errors;
  std::vector<double> focal_ratios;  // error over stated deviation, every view of trusted scenes
  std::vector<double> five_view_errors;  // scenes with five and more registered views
};

void ReportPairs(const Scene& scene,
                 const Models& models,
                 const std::vector<ImageFeatures>& features,
                 const MatchingResult& matching,
                 std::map<std::string, Tally>* tallies) {
  for (const PairGeometry& p : matching.pairs) {
    const BopImage& a = scene.truth[p.view_a];
    const BopImage& b = scene.truth[p.view_b];
    if (!p.F) {
      std::printf("  pair %d-%d: refused: %s\n", p.view_a, p.view_b, p.refusal.c_str());
      continue;
    }
    const auto [share, p95] = FundamentalQuality(models, a, b, *p.F);
    const Eigen::Matrix3d F_true = TrueFundamental(a, b);
    int right = 0;
    for (const JunctionMatch& m : p.matches) {
      right += EpipolarDistance(F_true,
                                features[p.view_a].junctions[m.junction_a].point,
                                features[p.view_b].junctions[m.junction_b].point) < 2.0;
    }
    std::printf(
        "  pair %d-%d: F %s, %.0f %% of vertices < 2 px, 95 %% < %.2f px; %d of %zu matches "
        "right\n",
        p.view_a,
        p.view_b,
        share >= 0.95 ? "right" : "WRONG",
        100 * share,
        p95,
        right,
        p.matches.size());
    for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
      ++tally->f_found;
      tally->f_right += share >= 0.95;
      tally->matches += static_cast<int>(p.matches.size());
      tally->matches_right += right;
      if (p.view_b - p.view_a == 1) {
        ++tally->f_neighbours_found;
        tally->f_neighbours_right += share >= 0.95;
      }
    }
  }
}

// 95 % over the annotated parts' vertices of the worst reprojection after triangulating the vertex
// from its true images: zero for the true cameras and for any collineation of them. Negative: fewer
// than two views. Pixels.
double VertexReprojection(const Models& models,
                          const Scene& scene,
                          const Reconstruction& reconstruction) {
  Bundle bundle;
  std::vector<int> views;
  for (size_t v = 0; v < reconstruction.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    const CalibratedView& r = *reconstruction.views[v];
    BundleView view;
    view.size = {r.camera.width, r.camera.height};
    view.focal_px = r.camera.focal_px;
    view.k1 = r.camera.k1;
    view.camera_from_world = r.camera_from_scene;
    view.prior.principal_point_px = Eigen::Vector2d(r.camera.cx, r.camera.cy);
    bundle.views.push_back(view);
    views.push_back(static_cast<int>(v));
  }
  std::vector<double> errors;
  const size_t instances = scene.truth.front().instances.size();
  for (size_t k = 0; k < instances; ++k) {
    const auto model = models.find(scene.truth.front().instances[k].obj_id);
    if (model == models.end()) continue;
    for (const Eigen::Vector3d& vertex : model->second) {
      Track track;
      for (size_t i = 0; i < views.size(); ++i) {
        const BopImage& image = scene.truth[views[i]];
        const Eigen::Vector3d c = image.instances[k].camera_from_object * vertex;
        if (InImage(image, c))
          track.observations.push_back({static_cast<int>(i), -1, Project(image.camera, c)});
      }
      if (track.observations.size() < 2) continue;
      const auto x = Triangulate(bundle, track, 0.0);
      errors.push_back(x ? WorstReprojection(bundle, {track, *x, false}) : 1e9);
    }
  }
  if (errors.empty()) return -1.0;
  std::sort(errors.begin(), errors.end());
  return errors[errors.size() * 95 / 100];
}

void ReportReconstruction(const Scene& scene,
                          const Models& models,
                          const std::vector<ImageFeatures>& features,
                          const MatchingResult& matching,
                          std::map<std::string, Tally>* tallies) {
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : scene.images) sizes.push_back({image.cols, image.rows});
  const auto begin = std::chrono::steady_clock::now();
  const auto r = ReconstructViews(matching, features, sizes, {}, ReconstructionOptions());
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  if (!r.ok()) {
    std::printf("  reconstruction: %s\n", std::string(r.status().message()).c_str());
    return;
  }
  std::vector<double> errors, ratios;
  std::string list;
  for (size_t v = 0; v < r->views.size(); ++v) {
    if (!r->views[v]) continue;
    const double e = std::log(r->views[v]->camera.focal_px / scene.truth[v].camera.focal_px);
    errors.push_back(std::abs(e));
    ratios.push_back(std::abs(e) / r->views[v]->focal_log_sigma);
    char text[64];
    std::snprintf(text, sizeof(text), " %+.0f(%.0f)", 100 * e, 100 * r->views[v]->focal_log_sigma);
    list += text;
  }
  const double p95 = errors.empty() ? -1.0 : VertexReprojection(models, scene, *r);
  const bool all_in = errors.size() == scene.images.size() && p95 >= 0 && p95 <= 2.0;
  std::printf(
      "  reconstruction %.2f s: %zu of %zu views, rms %.2f px, %s; vertices 95 %% < %.2f px; f "
      "error (sigma) in %%:%s\n",
      seconds,
      errors.size(),
      scene.images.size(),
      r->rms_px,
      r->trusted ? "trusted" : r->refusal.c_str(),
      p95,
      list.c_str());
  std::sort(errors.begin(), errors.end());
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    ++tally->scenes;
    tally->scenes_all_in += all_in;
    tally->scenes_registered_right += p95 >= 0 && p95 <= 2.0;
    tally->trusted += r->trusted;
    if (!errors.empty()) tally->focal_errors.push_back(errors[errors.size() / 2]);
    if (errors.size() >= 5) tally->five_view_errors.push_back(errors[errors.size() / 2]);
    if (!r->trusted) continue;
    tally->trusted_focal_errors.push_back(errors.back());
    tally->focal_ratios.insert(tally->focal_ratios.end(), ratios.begin(), ratios.end());
  }
}

void ReportScene(const Scene& scene, const Models& models, std::map<std::string, Tally>* tallies) {
  using Clock = std::chrono::steady_clock;
  std::vector<ImageFeatures> features;
  for (const cv::Mat& image : scene.images) {
    auto detected = DetectFeatures(image, FeatureOptions());
    if (!detected.ok()) {
      std::printf("scene %d: %s\n", scene.id, std::string(detected.status().message()).c_str());
      return;
    }
    features.push_back(*std::move(detected));
  }
  const auto begin = Clock::now();
  const std::clock_t cpu_begin = std::clock();
  MatchingOptions options;
  options.threads = 2;
  const auto matching = MatchViews(scene.images, features, options);
  const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  const double cpu_seconds = static_cast<double>(std::clock() - cpu_begin) / CLOCKS_PER_SEC;
  if (!matching.ok()) {
    std::printf("scene %d: %s\n", scene.id, std::string(matching.status().message()).c_str());
    return;
  }
  std::printf(
      "scene %2d %s: %zu views, matching %.2f s (CPU %.2f s), chain rms %.2f px, contradicted "
      "%.0f, component",
      scene.id,
      scene.tier.c_str(),
      scene.images.size(),
      seconds,
      cpu_seconds,
      matching->counts.at("plane_rms_px"),
      matching->counts.at("planes_contradicted"));
  for (int c : matching->component) std::printf(" %d", c);
  std::printf("\n");
  const int n = static_cast<int>(scene.images.size());
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    tally->pairs += n * (n - 1) / 2;
    tally->neighbours += n - 1;
    for (const PlaneHomography& p : matching->planes) {
      const auto [median, p90] =
          PlaneError(scene.truth[p.view_a], scene.truth[p.view_b], p.b_from_a);
      ++tally->found;
      tally->right += median >= 0 && median < 2.0;
      tally->errors.push_back(median);
      if (p.view_b - p.view_a == 1) {
        ++tally->neighbours_found;
        tally->neighbours_right += median >= 0 && median < 2.0;
      }
    }
    for (int a = 0; a + 1 < n; ++a) {
      if (matching->component[a] < 0 || matching->component[a] != matching->component[a + 1])
        continue;
      const Eigen::Matrix3d H =
          matching->view_from_plane[a + 1] * matching->view_from_plane[a].inverse();
      const double e = PlaneError(scene.truth[a], scene.truth[a + 1], H).first;
      tally->neighbours_chained += e >= 0 && e < 2.0;
    }
  }
  for (const PlaneHomography& p : matching->planes) {
    const auto direct = PlaneError(scene.truth[p.view_a], scene.truth[p.view_b], p.b_from_a);
    const auto chained = PlaneError(
        scene.truth[p.view_a],
        scene.truth[p.view_b],
        matching->view_from_plane[p.view_b] * matching->view_from_plane[p.view_a].inverse());
    std::printf("  plane %d-%d: %4zu inliers, error %.2f / %.2f px, chained %.2f / %.2f px\n",
                p.view_a,
                p.view_b,
                p.inliers_a.size(),
                direct.first,
                direct.second,
                chained.first,
                chained.second);
  }
  ReportPairs(scene, models, features, *matching, tallies);
  ReportReconstruction(scene, models, features, *matching, tallies);
}

absl::StatusOr<Scene> LoadScene(const std::string& dataset, const std::string& split, int id) {
  HOROPTER_ASSIGN_OR_RETURN(const BopScene bop, ReadBopScene(dataset, split, id));
  Scene scene;
  scene.id = id;
  scene.tier = bop.tier;
  for (const BopImage& image : bop.images) {
    cv::Mat pixels = cv::imread(image.path, cv::IMREAD_COLOR);
    if (pixels.empty()) return absl::NotFoundError("no image " + image.path);
    scene.images.push_back(pixels);
    scene.truth.push_back(image);
  }
  return scene;
}

absl::Status Report(const std::string& dataset, const std::string& split, std::vector<int> ids) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset bop, ReadBopDataset(dataset));
  if (ids.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(ids, ListBopScenes(dataset, split));
  }
  Models models;
  for (const BopObject& object : bop.objects) {
    HOROPTER_ASSIGN_OR_RETURN(
        const CadImport cad,
        ImportCad(object.cad_path.empty() ? object.mesh_path : object.cad_path));
    models[object.obj_id] = cad.model.vertices;
  }
  std::map<std::string, Tally> tallies;
  for (int id : ids) {
    HOROPTER_ASSIGN_OR_RETURN(const Scene scene, LoadScene(dataset, split, id));
    ReportScene(scene, models, &tallies);
  }
  for (auto& [tier, t] : tallies) {
    std::sort(t.errors.begin(), t.errors.end());
    std::printf(
        "%-4s table H: neighbours right %d of %d found, of %d in all (chained right %d); all pairs "
        "right "
        "%d of %d found, of %d; median error %.2f px\n",
        tier.c_str(),
        t.neighbours_right,
        t.neighbours_found,
        t.neighbours,
        t.neighbours_chained,
        t.right,
        t.found,
        t.pairs,
        t.errors.empty() ? -1.0 : t.errors[t.errors.size() / 2]);
    std::printf(
        "%-4s F: neighbours right %d of %d found; all pairs right %d of %d found; matches right %d "
        "of %d\n",
        tier.c_str(),
        t.f_neighbours_right,
        t.f_neighbours_found,
        t.f_right,
        t.f_found,
        t.matches_right,
        t.matches);
    std::sort(t.focal_errors.begin(), t.focal_errors.end());
    std::sort(t.trusted_focal_errors.begin(), t.trusted_focal_errors.end());
    std::printf(
        "%-4s cameras: all images in and vertices < 2 px in %d of %d scenes (registered views "
        "right in %d); focal error median %.1f %%; trusted %d, their worst view %.1f %%\n",
        tier.c_str(),
        t.scenes_all_in,
        t.scenes,
        t.scenes_registered_right,
        t.focal_errors.empty() ? -1.0 : 100 * t.focal_errors[t.focal_errors.size() / 2],
        t.trusted,
        t.trusted_focal_errors.empty() ? -1.0 : 100 * t.trusted_focal_errors.back());
    std::sort(t.five_view_errors.begin(), t.five_view_errors.end());
    std::sort(t.focal_ratios.begin(), t.focal_ratios.end());
    if (t.five_view_errors.empty() || t.focal_ratios.empty()) continue;
    double squared = 0.0;
    for (const double ratio : t.focal_ratios) squared += ratio * ratio;
    std::printf(
        "%-4s five views and more: focal error median %.1f %% (%zu scenes); trusted: error / "
        "stated "
        "deviation rms %.2f, largest %.1f (%zu views)\n",
        tier.c_str(),
        100 * t.five_view_errors[t.five_view_errors.size() / 2],
        t.five_view_errors.size(),
        std::sqrt(squared / static_cast<double>(t.focal_ratios.size())),
        t.focal_ratios.back(),
        t.focal_ratios.size());
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: matching_report DATASET SPLIT [SCENE...]\n");
    return 2;
  }
  std::vector<int> ids;
  for (int i = 3; i < argc; ++i) ids.push_back(std::atoi(argv[i]));
  const absl::Status status = horopter::Report(argv[1], argv[2], ids);
  if (status.ok()) return 0;
  std::fprintf(stderr, "matching_report: %s\n", std::string(status.message()).c_str());
  return 1;
}
