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
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/matching.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct TrueCamera {
  Eigen::Matrix3d K, R;
  Eigen::Vector3d t;  // mm
  double k1 = 0.0;
  int width = 0, height = 0;

  Eigen::Vector2d Project(const Eigen::Vector3d& x_world) const {
    const Eigen::Vector3d c = R * x_world + t;
    Eigen::Vector2d n = c.head<2>() / c.z();
    n *= 1.0 + k1 * n.squaredNorm();
    return {K(0, 0) * n.x() + K(0, 2), K(1, 1) * n.y() + K(1, 2)};
  }
  bool Sees(const Eigen::Vector3d& x_world) const {
    if ((R * x_world + t).z() <= 0.0) return false;
    const Eigen::Vector2d p = Project(x_world);
    return p.x() >= 0 && p.y() >= 0 && p.x() <= width - 1 && p.y() <= height - 1;
  }
};

struct Scene {
  int id = 0;
  std::string tier;
  std::vector<cv::Mat> images;
  std::vector<TrueCamera> cameras;
};

json ReadJson(const fs::path& path) {
  std::ifstream in(path);
  return json::parse(in);
}

Eigen::Matrix3d Matrix(const json& j) {
  Eigen::Matrix3d m;
  for (int i = 0; i < 9; ++i) m(i / 3, i % 3) = j[i].get<double>();
  return m;
}

Scene LoadScene(const fs::path& folder, int id) {
  Scene scene;
  scene.id = id;
  scene.tier = ReadJson(folder / "scene_meta.json").value("tier", "?");
  const json cameras = ReadJson(folder / "scene_camera.json");
  std::map<int, json> by_id;
  for (const auto& [key, value] : cameras.items()) by_id[std::stoi(key)] = value;
  for (const auto& [im, c] : by_id) {
    char name[32];
    std::snprintf(name, sizeof(name), "%06d", im);
    for (const char* ext : {".png", ".jpg"}) {
      const fs::path path = folder / "rgb" / (std::string(name) + ext);
      if (!fs::exists(path)) continue;
      scene.images.push_back(cv::imread(path.string(), cv::IMREAD_COLOR));
      TrueCamera camera;
      camera.K = Matrix(c["cam_K"]);
      camera.R = Matrix(c["cam_R_w2c"]);
      for (int i = 0; i < 3; ++i) camera.t(i) = c["cam_t_w2c"][i].get<double>();
      if (c.contains("cam_dist")) camera.k1 = c["cam_dist"][0].get<double>();
      camera.width = scene.images.back().cols;
      camera.height = scene.images.back().rows;
      scene.cameras.push_back(camera);
      break;
    }
  }
  return scene;
}

// Median and 90 % transfer error over table points seen in both views, pixels; negative: none.
std::pair<double, double> TableError(const TrueCamera& a,
                                     const TrueCamera& b,
                                     const Eigen::Matrix3d& H) {
  std::vector<double> errors;
  for (int x = -200; x <= 200; x += 20) {
    for (int y = -200; y <= 200; y += 20) {
      const Eigen::Vector3d p(x, y, 0);
      if (!a.Sees(p) || !b.Sees(p)) continue;
      const double e = (Transfer(H, a.Project(p)) - b.Project(p)).norm();
      errors.push_back(std::isfinite(e) ? e : 1e9);
    }
  }
  if (errors.empty()) return {-1, -1};
  std::sort(errors.begin(), errors.end());
  return {errors[errors.size() / 2], errors[errors.size() * 9 / 10]};
}

struct Tally {
  int neighbours = 0, neighbours_right = 0, neighbours_found = 0, neighbours_chained = 0;
  int pairs = 0, found = 0, right = 0;
  std::vector<double> errors;
};

void ReportScene(const Scene& scene, std::map<std::string, Tally>* tallies) {
  using Clock = std::chrono::steady_clock;
  std::vector<ImageFeatures> features;
  for (const cv::Mat& image : scene.images) {
    ImageFeatures f;
    f.width = image.cols;
    f.height = image.rows;
    features.push_back(f);
  }
  const auto begin = Clock::now();
  const auto matching = MatchViews(scene.images, features, MatchingOptions());
  const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  if (!matching.ok()) {
    std::printf("scene %d: %s\n", scene.id, std::string(matching.status().message()).c_str());
    return;
  }
  std::printf(
      "scene %2d %s: %zu views, matching %.2f s, chain rms %.2f px, contradicted %.0f, component",
      scene.id,
      scene.tier.c_str(),
      scene.images.size(),
      seconds,
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
          TableError(scene.cameras[p.view_a], scene.cameras[p.view_b], p.b_from_a);
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
      const double e = TableError(scene.cameras[a], scene.cameras[a + 1], H).first;
      tally->neighbours_chained += e >= 0 && e < 2.0;
    }
  }
  for (const PlaneHomography& p : matching->planes) {
    const auto direct = TableError(scene.cameras[p.view_a], scene.cameras[p.view_b], p.b_from_a);
    const auto chained = TableError(
        scene.cameras[p.view_a],
        scene.cameras[p.view_b],
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
}

int Run(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: matching_report DATASET SPLIT [SCENE...]\n");
    return 2;
  }
  const fs::path split = fs::path(argv[1]) / argv[2];
  std::vector<int> ids;
  for (int i = 3; i < argc; ++i) ids.push_back(std::stoi(argv[i]));
  if (ids.empty()) {
    for (const auto& entry : fs::directory_iterator(split)) {
      if (entry.is_directory()) ids.push_back(std::stoi(entry.path().filename().string()));
    }
    std::sort(ids.begin(), ids.end());
  }
  std::map<std::string, Tally> tallies;
  for (int id : ids) {
    char name[32];
    std::snprintf(name, sizeof(name), "%06d", id);
    ReportScene(LoadScene(split / name, id), &tallies);
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
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  try {
    return horopter::Run(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "matching_report: %s\n", e.what());
    return 1;
  }
}
