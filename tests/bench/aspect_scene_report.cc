// Scenes found by the aspects of their parts alone, no table and no calibration: the answers as BOP
// results, and of each object what the decision is learnt from.
//
//   aspect_scene_report DATASET SPLIT --out RESULTS.csv [--scenes 1,2] [--cache DIR]
//                       [--hypotheses DIR] [--threads N] [--bar S]
//     --cache       keeps what was derived of the parts between runs
//     --hypotheses  keeps the hypotheses of the images between runs
//     --bar         least joint score that is written (default 0: all)
//     --least       least joint score of objects that are kept and said
//     (AspectLinkOptions::min_joint)
//     --standing    AspectLinkOptions::standing
//     --max-width   AspectImageOptions::max_width_px
//     --as-needed   views are searched for all parts only as linking asks for them, as in a
//     request;
//                   without: all are
//     --overlays    DIR: what cameras should see of the true poses, one file an image: found edges
//     green
//                   (contours) and cyan (creases), missing ones red and orange
//     --on-ground   edges that move with the supporting plane, where its texture is matched, are
//                   dropped
//     --cues        FILE: what the decision is learnt from, a line an object (decision_cues.h);
//                   fit_aspect_decision.py reads them
//     --max-images  of a scene, the first ones
//     --all-trials  each scene with all its parts, with one left out in turn, and with none
//     --without-truth  the scene's own parts are not looked for: all that is found is wrong
//     --leave-one-out  each of the scene's parts in turn is not looked for: what stands in its
//     place
//                      is its look-alike
#include <CLI/CLI.hpp>
#include <chrono>
#include <fstream>
#include <iostream>
#include <limits>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "client/bop_results.h"
#include "server/vision/recognition/aspect_scenes/scene_search.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "server/vision/recognition/interpretation/decision_cues.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "tests/bench/aspect_catalog.h"
#include "tests/bench/searched_scene.h"

namespace horopter {
namespace {

constexpr double kRightPx = 14.0;  // of a hypothesis, worst vertex

struct Arguments {
  std::string dataset, split, out, cache, overlays, cues;
  std::vector<int> scenes;
  double bar = 0.0;
  double least = AspectLinkOptions{}.min_joint;
  int standing = AspectLinkOptions{}.standing;
  SceneSearchOptions search;
  bool as_needed = false;
  bool without_truth = false;
  bool leave_one_out = false;
  bool all_trials = false;
};

double Seconds(std::chrono::steady_clock::time_point since) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count();
}

// Log odds of the nearest true pose of the object's kind, carried into the scene by the first view
// that is registered, against the answer's.
double LogOddsOfTruth(const std::vector<BopImage>& images,
                      const std::vector<AspectImage>& edges,
                      const AspectCatalog& catalog,
                      const LinkedScene& linked,
                      const LinkedObject& o) {
  std::vector<std::optional<CalibratedCamera>> views;
  std::optional<Rigid3> truth;
  for (std::size_t v = 0; v < images.size(); ++v) {
    views.emplace_back();
    if (!linked.views[v]) continue;
    views[v] = CalibratedCamera{linked.views[v]->camera, linked.views[v]->camera_from_scene};
    if (truth) continue;
    const Rigid3 scene_from_camera = linked.views[v]->camera_from_scene.Inverse();
    for (const BopInstance& instance : images[v].instances) {
      if (instance.obj_id != catalog.obj_ids[o.object]) continue;
      const Rigid3 pose = scene_from_camera * instance.camera_from_object;
      if (!truth ||
          (pose.t - o.scene_from_object.t).norm() < (truth->t - o.scene_from_object.t).norm())
        truth = pose;
    }
  }
  if (!truth) return 0.0;
  // Only the turn is asked for: where the truth lies in these cameras is not known well enough.
  const RenderMesh& mesh = catalog.parts[o.object].object->mesh;
  const Eigen::Vector3d center = mesh.center.cast<double>();
  Rigid3 turned = *truth;
  turned.t += o.scene_from_object * center - *truth * center;
  return LogOddsOfPose(edges, views, mesh, turned, mesh, o.scene_from_object, {});
}

// How an object lies on the plane under the better ones: the face it would rest on nearest.
struct Contact {
  double tilt_deg = -1.0, height_mm = 0.0;  // -1: no plane, or no face within a quarter turn
};
Contact ContactOf(const AspectCatalog& catalog, const LinkedScene& linked, std::size_t object) {
  std::vector<AspectSceneObject> better;
  for (std::size_t i = 0; i < object; ++i)
    better.push_back({linked.objects[i].object, linked.objects[i].scene_from_object});
  Contact out;
  double least = std::numeric_limits<double>::infinity();
  const LinkedObject& o = linked.objects[object];
  for (const StandingPlane& plane : PlanesUnder(better, catalog.parts, linked.views)) {
    for (const RestingFace& face : catalog.parts[o.object].resting) {
      const double cosine = plane.normal.dot(o.scene_from_object.R * face.up);
      if (cosine <= 0.0) continue;
      const double tilt_deg = std::acos(std::min(1.0, cosine)) * 180.0 / std::numbers::pi;
      const double height_mm =
          1000 * (plane.normal.dot(o.scene_from_object.t) - face.height_m - plane.offset_m);
      if (tilt_deg + std::abs(height_mm) > least) continue;
      least = tilt_deg + std::abs(height_mm);
      out = {tilt_deg, height_mm};
    }
  }
  return out;
}

// A line of --cues.
void WriteCues(const SearchedScene& searched,
               const std::string& trial,
               const AspectCatalog& catalog,
               const LinkedScene& linked,
               std::size_t object,
               bool right,
               std::ostream* out) {
  const int obj_id = catalog.obj_ids[linked.objects[object].object];
  const auto& there = searched.scene.images.front().instances;
  const bool in_scene = std::any_of(
      there.begin(), there.end(), [&](const BopInstance& i) { return i.obj_id == obj_id; });
  *out << absl::StrFormat("%d,%s,%s,%d,%d,%d,%.4f",
                          searched.scene.scene_id,
                          searched.scene.tier,
                          trial,
                          obj_id,
                          right ? 1 : 0,
                          in_scene ? 1 : 0,
                          AspectProbability(linked.objects[object], linked, {}));
  for (const double value : CuesOf(linked.objects[object], linked))
    *out << absl::StrFormat(",%.4g", value);
  *out << "\n";
}

void ReportScene(const SearchedScene& searched,
                 const std::string& trial,
                 std::ostream* cues,
                 const AspectCatalog& catalog,
                 const LinkedScene& linked) {
  const std::vector<BopImage>& images = searched.scene.images;
  const std::vector<AspectImage>& edges = searched.images;
  for (std::size_t i = 0; i < linked.objects.size(); ++i) {
    const LinkedObject& o = linked.objects[i];
    int right = 0, wrong = 0;
    double worst_score = 1.0;
    std::vector<double> errors;
    for (std::size_t v = 0; v < images.size(); ++v) {
      if (!linked.views[v]) continue;
      double error = std::numeric_limits<double>::infinity();
      for (const BopInstance& truth : images[v].instances) {
        if (truth.obj_id != catalog.obj_ids[o.object]) continue;
        error = std::min(error,
                         WorstVertexPx(catalog.models[o.object],
                                       linked.views[v]->camera,
                                       linked.views[v]->camera_from_scene * o.scene_from_object,
                                       images[v].camera,
                                       truth.camera_from_object));
      }
      errors.push_back(error);
      ++(error < 10.0 ? right : wrong);
      if (o.shown[v]) worst_score = std::min(worst_score, o.views[v].score);
    }
    std::sort(errors.begin(), errors.end());
    if (cues != nullptr) WriteCues(searched, trial, catalog, linked, i, right > wrong, cues);
    const Contact contact = ContactOf(catalog, linked, i);
    double recall = 0.0, support_px = 0.0, hidden_px = 0.0, claimed_px = 0.0;
    const auto shown = static_cast<double>(std::count(o.shown.begin(), o.shown.end(), true));
    for (std::size_t v = 0; v < images.size(); ++v) {
      if (!o.shown[v]) continue;
      recall += o.views[v].recall / shown;
      support_px += o.views[v].support_px / shown;
      hidden_px += o.views[v].hidden_px / shown;
      claimed_px += o.views[v].claimed_px / shown;
    }
    std::cout << absl::StrFormat(
        "  object %d score %.3f probability %.2f precision %.3f competing %.3f worst %.3f: right "
        "in %d of %d views, "
        "median %.1f px%s, log odds of the true turn %.1f, contact %.1f deg %.1f mm, size %.0f "
        "mm, recall %.3f, support %.0f px, hidden %.0f px, claimed %.0f px, shown in %.0f, surface "
        "%.2f of %d%s\n",
        catalog.obj_ids[o.object],
        o.score,
        AspectProbability(o, linked, {}),
        o.precision,
        o.competing_score,
        worst_score,
        right,
        right + wrong,
        errors.empty() ? 0.0 : errors[errors.size() / 2],
        right > wrong ? "" : " WRONG",
        LogOddsOfTruth(images, edges, catalog, linked, o),
        contact.tilt_deg,
        contact.height_mm,
        1000 * catalog.parts[o.object].object->mesh.diameter_m,
        recall,
        support_px,
        hidden_px,
        claimed_px,
        shown,
        o.surface,
        o.surface_pairs,
        o.lies    ? ", lies"
        : o.level ? ", level"
                  : "");
  }
}

// What the true poses would score under the true cameras: parts below the bar are hidden or faint.
void ReportTruth(const std::vector<BopImage>& images,
                 const std::vector<AspectImage>& edges,
                 const std::vector<std::vector<AspectHypothesis>>& hypotheses,
                 const AspectCatalog& catalog) {
  std::vector<std::optional<AspectSceneView>> views;
  for (const BopImage& image : images) {
    const Rigid3 first = images.front().instances.empty()
                             ? Rigid3{}
                             : images.front().instances.front().camera_from_object;
    const Rigid3 here =
        image.instances.empty() ? Rigid3{} : image.instances.front().camera_from_object;
    views.push_back(AspectSceneView{image.camera, here * first.Inverse(), 0.0, 0.35});
  }
  for (const BopInstance& truth : images.front().instances) {
    const auto part = std::find(catalog.obj_ids.begin(), catalog.obj_ids.end(), truth.obj_id);
    if (part == catalog.obj_ids.end()) continue;
    const int number = static_cast<int>(part - catalog.obj_ids.begin());
    const LinkedObject o = JudgeInViews(
        edges, catalog.parts[number].object->mesh, views, {number, truth.camera_from_object});
    std::cout << absl::StrFormat("  truth %d score %.3f:", truth.obj_id, o.score);
    for (const AspectScore& s : o.views)
      std::cout << absl::StrFormat(" %.2f (p %.2f r %.2f)", s.score, s.precision, s.recall);
    std::cout << "; listed";
    for (std::size_t v = 0; v < images.size(); ++v) {
      std::size_t rank = 0;
      const auto& list = hypotheses[v];
      const auto pose = [&] {
        const Rigid3 here = views[v]->camera_from_scene * truth.camera_from_object;
        return here;
      }();
      while (rank < list.size() &&
             (list[rank].object != number || WorstVertexPx(catalog.models[number],
                                                           list[rank].camera,
                                                           list[rank].camera_from_object,
                                                           images[v].camera,
                                                           pose) > kRightPx)) {
        ++rank;
      }
      std::cout << (rank < list.size()
                        ? absl::StrFormat(" %d (%.2f)", static_cast<int>(rank), list[rank].score)
                        : " -");
    }
    std::cout << "\n";
  }
}

void WriteOverlay(const std::string& file,
                  const BopImage& view,
                  const AspectImage& image,
                  const AspectCatalog& catalog) {
  constexpr int kLarger = 2;  // times the working size
  cv::Mat out = cv::imread(view.path, cv::IMREAD_COLOR);
  cv::resize(out, out, cv::Size(kLarger * image.width, kLarger * image.height));
  for (const BopInstance& truth : view.instances) {
    const auto part = std::find(catalog.obj_ids.begin(), catalog.obj_ids.end(), truth.obj_id);
    if (part == catalog.obj_ids.end()) continue;
    const RenderMesh& mesh = catalog.parts[part - catalog.obj_ids.begin()].object->mesh;
    const VisibleEdges edges =
        WorkingEdges(image, mesh, view.camera, truth.camera_from_object, 200.0);
    for (const VisibleEdgePoint& p : edges.points) {
      const bool crease = p.kind == VisibleEdgeKind::kCrease;
      const bool found =
          image.DistanceAt(p.image.x(), p.image.y(), AspectBin(p.tangent.x(), p.tangent.y())) <
          2.0f * AspectImage::kDistanceScale;
      const cv::Scalar color = found ? (crease ? cv::Scalar(255, 255, 0) : cv::Scalar(0, 255, 0))
                                     : (crease ? cv::Scalar(0, 140, 255) : cv::Scalar(0, 0, 255));
      cv::circle(out,
                 cv::Point(static_cast<int>(kLarger * (p.image.x() + 0.5f)),
                           static_cast<int>(kLarger * (p.image.y() + 0.5f))),
                 1,
                 color,
                 cv::FILLED);
    }
  }
  cv::imwrite(file, out);
}

// The scene's parts, or one of them, are not looked for.
void HideParts(const std::vector<int>& obj_ids,
               const AspectCatalog& catalog,
               std::vector<AspectModel>* parts,
               std::vector<std::vector<AspectHypothesis>>* hypotheses) {
  std::vector<bool> there(parts->size(), false);
  for (std::size_t p = 0; p < there.size(); ++p)
    there[p] = std::count(obj_ids.begin(), obj_ids.end(), catalog.obj_ids[p]) > 0;
  for (std::size_t p = 0; p < there.size(); ++p) {
    if (there[p]) (*parts)[p].resting.clear();
  }
  for (auto& list : *hypotheses)
    std::erase_if(list, [&](const AspectHypothesis& h) { return there[h.object]; });
}

// The parts that are not looked for, one list a trial.
std::vector<std::vector<int>> HiddenParts(const Arguments& arguments, const BopScene& scene) {
  std::set<int> own;
  for (const BopInstance& truth : scene.images.front().instances) own.insert(truth.obj_id);
  std::vector<std::vector<int>> out;
  if (arguments.all_trials) out = {{}, {own.begin(), own.end()}};
  if (arguments.leave_one_out || (arguments.all_trials && own.size() > 1)) {
    for (const int obj_id : own) out.push_back({obj_id});
  } else if (!arguments.all_trials) {
    out.emplace_back();
    if (arguments.without_truth) out.back().assign(own.begin(), own.end());
  }
  return out;
}

void ReportLinks(const SearchedScene& searched, const LinkedScene& linked, double linking_s) {
  std::string focal, of_views;
  for (std::size_t v = 0; v < linked.views.size(); ++v) {
    focal += linked.views[v] ? absl::StrFormat(" %+.1f%%",
                                               100 * (linked.views[v]->camera.focal_px /
                                                          searched.scene.images[v].camera.focal_px -
                                                      1))
                             : " -";
  }
  for (const auto& v : linked.agreement.surface.views)
    of_views += (of_views.empty() ? "" : " ") + (v ? absl::StrFormat("%.2f", *v) : "-");
  std::cout << absl::StrFormat(
      "scene %d %s: %d of %d views, score %.2f, focal%s, surface %.2f (%s), ground %.2f of %.1f; "
      "linking %.1f s\n",
      searched.scene.scene_id,
      searched.scene.tier,
      linked.registered(),
      static_cast<int>(linked.views.size()),
      linked.score,
      focal,
      linked.agreement.surface.mean,
      of_views,
      linked.agreement.ground,
      linked.agreement.texture,
      linking_s);
}

void AddResults(const SearchedScene& searched,
                const AspectCatalog& catalog,
                const LinkedScene& linked,
                double bar,
                double seconds,
                BopResults* results) {
  const int scene_id = searched.scene.scene_id;
  for (const LinkedObject& o : linked.objects) {
    if (o.score < bar) continue;
    for (std::size_t v = 0; v < linked.views.size(); ++v) {
      if (!linked.views[v]) continue;
      const int im_id = searched.scene.images[v].im_id;
      results->estimates.push_back({scene_id,
                                    im_id,
                                    catalog.obj_ids[o.object],
                                    o.score,
                                    linked.views[v]->camera_from_scene * o.scene_from_object,
                                    seconds});
      results->cameras[scene_id][im_id] = linked.views[v]->camera.K();
    }
  }
}

// One scene without the hidden parts.
void LinkWithout(const std::vector<int>& hidden,
                 const Arguments& arguments,
                 const AspectCatalog& catalog,
                 const SearchedScene& searched,
                 std::ostream* cues,
                 BopResults* results) {
  const auto start = std::chrono::steady_clock::now();
  std::vector<AspectModel> parts = catalog.parts;
  std::vector<std::vector<AspectHypothesis>> hypotheses = searched.hypotheses;
  HideParts(hidden, catalog, &parts, &hypotheses);
  std::string trial = hidden.empty() ? "with" : "without";
  for (const int obj_id : hidden) trial += absl::StrFormat(" %d", obj_id);
  if (!hidden.empty()) std::cout << "   " << trial << "\n";
  AspectLinkOptions options;
  options.threads = arguments.search.threads;
  options.standing = arguments.standing;
  options.min_quick += arguments.least - options.min_joint;
  options.min_joint = arguments.least;
  const std::vector<std::vector<AspectHypothesis>> none(searched.images.size());
  int views_searched = 0;
  AspectLinkInput input{searched.images, searched.priors, none, parts, [&](int v) {
                          ++views_searched;
                          return hypotheses[v];
                        }};
  if (!arguments.as_needed) input = {searched.images, searched.priors, hypotheses, parts};
  const LinkedScene linked = SearchScene(input, options);
  if (arguments.as_needed)
    std::cout << "   searched " << views_searched << " of " << searched.images.size() << "\n";
  ReportLinks(searched, linked, Seconds(start));
  ReportScene(searched, trial, cues, catalog, linked);
  ReportTruth(searched.scene.images, searched.images, hypotheses, catalog);
  std::cout << std::flush;
  if (cues != nullptr) cues->flush();
  AddResults(searched, catalog, linked, arguments.bar, Seconds(start), results);
}

absl::Status Run(const Arguments& arguments) {
  auto dataset = ReadBopDataset(arguments.dataset);
  if (!dataset.ok()) return dataset.status();
  AspectCatalog catalog;
  if (absl::Status s = LoadAspectCatalog(*dataset, arguments.cache, &catalog); !s.ok()) return s;
  const auto ids = ScenesOf(arguments.dataset, arguments.split, arguments.scenes);
  if (!ids.ok()) return ids.status();
  std::ofstream cues;
  if (!arguments.cues.empty()) {
    cues.open(arguments.cues);
    cues << "scene,tier,trial,object,right,in_scene,probability";
    for (const std::string_view name : CueNames()) cues << "," << name;
    cues << "\n";
  }
  BopResults results;
  for (const int id : *ids) {
    auto read = ReadBopScene(arguments.dataset, arguments.split, id);
    if (!read.ok()) return read.status();
    const SearchedScene searched = SearchImages(arguments.search, catalog, *std::move(read));
    for (std::size_t v = 0; !arguments.overlays.empty() && v < searched.images.size(); ++v) {
      const BopImage& image = searched.scene.images[v];
      WriteOverlay(absl::StrFormat("%s/%d_%d.png", arguments.overlays, id, image.im_id),
                   image,
                   searched.images[v],
                   catalog);
    }
    for (const std::vector<int>& hidden : HiddenParts(arguments, searched.scene))
      LinkWithout(hidden, arguments, catalog, searched, cues.is_open() ? &cues : nullptr, &results);
  }
  return WriteBopResults(results, arguments.out);
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Arguments arguments;
  CLI::App app("Scenes found by the aspects of their parts");
  app.add_option("DATASET", arguments.dataset)->required();
  app.add_option("SPLIT", arguments.split)->required();
  app.add_option("--out", arguments.out)->required();
  app.add_option("--scenes", arguments.scenes)->delimiter(',');
  app.add_option("--cache", arguments.cache);
  app.add_option("--hypotheses", arguments.search.hypotheses);
  app.add_option("--threads", arguments.search.threads);
  app.add_option("--overlays", arguments.overlays);
  app.add_option("--bar", arguments.bar);
  app.add_option("--least", arguments.least);
  app.add_option("--standing", arguments.standing);
  app.add_option("--max-width", arguments.search.image.max_width_px);
  app.add_flag("--as-needed", arguments.as_needed);
  app.add_flag("--on-ground", arguments.search.on_ground);
  app.add_flag("--without-truth", arguments.without_truth);
  app.add_flag("--leave-one-out", arguments.leave_one_out);
  app.add_flag("--all-trials", arguments.all_trials);
  app.add_option("--cues", arguments.cues);
  app.add_option("--max-images", arguments.search.max_images);
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = horopter::Run(arguments);
  if (!status.ok()) {
    std::cerr << status.ToString() << "\n";
    return 1;
  }
  return 0;
}
