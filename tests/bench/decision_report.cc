// What the decision says where the catalog holds the scene's parts, and where it holds others
// instead: mirror images of them, copies stretched along one axis, all but the scene's.
//
//   decision_report DATASET SPLIT [--scenes 1,5] [--images N] [--stretch 1.1] [--others DATASET]
//                   [--catalog true|mirror|stretched|absent]
//     --catalog  absent: of each scene the catalog without any of its parts
//     --others   the catalog is of another data set: all that is answered is wrong
//
// Prints a line an answer: scene, catalog, object, score, how far its worst vertex is from that of
// the nearest instance of the object or of what it was made of (px at 640 px width, worst image,
// each under its own camera), number of alternatives; a line of seconds; and what is said.
// record_decision.py makes a recorded run of it.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <iostream>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/pipeline.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {
namespace {

struct Arguments {
  std::string dataset, split, others, catalog = "true";
  std::vector<int> scenes;
  std::size_t images = 0;
  double stretch = 1.1;
};

// A copy of a model, of its points x -> scale x (component-wise); mirrored where that mirrors.
ObjectModel Scaled(const ObjectModel& model, const Eigen::Vector3d& scale) {
  ObjectModel out;
  out.id = model.id;
  out.mesh = model.mesh;
  const bool mirrors = scale.prod() < 0.0;
  for (auto& v : out.mesh.vertices) v = v.cwiseProduct(scale);
  for (auto& t : out.mesh.triangles) {
    if (mirrors) std::swap(t[1], t[2]);
  }
  Eigen::Vector3d low = Eigen::Vector3d::Constant(1e9), high = -low;
  for (const auto& v : out.mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  out.diameter_m = model.diameter_m;
  return out;
}

constexpr double kReferenceWidth = 640.0;

// The catalog without the parts that a scene shows.
CatalogSnapshot WithoutPartsOf(const BopScene& scene, const CatalogSnapshot& all) {
  CatalogSnapshot out;
  for (const auto& object : all.objects) {
    const bool shown =
        std::any_of(scene.images.begin(), scene.images.end(), [&](const auto& image) {
          return std::any_of(
              image.instances.begin(), image.instances.end(), [&](const auto& instance) {
                return BopObjectName(instance.obj_id) == object->model.id;
              });
        });
    if (!shown) out.objects.push_back(object);
  }
  return out;
}

// See above; large where no image shows the object.
double WorstPx(const SceneAnswer& answer,
               const AnswerObject& o,
               const BopScene& scene,
               const ObjectModel& model) {
  double worst = 0.0;
  for (std::size_t v = 0; v < answer.cameras.size(); ++v) {
    if (!answer.cameras[v]) continue;
    const PinholeCamera& camera = answer.cameras[v]->camera;
    const Rigid3 pose = answer.cameras[v]->camera_from_scene * o.scene_from_object;
    double best = 1e9;
    for (const BopInstance& truth : scene.images[v].instances) {
      if (BopObjectName(truth.obj_id) != o.object_id) continue;
      best = std::min(
          best,
          WorstVertexPx(model, camera, pose, scene.images[v].camera, truth.camera_from_object));
    }
    worst = std::max(worst, best * kReferenceWidth / std::max(camera.width, 1));
  }
  return worst;
}

int Run(const Arguments& a) {
  const absl::StatusOr<BopDataset> dataset = ReadBopDataset(a.dataset);
  if (!dataset.ok()) return std::cerr << dataset.status() << "\n", 1;
  const absl::StatusOr<BopDataset> enrolled =
      ReadBopDataset(a.others.empty() ? a.dataset : a.others);
  if (!enrolled.ok()) return std::cerr << enrolled.status() << "\n", 1;
  CatalogSnapshot catalog;
  for (const BopObject& object : enrolled->objects) {
    absl::StatusOr<CadImport> cad =
        ImportCad(object.cad_path.empty() ? object.mesh_path : object.cad_path);
    if (!cad.ok()) return std::cerr << cad.status() << "\n", 1;
    cad->model.id = BopObjectName(object.obj_id);
    if (a.catalog == "mirror") cad->model = Scaled(cad->model, {-1, 1, 1});
    if (a.catalog == "stretched") {
      Eigen::Vector3d scale = Eigen::Vector3d::Ones();
      scale[object.obj_id % 3] = a.stretch;
      cad->model = Scaled(cad->model, scale);
    }
    auto prepared = PrepareCatalogObject(std::move(cad->model));
    if (!prepared.ok()) return std::cerr << prepared.status() << "\n", 1;
    catalog.objects.push_back(*std::move(prepared));
  }
  std::vector<int> scenes = a.scenes;
  if (scenes.empty()) scenes = ListBopScenes(a.dataset, a.split).value();
  for (const int id : scenes) {
    BopScene scene = ReadBopScene(a.dataset, a.split, id).value();
    if (a.images > 0 && scene.images.size() > a.images) scene.images.resize(a.images);
    SceneRequest request;
    for (const BopImage& image : scene.images)
      request.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    std::cerr << "SCENE " << id << " " << a.catalog << std::endl;
    const CatalogSnapshot searched =
        a.catalog == "absent" ? WithoutPartsOf(scene, catalog) : catalog;
    const auto result = RecognizeScene(request, searched, {});
    if (!result.ok()) return std::cerr << result.status() << "\n", 1;
    const SceneAnswer& answer = result->answer;
    for (const AnswerObject& o : answer.objects) {
      const auto object =
          std::find_if(searched.objects.begin(), searched.objects.end(), [&](const auto& known) {
            return known->model.id == o.object_id;
          });
      const double worst = WorstPx(answer, o, scene, (*object)->model);
      std::cout << absl::StrFormat("%d %s %s %.4f worst %.1f px alternatives %d\n",
                                   id,
                                   a.catalog,
                                   o.object_id,
                                   o.score,
                                   worst,
                                   o.alternatives.size())
                << std::flush;
    }
    std::string stages;
    double shapes_s = 0.0, all_s = 0.0;
    for (const StageReport& stage : answer.stages) {
      all_s += stage.seconds;
      stages += absl::StrFormat(" %s %.2f", stage.stage, stage.seconds);
      const auto shapes = stage.counts.find("seconds_shapes");
      if (shapes != stage.counts.end()) shapes_s += shapes->second;
    }
    std::cout << absl::StrFormat("%d shapes %.2f of %.2f s:%s\n", id, shapes_s, all_s, stages);
    for (const AnswerReason& reason : answer.reasons) std::cout << "  " << reason.detail << "\n";
    if (answer.objects.empty()) std::cout << id << " " << a.catalog << " none" << std::endl;
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Arguments a;
  CLI::App app("What the decision says of parts and of what is taken for them");
  app.add_option("dataset", a.dataset)->required();
  app.add_option("split", a.split)->required();
  app.add_option("--scenes", a.scenes)->delimiter(',');
  app.add_option("--images", a.images);
  app.add_option("--catalog", a.catalog)
      ->check(CLI::IsMember({"true", "mirror", "stretched", "absent"}));
  app.add_option("--others", a.others);
  app.add_option("--stretch", a.stretch);
  CLI11_PARSE(app, argc, argv);
  return horopter::Run(a);
}
