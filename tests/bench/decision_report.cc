// What the decision says where the catalog holds the scene's parts, and where it holds others
// instead: mirror images of them, copies stretched along one axis, parts with a hole moved or
// filled, all but the scene's.
//
//   decision_report DATASET SPLIT [--scenes 1,5] [--images N] [--stretch 1.1] [--others DATASET]
//                   [--catalog true|mirror|stretched|absent] [--decoys FOLDER] [--candidates]
//     --catalog     absent: of each scene the catalog without any of its parts; mirror: of those
//                   parts whose mirror image is another part
//     --others      the catalog is of another data set: all that is answered is wrong
//     --decoys      the catalog holds what FOLDER/cad has of its parts (decoy_parts), and no others
//     --candidates  also a line for each part that was verified, whether answered or not, and for
//                   the best hypothesis of each part in each image: what it says, and what it is:
//                   right, turned (its middle is right), look-alike (another part is there), absent
//
// Prints a line an answer: scene, catalog, object, score, how far its worst vertex is from that of
// the nearest instance of the object or of what it was made of (px at 640 px width, worst image,
// each under its own camera), number of alternatives; a line of seconds; and what is said.
// record_decision.py makes a recorded run of it.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/pipeline.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {
namespace {

struct Arguments {
  std::string dataset, split, others, decoys, catalog = "true";
  bool candidates = false;
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

// Whether the part's mirror image is another part.
bool IsHanded(const PreparedObject& object) {
  return object.twin->Of(object.model.mesh, object.model.diameter_m, object.aspects->object.mesh)
      .chiral;
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

// What stands where a pose of an object in an image is; middles within a tenth of its size, poses
// within kRightPx of a width of 640 px.
const char* KindOf(const BopImage& image,
                   const PinholeCamera& camera,
                   const Rigid3& camera_from_object,
                   const ObjectModel& model) {
  constexpr double kRightPx = 10.0;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& v : model.mesh.vertices) middle += v / model.mesh.vertices.size();
  const Eigen::Vector3d at = camera_from_object * middle;
  if (!(at.z() > 0.0)) return "absent";
  const double size_px = camera.focal_px * model.diameter_m / at.z();
  const char* kind = "absent";
  for (const BopInstance& truth : image.instances) {
    const bool own = BopObjectName(truth.obj_id) == model.id;
    if (own &&
        WorstVertexPx(model, camera, camera_from_object, image.camera, truth.camera_from_object) *
                kReferenceWidth / std::max(camera.width, 1) <=
            kRightPx)
      return "right";
    const Eigen::Vector3d x = truth.camera_from_object * middle;
    if (x.z() > 0.0 && (Project(camera, at) - Project(image.camera, x)).norm() < 0.1 * size_px)
      kind = own ? "turned" : "look-alike";
  }
  return kind;
}

const ObjectModel& ModelOf(const CatalogSnapshot& catalog, int object) {
  return catalog.objects[object]->model;
}

void PrintCandidates(int id,
                     const Arguments& a,
                     const BopScene& scene,
                     const CatalogSnapshot& catalog,
                     const RecognitionResult& found) {
  for (const SceneObject& o : found.verified) {
    std::map<std::string, int> kinds;
    for (std::size_t v = 0; v < found.views.size(); ++v) {
      if (!found.views[v]) continue;
      ++kinds[KindOf(scene.images[v],
                     found.views[v]->camera,
                     found.views[v]->camera_from_scene * o.scene_from_object,
                     ModelOf(catalog, o.object))];
    }
    std::string said;
    for (const auto& [kind, count] : kinds) said += absl::StrFormat(" %s %d", kind, count);
    for (const double score : o.view_scores) said += absl::StrFormat(" %.3f", score);
    std::cout << absl::StrFormat("candidate %d %s %s probability %.4f support %.3f%s\n",
                                 id,
                                 a.catalog,
                                 ModelOf(catalog, o.object).id,
                                 o.score,
                                 o.support,
                                 said.empty() ? " unplaced" : said);
  }
  std::set<std::pair<int, int>> told;
  for (const ViewHypothesis& h : found.hypotheses) {
    if (!told.insert({h.object, h.view}).second) continue;
    const ObjectModel& model = ModelOf(catalog, h.object);
    std::cout << absl::StrFormat(
        "hypothesis %d %s %s image %d score %.3f %s\n",
        id,
        a.catalog,
        model.id,
        h.view,
        h.score,
        KindOf(scene.images[h.view], h.camera, h.camera_from_object, model));
  }
}

int Run(const Arguments& a) {
  const absl::StatusOr<BopDataset> dataset = ReadBopDataset(a.dataset);
  if (!dataset.ok()) return std::cerr << dataset.status() << "\n", 1;
  const absl::StatusOr<BopDataset> enrolled =
      ReadBopDataset(a.others.empty() ? a.dataset : a.others);
  if (!enrolled.ok()) return std::cerr << enrolled.status() << "\n", 1;
  CatalogSnapshot catalog;
  for (const BopObject& object : enrolled->objects) {
    std::string path = object.cad_path.empty() ? object.mesh_path : object.cad_path;
    if (!a.decoys.empty()) {
      path = a.decoys + "/cad/" + std::filesystem::path(path).filename().string();
      if (!std::filesystem::exists(path)) continue;
    }
    absl::StatusOr<CadImport> cad = ImportCad(path);
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
    if (a.catalog == "mirror" && !IsHanded(**prepared)) continue;
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
    if (a.candidates) PrintCandidates(id, a, scene, searched, result->trace.recognition);
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
  app.add_option("--decoys", a.decoys);
  app.add_flag("--candidates", a.candidates);
  CLI11_PARSE(app, argc, argv);
  return horopter::Run(a);
}
