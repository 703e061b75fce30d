// Where parts that no answer has are lost in the search on planes: of each true part that the
// linked scene lacks, what places are found for it, and what these and its true pose score beside
// the others; and of all places that are looked at closer, what the decision could be learnt from.
//
//   standing_report DATASET SPLIT [--scenes 1,2] [--cache DIR] [--linked DIR] [--table FILE.csv]
//     --linked  keeps the linked scenes between runs
//     --table   a row for each place that was looked at closer
#include <CLI/CLI.hpp>
#include <chrono>
#include <fstream>
#include <iostream>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "server/vision/matching/ground_motion.h"
#include "server/vision/recognition/aspect_scenes/object_on_plane.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/scene_search.h"
#include "server/vision/recognition/aspect_scenes/standing_grid.h"
#include "server/vision/recognition/aspect_search/find_aspects.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {
namespace {

constexpr double kRightPx = 10.0;  // worst vertex
constexpr double kNearPx = 20.0;   // ... of a place that settling may put right

struct Arguments {
  std::string dataset, split, cache, linked, table;
  std::vector<int> scenes;
  int threads = 2;
};

bool ReadLinked(const std::string& path, LinkedScene* out) {
  std::ifstream in(path);
  std::size_t views = 0, objects = 0;
  if (!(in >> views >> objects)) return false;
  const auto read_pose = [&](Rigid3* p) {
    for (int k = 0; k < 9; ++k) in >> p->R(k / 3, k % 3);
    for (int k = 0; k < 3; ++k) in >> p->t(k);
  };
  out->views.resize(views);
  for (auto& view : out->views) {
    int there = 0;
    in >> there;
    if (!there) continue;
    view.emplace();
    in >> view->camera.width >> view->camera.height >> view->camera.focal_px >> view->camera.cx >>
        view->camera.cy >> view->camera.k1;
    read_pose(&view->camera_from_scene);
  }
  out->objects.resize(objects);
  for (LinkedObject& o : out->objects) {
    in >> o.object >> o.score >> o.competing_score;  // the last: its probability here
    read_pose(&o.scene_from_object);
  }
  return static_cast<bool>(in);
}

void WriteLinked(const std::string& path, const LinkedScene& scene) {
  std::ofstream out(path);
  out.precision(12);
  out << scene.views.size() << " " << scene.objects.size() << "\n";
  const auto write_pose = [&](const Rigid3& p) {
    for (int k = 0; k < 9; ++k) out << " " << p.R(k / 3, k % 3);
    for (int k = 0; k < 3; ++k) out << " " << p.t(k);
    out << "\n";
  };
  for (const auto& view : scene.views) {
    out << view.has_value();
    if (view) {
      out << " " << view->camera.width << " " << view->camera.height << " " << view->camera.focal_px
          << " " << view->camera.cx << " " << view->camera.cy << " " << view->camera.k1;
      write_pose(view->camera_from_scene);
    }
    out << "\n";
  }
  for (const LinkedObject& o : scene.objects) {
    out << o.object << " " << o.score << " " << AspectProbability(o, scene, {});
    write_pose(o.scene_from_object);
  }
}

std::vector<AspectImage> ImagesOf(const Arguments& arguments, const BopScene& scene) {
  std::vector<cv::Mat> images;
  for (const BopImage& view : scene.images)
    images.push_back(cv::imread(view.path, cv::IMREAD_COLOR));
  MatchingOptions matching;
  matching.threads = arguments.threads;
  return MakeAspectImagesOnGround(
      images, FindGround(images, matching), AspectImageOptions{}, arguments.threads);
}

class SceneReport {
 public:
  SceneReport(const Arguments& arguments, const AspectCatalog& catalog, BopScene scene)
      : arguments_(arguments),
        catalog_(catalog),
        scene_(std::move(scene)),
        images_(ImagesOf(arguments, scene_)) {
    options_.threads = arguments.threads;
    for (const AspectImage& image : images_)
      priors_.push_back({NominalCamera(image), kNominalFocalLogSigma});
    none_.resize(images_.size());
  }

  void Run(std::ostream* table) {
    Link();
    AspectScene scene;
    scene.views = linked_.views;
    for (const LinkedObject& o : linked_.objects) {
      if (o.competing_score >= 0.5) scene.objects.push_back({o.object, o.scene_from_object});
    }
    std::cout << absl::StrFormat("scene %d %s: %d of %d views, %d objects\n",
                                 scene_.scene_id,
                                 scene_.tier,
                                 linked_.registered(),
                                 static_cast<int>(images_.size()),
                                 static_cast<int>(scene.objects.size()));
    if (linked_.registered() < 2 || scene.objects.empty()) return;
    const AspectLinkInput input{images_, priors_, none_, catalog_.parts};
    const StopRequested never;
    const SceneObjects objects(input, options_, never);
    const std::vector<StandingPlane> planes =
        PlanesUnder(scene.objects, catalog_.parts, scene.views);
    std::vector<std::vector<StandingCandidate>> found;
    for (const StandingPlane& plane : planes) {
      const auto start = std::chrono::steady_clock::now();
      found.push_back(FindStanding(
          images_, scene.views, catalog_.parts, plane, scene.objects, arguments_.threads));
      std::cout << absl::StrFormat(
          "  plane of %d objects: %d places, %.2f s\n",
          plane.objects,
          static_cast<int>(found.back().size()),
          std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    }
    ReportMissing(scene, objects, planes, found);
    if (table != nullptr) Tabulate(scene, objects, found, table);
  }

 private:
  void Link() {
    const std::string file = absl::StrFormat("%s/%d.txt", arguments_.linked, scene_.scene_id);
    if (!arguments_.linked.empty() && ReadLinked(file, &linked_)) return;
    const auto search_view = [&](int v) {
      FindAspectOptions find;
      find.threads = find.votes.threads = arguments_.threads;
      return FindAspectHypotheses(images_[v], catalog_.index, find).hypotheses;
    };
    linked_ = SearchScene({images_, priors_, none_, catalog_.parts, search_view}, options_);
    for (LinkedObject& o : linked_.objects) o.competing_object = -1;
    if (!arguments_.linked.empty()) WriteLinked(file, linked_);
    for (LinkedObject& o : linked_.objects) o.competing_score = AspectProbability(o, linked_, {});
  }

  // Middle of the views' worst vertices against the nearest true pose of that part; infinite
  // where there is none.
  double ErrorPx(const AspectSceneObject& placed) const {
    std::vector<double> errors;
    for (std::size_t v = 0; v < images_.size(); ++v) {
      if (!linked_.views[v]) continue;
      double least = std::numeric_limits<double>::infinity();
      for (const BopInstance& truth : scene_.images[v].instances) {
        if (truth.obj_id != catalog_.obj_ids[placed.object]) continue;
        least =
            std::min(least,
                     WorstVertexPx(catalog_.models[placed.object],
                                   linked_.views[v]->camera,
                                   linked_.views[v]->camera_from_scene * placed.scene_from_object,
                                   scene_.images[v].camera,
                                   truth.camera_from_object));
      }
      errors.push_back(least);
    }
    std::sort(errors.begin(), errors.end());
    return errors[errors.size() / 2];
  }

  LinkedObject Judged(const AspectScene& scene,
                      const SceneObjects& objects,
                      const AspectSceneObject& placed,
                      double render_px) const {
    AspectScene with = scene;
    with.objects.push_back(placed);
    std::vector<LinkedObject> judged = objects.Judge(with, render_px);
    objects.FindLying(with.views, &judged, 1.8);
    LinkedScene measured;
    measured.views = scene.views;
    measured.objects = judged;
    objects.MeasureSurfaces(&measured);
    return measured.objects.back();
  }

  void ReportMissing(const AspectScene& scene,
                     const SceneObjects& objects,
                     const std::vector<StandingPlane>& planes,
                     const std::vector<std::vector<StandingCandidate>>& found) const {
    std::size_t first = 0;
    while (!linked_.views[first]) ++first;
    for (const BopInstance& truth : scene_.images[first].instances) {
      const auto part = std::find(catalog_.obj_ids.begin(), catalog_.obj_ids.end(), truth.obj_id);
      if (part == catalog_.obj_ids.end()) continue;
      const int number = static_cast<int>(part - catalog_.obj_ids.begin());
      const bool known =
          std::any_of(scene.objects.begin(), scene.objects.end(), [&](const AspectSceneObject& o) {
            return o.object == number && ErrorPx(o) < kRightPx;
          });
      if (known) continue;
      const RenderMesh& mesh = catalog_.parts[number].object->mesh;
      AspectSceneObject there{
          number, linked_.views[first]->camera_from_scene.Inverse() * truth.camera_from_object};
      const double before = ErrorPx(there);
      if (const auto settled = SettleInViews(images_, mesh, scene.views, there, kFineRenderPx))
        there = settled->placed;
      const LinkedObject judged = Judged(scene, objects, there, kFineRenderPx);
      std::cout << absl::StrFormat(
          "  missing %d: %.1f px off, settled %.1f px; score %.3f precision %.3f surface %.2f of "
          "%d%s; quick %.3f\n",
          truth.obj_id,
          before,
          ErrorPx(there),
          judged.score,
          judged.precision,
          judged.surface,
          judged.surface_pairs,
          judged.lies ? ", lies" : "",
          objects.JudgeOne(scene.views, there).score);
      for (std::size_t p = 0; p < planes.size(); ++p) {
        ReportPlace(scene, planes[p], there);
        ReportFound(scene, objects, found[p], number);
      }
    }
  }

  // What the search says of the true place.
  void ReportPlace(const AspectScene& scene,
                   const StandingPlane& plane,
                   const AspectSceneObject& there) const {
    const StandingGround ground =
        MakeGround(images_, scene.views, plane, scene.objects, catalog_.parts);
    const ObjectOnPlane object(ground, catalog_.parts[there.object]);
    const Eigen::Vector3d center =
        there.scene_from_object * catalog_.parts[there.object].object->mesh.center.cast<double>();
    StandingPlace best;
    double nearest = 10.0;
    for (std::size_t f = 0; f < object.faces().size(); ++f) {
      for (double yaw = 0.0; yaw < 2 * std::numbers::pi; yaw += 0.01) {
        const Eigen::Matrix3d rotation = object.RotationOf(static_cast<int>(f), yaw);
        for (const Rigid3& turn : Turns(there.object)) {
          const double apart = (rotation * turn.R - there.scene_from_object.R).norm();
          if (apart >= nearest) continue;
          nearest = apart;
          best = {0.0, 0.0, yaw, static_cast<int>(f), 0.0};
        }
      }
    }
    const Eigen::Vector3d off = center - object.CenterOf(best.face, 0.0, 0.0, best.yaw);
    best.x = off.dot(ground.e1);
    best.y = off.dot(ground.e2);
    const auto inside = best.x > ground.low.x() && best.y > ground.low.y() &&
                        best.x < ground.high.x() && best.y < ground.high.y();
    std::cout << absl::StrFormat(
        "    face %d of %d, turned %.3f off, height %.1f mm off, %s; support %.3f %.3f %.3f\n",
        best.face,
        static_cast<int>(object.faces().size()),
        nearest,
        1000 * off.dot(plane.normal),
        inside ? "inside" : "OUTSIDE",
        object.Judge(best, 0.16),
        object.Judge(best, 0.08),
        object.Judge(best, 0.04));
    ReportGrid(object, best);
  }

  // Where the true place comes among those of the grid, by what is nearest to it.
  void ReportGrid(const ObjectOnPlane& object, const StandingPlace& truth) const {
    std::vector<StandingPlace> places;
    for (std::size_t f = 0; f < object.faces().size(); ++f) {
      const auto of_face = SearchFace(object, static_cast<int>(f), {});
      places.insert(places.end(), of_face.begin(), of_face.end());
    }
    std::sort(places.begin(), places.end(), [](const auto& a, const auto& b) {
      return a.support > b.support;
    });
    for (std::size_t i = 0; i < places.size(); ++i) {
      const StandingPlace& p = places[i];
      if (p.face != truth.face ||
          std::hypot(p.x - truth.x, p.y - truth.y) > 0.15 * object.diameter_m() ||
          std::abs(std::remainder(p.yaw - truth.yaw, object.faces()[p.face].yaw_range)) > 0.3)
        continue;
      std::cout << absl::StrFormat("    in the grid %d of %d, support %.3f, best %.3f\n",
                                   static_cast<int>(i),
                                   static_cast<int>(places.size()),
                                   p.support,
                                   places.front().support);
      return;
    }
    std::cout << absl::StrFormat("    not in the grid of %d places, best %.3f\n",
                                 static_cast<int>(places.size()),
                                 places.empty() ? 0.0 : places.front().support);
  }

  std::vector<Rigid3> Turns(int number) const {
    std::vector<Rigid3> out = {Rigid3{}};
    const auto& more = catalog_.parts[number].symmetries;
    out.insert(out.end(), more.begin(), more.end());
    return out;
  }

  void ReportFound(const AspectScene& scene,
                   const SceneObjects& objects,
                   const std::vector<StandingCandidate>& found,
                   int number) const {
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t rank = 0; rank < found.size(); ++rank) {
      const StandingCandidate& c = found[rank];
      if (c.placed.object != number) continue;
      const double error = ErrorPx(c.placed);
      nearest = std::min(nearest, error);
      AspectSceneObject settled = c.placed;
      if (const auto s = SettleInViews(
              images_, catalog_.parts[number].object->mesh, scene.views, c.placed, kFineRenderPx))
        settled = s->placed;
      const LinkedObject judged = Judged(scene, objects, settled, kFineRenderPx);
      std::cout << absl::StrFormat(
          "      place %d support %.3f %.1f px off, settled %.1f px off, %s%s; score %.3f quick "
          "%.3f surface %.2f%s\n",
          static_cast<int>(rank),
          c.support,
          error,
          ErrorPx(settled),
          objects.IsFree(scene.views, scene.objects, c.placed) ? "" : "NOT FREE ",
          objects.Settled(scene.views, c.placed) ? "asked" : "NOT MET",
          judged.score,
          objects.JudgeOne(scene.views, settled).score,
          judged.surface,
          judged.lies ? ", lies" : "");
    }
    if (nearest > kNearPx) std::cout << "      NOT LISTED\n";
  }

  // As faint objects are looked at (faint_objects.cc), but all that come near.
  void Tabulate(const AspectScene& known,
                const SceneObjects& objects,
                const std::vector<std::vector<StandingCandidate>>& found,
                std::ostream* table) const {
    constexpr double kLeast = 0.18;
    std::vector<AspectSceneObject> candidates;
    for (const auto& of_plane : found) {
      for (std::size_t i = 0; i < of_plane.size() && i < 56; ++i)
        candidates.push_back(of_plane[i].placed);
    }
    AspectScene scene = known;
    std::vector<LinkedObject> there = objects.Judge(known, kQuickRenderPx);
    LinkedScene linked;
    linked.views = known.views;
    linked.objects = there;
    const SceneLayers hiding = objects.HidingLayers(linked);
    std::vector<const std::vector<ObjectLayer>*> others;
    for (const auto& layers : hiding) others.push_back(&layers);
    objects.Place(std::move(candidates), kLeast, &scene);
    for (std::size_t i = known.objects.size(); i < scene.objects.size(); ++i) {
      AspectSceneObject& o = scene.objects[i];
      if (const auto settled = SettleInViews(images_,
                                             catalog_.parts[o.object].object->mesh,
                                             scene.views,
                                             o,
                                             kFineRenderPx,
                                             0.0,
                                             others))
        o = settled->placed;
    }
    linked.objects = objects.Judge(scene, kFineRenderPx);
    objects.FindLying(scene.views, &linked.objects, 1.8);
    for (std::size_t i = known.objects.size(); i < linked.objects.size(); ++i) {
      LinkedScene one = linked;
      one.objects.resize(known.objects.size());
      one.objects.push_back(linked.objects[i]);
      objects.MeasureSurfaces(&one);
      const LinkedObject& o = one.objects.back();
      double recall = 0.0, support = 0.0, visible = 0.0, hidden = 0.0, claimed = 0.0, least = 1.0;
      const auto n =
          std::max(1.0, static_cast<double>(std::count(o.shown.begin(), o.shown.end(), true)));
      for (std::size_t v = 0; v < o.views.size(); ++v) {
        if (!o.shown[v]) continue;
        recall += o.views[v].recall / n;
        support += o.views[v].support_px / n;
        visible += o.views[v].visible_px / n;
        hidden += o.views[v].hidden_px / n;
        claimed += o.views[v].claimed_px / n;
        least = std::min(least, o.views[v].score);
      }
      *table << absl::StrFormat(
          "%d,%d,%.4f,%.4f,%.4f,%.1f,%.1f,%.1f,%.1f,%.4f,%.4f,%d,%d,%.1f,%.0f,%d\n",
          scene_.scene_id,
          catalog_.obj_ids[o.object],
          o.score,
          o.precision,
          recall,
          support,
          visible,
          hidden,
          claimed,
          least,
          o.surface,
          o.surface_pairs,
          o.lies ? 1 : 0,
          std::min(999.0, ErrorPx(scene.objects[i])),
          n,
          static_cast<int>(known.objects.size()));
    }
    table->flush();
  }

  const Arguments& arguments_;
  const AspectCatalog& catalog_;
  BopScene scene_;
  std::vector<AspectImage> images_;
  std::vector<AspectViewPrior> priors_;
  std::vector<std::vector<AspectHypothesis>> none_;
  AspectLinkOptions options_;
  LinkedScene linked_;
};

absl::Status Run(const Arguments& arguments) {
  auto dataset = ReadBopDataset(arguments.dataset);
  if (!dataset.ok()) return dataset.status();
  AspectCatalog catalog;
  if (absl::Status s = LoadAspectCatalog(*dataset, arguments.cache, &catalog); !s.ok()) return s;
  const auto ids = ScenesOf(arguments.dataset, arguments.split, arguments.scenes);
  if (!ids.ok()) return ids.status();
  std::ofstream table;
  if (!arguments.table.empty()) {
    table.open(arguments.table);
    table << "scene,object,score,precision,recall,support_px,visible_px,hidden_px,claimed_px,least,"
             "surface,pairs,lies,error_px,shown,known\n";
  }
  for (const int id : *ids) {
    auto read = ReadBopScene(arguments.dataset, arguments.split, id);
    if (!read.ok()) return read.status();
    SceneReport(arguments, catalog, *std::move(read)).Run(table.is_open() ? &table : nullptr);
    std::cout << std::flush;
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Arguments arguments;
  CLI::App app("Parts that the search on planes finds or not");
  app.add_option("DATASET", arguments.dataset)->required();
  app.add_option("SPLIT", arguments.split)->required();
  app.add_option("--scenes", arguments.scenes)->delimiter(',');
  app.add_option("--cache", arguments.cache);
  app.add_option("--linked", arguments.linked);
  app.add_option("--table", arguments.table);
  app.add_option("--threads", arguments.threads);
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = horopter::Run(arguments);
  if (!status.ok()) {
    std::cerr << status.ToString() << "\n";
    return 1;
  }
  return 0;
}
