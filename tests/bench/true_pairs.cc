#include "tests/bench/true_pairs.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <opencv2/imgcodecs.hpp>

#include "server/base/status_macros.h"
#include "server/vision/geometry/plucker_line.h"

namespace horopter {
namespace {

// Homography from the plane z = 0 of the world frame to pixels.
Eigen::Matrix3d FromTable(const BopImage& image) {
  Eigen::Matrix3d H;
  H << image.camera_from_world.R.col(0), image.camera_from_world.R.col(1),
      image.camera_from_world.t;
  return image.camera.K() * H;
}

}  // namespace

absl::StatusOr<TrueScene> LoadTrueScene(const std::string& dataset,
                                        const std::string& split,
                                        int id,
                                        const TrueModels& models) {
  TrueScene scene;
  HOROPTER_ASSIGN_OR_RETURN(scene.bop, ReadBopScene(dataset, split, id));
  scene.id = id;
  scene.tier = scene.bop.tier;
  for (const BopImage& image : scene.bop.images) {
    scene.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    if (scene.images.back().empty()) return absl::NotFoundError("no image " + image.path);
    HOROPTER_ASSIGN_OR_RETURN(ImageFeatures features,
                              DetectFeatures(scene.images.back(), FeatureOptions()));
    scene.features.push_back(std::move(features));
    scene.truth.push_back(MakeTrueView(image, models));
    scene.labels.push_back(LabelFeatures(scene.features.back(), scene.truth.back()));
  }
  for (size_t v = 0; v < scene.images.size(); ++v)
    scene.views.push_back(PrepareMatchingView(scene.images[v], scene.features[v]));
  return scene;
}

TruePair MakeTruePair(const TrueScene& scene, int view_a, int view_b) {
  const BopImage& a = scene.bop.images[view_a];
  const BopImage& b = scene.bop.images[view_b];
  TruePair pair;
  pair.scene = &scene;
  pair.view_a = view_a;
  pair.view_b = view_b;
  pair.image_b = &scene.images[view_b];
  pair.a = &scene.views[view_a];
  pair.b = &scene.views[view_b];
  pair.labels_a = &scene.labels[view_a];
  pair.labels_b = &scene.labels[view_b];
  pair.b_from_a = FromTable(b) * FromTable(a).inverse();
  const Rigid3 b_from_a = b.camera_from_world * a.camera_from_world.Inverse();
  pair.F_true = b.camera.K().inverse().transpose() * CrossMatrix(b_from_a.t) * b_from_a.R *
                a.camera.K().inverse();
  pair.F_true.normalize();
  return pair;
}

double EpipolarDistance(const Eigen::Matrix3d& F,
                        const Eigen::Vector2d& a,
                        const Eigen::Vector2d& b) {
  const auto distance = [](const Eigen::Vector3d& line, const Eigen::Vector2d& x) {
    return std::abs(line.dot(x.homogeneous())) / line.head<2>().norm();
  };
  return std::max(distance(F * a.homogeneous(), b), distance(F.transpose() * b.homogeneous(), a));
}

double ShareOfVertices(const TruePair& pair, const TrueModels& models, const Eigen::Matrix3d& F) {
  const BopImage& a = pair.scene->bop.images[pair.view_a];
  const BopImage& b = pair.scene->bop.images[pair.view_b];
  const auto inside = [](const BopImage& view, const Eigen::Vector3d& point_in_camera) {
    if (point_in_camera.z() <= 0.0) return false;
    const Eigen::Vector2d p = ProjectTrue(view, point_in_camera);
    return p.x() >= 0 && p.y() >= 0 && p.x() <= view.camera.width - 1 &&
           p.y() <= view.camera.height - 1;
  };
  int vertices = 0, near = 0;
  for (size_t k = 0; k < std::min(a.instances.size(), b.instances.size()); ++k) {
    if (a.instances[k].visib_fract < 0.1 || b.instances[k].visib_fract < 0.1) continue;
    const auto model = models.find(a.instances[k].obj_id);
    if (model == models.end()) continue;
    for (const Eigen::Vector3d& v : model->second.vertices) {
      const Eigen::Vector3d in_a = a.instances[k].camera_from_object * v;
      const Eigen::Vector3d in_b = b.instances[k].camera_from_object * v;
      if (!inside(a, in_a) || !inside(b, in_b)) continue;
      ++vertices;
      near += EpipolarDistance(F, ProjectTrue(a, in_a), ProjectTrue(b, in_b)) < 2.0;
    }
  }
  return vertices > 0 ? static_cast<double>(near) / vertices : 0.0;
}

absl::Status ForEachTruePair(const std::string& dataset,
                             const std::string& split,
                             std::vector<int> scenes,
                             const std::function<void(const TruePair&)>& visit) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset bop, ReadBopDataset(dataset));
  HOROPTER_ASSIGN_OR_RETURN(const TrueModels models, ReadTrueModels(bop));
  if (scenes.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(scenes, ListBopScenes(dataset, split));
  }
  for (int id : scenes) {
    HOROPTER_ASSIGN_OR_RETURN(const TrueScene scene, LoadTrueScene(dataset, split, id, models));
    const int n = static_cast<int>(scene.images.size());
    for (int a = 0; a < n; ++a) {
      for (int b = a + 1; b < n; ++b) visit(MakeTruePair(scene, a, b));
    }
  }
  return absl::OkStatus();
}

}  // namespace horopter
