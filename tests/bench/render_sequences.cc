// Renders a data set in BOP layout from the objects of another one, for reports that need hundreds
// of scenes with known truth.
//   render_sequences DATASET OUT [--seed S] [--scenes N] [--independent]
//     without --independent: requests of one rig of fixed cameras over one table (split val), as
//     station_sequences.py plays them. From scene --first-change on, every --change-every scenes,
//     the same once more with one camera turned by half a degree (split turned) and with 2 % more
//     focal length (split zoomed); scene_meta.json says which.
//     --independent: each scene has cameras, a table and light of its own, three to six images.
//     --as SPLIT: the scenes of this split of DATASET, its parts where they lie and its cameras, on
//     another table in another light: what a table makes of the same scenes. What is no part of the
//     data set, and heights other than the table's, are not there.
//   --table KIND      blank, mottled, striped or speckled (default: by lot)
//   --parts A,B       of a scene (default 1,4)
// Scene i is the same whatever N is. About a second and a half of processor time an image.
#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <opencv2/imgcodecs.hpp>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "tests/support/staged_scene.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr double kTurnRad = 0.5 * std::numbers::pi / 180.0;  // of a bumped camera
constexpr double kZoom = 1.02;                               // of a refocused one
constexpr double kTargetShare = 0.1;   // of an instance, visible in two views: a target
constexpr double kScenePerPart = 2.5;  // what cameras look at, in the parts' median diameter

struct Arguments {
  std::string dataset, out, table, as;
  unsigned seed = 1;
  int scenes = 30, first_scene = 1, first_change = 11, change_every = 2, cameras = 4;
  std::vector<int> parts = {1, 4};
  bool independent = false;
};

std::vector<double> RowMajor(const Eigen::Matrix3d& m) {
  std::vector<double> out;
  for (int i = 0; i < 9; ++i) out.push_back(m(i / 3, i % 3));
  return out;
}

std::vector<double> Millimetres(const Eigen::Vector3d& v) {
  return {1000.0 * v.x(), 1000.0 * v.y(), 1000.0 * v.z()};
}

void WriteJson(const fs::path& path, const Json& json) {
  std::ofstream(path) << json.dump(1) << "\n";
}

// A scene of a split as it is written, image by image.
struct SceneFiles {
  Json camera = Json::object(), truth = Json::object(), info = Json::object();

  void Add(int image,
           const PinholeCamera& cam,
           const Rigid3& camera_from_world,
           const Photograph& photograph,
           std::span<const StageablePart> parts,
           std::span<const StagedPart> standing) {
    const std::string key = std::to_string(image);
    camera[key] = {{"cam_K", RowMajor(cam.K())},
                   {"cam_R_w2c", RowMajor(camera_from_world.R)},
                   {"cam_t_w2c", Millimetres(camera_from_world.t)},
                   {"cam_dist", {cam.k1, 0.0, 0.0, 0.0}},
                   {"depth_scale", 1.0}};
    truth[key] = info[key] = Json::array();
    for (std::size_t i = 0; i < standing.size(); ++i) {
      const Rigid3 pose = camera_from_world * standing[i].world_from_object;
      truth[key].push_back({{"obj_id", parts[standing[i].part].id},
                            {"cam_R_m2c", RowMajor(pose.R)},
                            {"cam_t_m2c", Millimetres(pose.t)}});
      const cv::Rect& box = photograph.visible_box[i];
      info[key].push_back({{"visib_fract", photograph.visible_share[i]},
                           {"bbox_visib", {box.x, box.y, box.width, box.height}}});
    }
  }
};

class Writer {
 public:
  explicit Writer(const Arguments& arguments) : out_(arguments.out) {}

  void Write(const std::string& split, int scene, const SceneFiles& files, Json meta) {
    const fs::path folder = out_ / split / absl::StrFormat("%06d", scene);
    fs::create_directories(folder / "rgb");
    WriteJson(folder / "scene_camera.json", files.camera);
    WriteJson(folder / "scene_gt.json", files.truth);
    WriteJson(folder / "scene_gt_info.json", files.info);
    meta["scene_id"] = scene;
    WriteJson(folder / "scene_meta.json", meta);
    Json ids = Json::array();
    for (const auto& [key, value] : files.truth.items()) ids.push_back(std::stoi(key));
    std::map<int, int> count;
    const std::size_t instances = files.truth["0"].size();
    for (std::size_t i = 0; i < instances; ++i) {
      int seen = 0;
      for (const auto& [key, value] : files.info.items())
        seen += value[i]["visib_fract"].get<double>() >= kTargetShare;
      if (seen >= 2) ++count[files.truth["0"][i]["obj_id"].get<int>()];
    }
    for (const auto& [id, n] : count)
      targets_[split].push_back(
          {{"scene_id", scene}, {"im_ids", ids}, {"obj_id", id}, {"inst_count", n}});
  }
  void WriteImage(const std::string& split, int scene, int image, const cv::Mat& pixels) {
    const fs::path folder = out_ / split / absl::StrFormat("%06d", scene) / "rgb";
    fs::create_directories(folder);
    cv::imwrite((folder / absl::StrFormat("%06d.png", image)).string(), pixels);
  }
  void WriteTargets() {
    for (const auto& [split, list] : targets_)
      WriteJson(out_ / (split + "_targets_multiview_bop25.json"), list);
  }

 private:
  fs::path out_;
  std::map<std::string, Json> targets_;
};

// What stays from scene to scene.
struct Cell {
  StagedRig rig;
  TableKind kind = TableKind::kBlank;
  PaintedTable table;
  std::vector<LightSource> lights;
};

Cell MakeCell(const Arguments& arguments, double size_m, int cameras, Random* random) {
  Cell cell;
  RigOptions rig;
  rig.cameras = cameras;
  rig.scene_m = kScenePerPart * size_m;
  cell.rig = MakeRig(rig, random);
  cell.kind = static_cast<TableKind>(random->Index(kTableKinds));
  for (int k = 0; k < kTableKinds; ++k) {
    if (arguments.table == NameOf(static_cast<TableKind>(k))) cell.kind = static_cast<TableKind>(k);
  }
  const double contrast =
      cell.kind == TableKind::kBlank ? random->Uniform(0.0, 0.03) : random->Uniform(0.06, 0.25);
  cell.table = MakeTable(cell.kind, contrast, random);
  cell.lights = MakeLights(random);
  return cell;
}

// A table and light for a scene of another.
Cell CellOf(const Arguments& arguments, const BopScene& scene, Random* random) {
  Cell cell = MakeCell(arguments, 0.1, 0, random);
  for (const BopImage& image : scene.images) {
    cell.rig.cameras.push_back(image.camera);
    cell.rig.camera_from_world.push_back(image.camera_from_world);
  }
  return cell;
}

// The scene once more with one camera changed: `changed` differs from the rig in that one alone.
void WriteChanged(const std::string& split,
                  int scene,
                  int camera,
                  const StagedRig& changed,
                  const SceneRenderer& renderer,
                  std::span<const Photograph> before,
                  const CameraLook& look,
                  std::span<const StageablePart> parts,
                  std::span<const StagedPart> standing,
                  Json meta,
                  Writer* writer) {
  SceneFiles files;
  for (int c = 0; c < static_cast<int>(before.size()); ++c) {
    Photograph photograph = before[c];
    if (c == camera)
      photograph = renderer.Take(changed.cameras[c], changed.camera_from_world[c], look);
    writer->WriteImage(split, scene, c, photograph.image);
    files.Add(c, changed.cameras[c], changed.camera_from_world[c], photograph, parts, standing);
  }
  meta["changed_camera"] = camera;
  writer->Write(split, scene, files, std::move(meta));
}

std::vector<StagedPart> DrawParts(const Arguments& arguments,
                                  std::span<const StageablePart> parts,
                                  Random* random) {
  // Half of the scenes show as few parts as there may be: these say least of their cameras.
  const int least = arguments.parts[0], most = arguments.parts[1];
  const int drawn = random->Index(2) == 0 ? least : least + random->Index(most - least + 1);
  return StandParts(parts, drawn, random);
}

void WriteScene(const Arguments& arguments,
                int scene,
                const std::string& tier,
                const Cell& cell,
                std::span<const StageablePart> parts,
                std::span<const StagedPart> standing,
                Random* random,
                Writer* writer) {
  const SceneRenderer renderer(PaintScene(parts, standing, cell.table, cell.lights, random));
  Json meta = {{"tier", tier},
               {"seed", arguments.seed},
               {"table", NameOf(cell.kind)},
               {"num_parts", standing.size()}};
  SceneFiles files;
  std::vector<Photograph> photographs;
  std::vector<CameraLook> looks;
  for (int c = 0; c < static_cast<int>(cell.rig.cameras.size()); ++c) {
    looks.push_back(MakeLook(random));
    photographs.push_back(
        renderer.Take(cell.rig.cameras[c], cell.rig.camera_from_world[c], looks.back()));
    writer->WriteImage("val", scene, c, photographs.back().image);
    files.Add(
        c, cell.rig.cameras[c], cell.rig.camera_from_world[c], photographs.back(), parts, standing);
  }
  writer->Write("val", scene, files, meta);
  if (arguments.independent || !arguments.as.empty() || scene < arguments.first_change ||
      (scene - arguments.first_change) % arguments.change_every != 0) {
    return;
  }
  const int camera = random->Index(static_cast<int>(cell.rig.cameras.size()));
  const Eigen::Vector3d axis =
      Eigen::Vector3d(random->Normal(), random->Normal(), random->Normal()).normalized();
  StagedRig turned = cell.rig, zoomed = cell.rig;
  Rigid3& pose = turned.camera_from_world[camera];
  pose =
      Rigid3{Eigen::AngleAxisd(kTurnRad, axis).toRotationMatrix(), Eigen::Vector3d::Zero()} * pose;
  zoomed.cameras[camera].focal_px *= kZoom;
  for (const auto& [split, rig] : {std::pair{"turned", &turned}, {"zoomed", &zoomed}}) {
    WriteChanged(split,
                 scene,
                 camera,
                 *rig,
                 renderer,
                 photographs,
                 looks[camera],
                 parts,
                 standing,
                 meta,
                 writer);
  }
}

void WriteDrawn(const Arguments& arguments, std::span<const StageablePart> parts, Writer* writer) {
  const double size_m = MedianDiameter(parts);
  Random of_rig(arguments.seed);
  Cell cell;
  if (!arguments.independent) cell = MakeCell(arguments, size_m, arguments.cameras, &of_rig);
  for (int scene = arguments.first_scene; scene < arguments.first_scene + arguments.scenes;
       ++scene) {
    Random random(arguments.seed * 100003u + static_cast<unsigned>(scene));
    if (arguments.independent) cell = MakeCell(arguments, size_m, 3 + random.Index(4), &random);
    const std::vector<StagedPart> standing = DrawParts(arguments, parts, &random);
    const std::string tier = standing.size() == 1 ? "T1" : "T2";
    WriteScene(arguments, scene, tier, cell, parts, standing, &random, writer);
  }
}

// The exit code.
int WriteAs(const Arguments& arguments, std::span<const StageablePart> parts, Writer* writer) {
  const auto ids = ListBopScenes(arguments.dataset, arguments.as);
  if (!ids.ok()) {
    std::cerr << ids.status().message() << "\n";
    return 1;
  }
  for (const int id : *ids) {
    const auto scene = ReadBopScene(arguments.dataset, arguments.as, id);
    if (!scene.ok() || scene->images.empty() || !scene->images[0].has_pose) {
      std::cerr << "scene " << id << ": cannot be read, or has no poses of its cameras\n";
      return 1;
    }
    // Light, colours and noise are the same whatever the table.
    Random of_table(arguments.seed * 100003u + static_cast<unsigned>(id));
    Random random(arguments.seed * 100019u + static_cast<unsigned>(id));
    Cell cell = CellOf(arguments, *scene, &of_table);
    cell.lights = MakeLights(&random);
    const Rigid3 world_from_camera = scene->images[0].camera_from_world.Inverse();
    std::vector<StagedPart> standing;
    for (const BopInstance& instance : scene->images[0].instances) {
      const auto part = std::find_if(
          parts.begin(), parts.end(), [&](const auto& p) { return p.id == instance.obj_id; });
      if (part == parts.end()) continue;
      standing.push_back({static_cast<int>(part - parts.begin()),
                          world_from_camera * instance.camera_from_object});
    }
    WriteScene(arguments, id, scene->tier, cell, parts, standing, &random, writer);
  }
  return 0;
}

int Run(const Arguments& arguments) {
  const auto dataset = ReadBopDataset(arguments.dataset);
  if (!dataset.ok()) {
    std::cerr << dataset.status().message() << "\n";
    return 1;
  }
  std::vector<StageablePart> parts;
  for (const BopObject& object : dataset->objects) {
    // The mesh is what poses are scored with; parts enrolled from CAD differ a little from it.
    const auto read = ImportCad(object.mesh_path.empty() ? object.cad_path : object.mesh_path);
    if (!read.ok()) {
      std::cerr << read.status().message() << "\n";
      return 1;
    }
    auto part = MakeStageable(object.obj_id, read->model.mesh, 0.0);
    if (part.ok()) {
      parts.push_back(*std::move(part));
    } else {
      std::cerr << "object " << object.obj_id << " is left out: " << part.status().message()
                << "\n";
    }
  }
  if (parts.empty()) return 1;
  fs::create_directories(arguments.out);
  for (const char* name : {"models", "cad", "grasps"}) {
    const fs::path from = fs::absolute(fs::path(arguments.dataset) / name);
    if (fs::exists(from) && !fs::exists(fs::path(arguments.out) / name))
      fs::create_directory_symlink(from, fs::path(arguments.out) / name);
  }
  Writer writer(arguments);
  int exit_code = 0;
  if (arguments.as.empty()) {
    WriteDrawn(arguments, parts, &writer);
  } else {
    exit_code = WriteAs(arguments, parts, &writer);
  }
  writer.WriteTargets();
  return exit_code;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Arguments a;
  CLI::App app("Renders scenes of a data set's objects");
  app.add_option("dataset", a.dataset)->required();
  app.add_option("out", a.out)->required();
  app.add_option("--seed", a.seed);
  app.add_option("--scenes", a.scenes);
  app.add_option("--first-scene", a.first_scene);
  app.add_option("--first-change", a.first_change);
  app.add_option("--change-every", a.change_every)->check(CLI::PositiveNumber);
  app.add_option("--cameras", a.cameras)->check(CLI::Range(1, 16));
  app.add_option("--table", a.table)
      ->check(CLI::IsMember({"blank", "mottled", "striped", "speckled"}));
  app.add_option("--parts", a.parts)->delimiter(',')->expected(2);
  app.add_flag("--independent", a.independent);
  app.add_option("--as", a.as, "a split of the data set")->excludes("--independent");
  CLI11_PARSE(app, argc, argv);
  return horopter::Run(a);
}
