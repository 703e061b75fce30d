// Parts looked for under cameras that are known but for their unit: the true ones, disturbed, or
// those that the images' texture gives.
//
//   camera_search_report DATASET SPLIT [--scenes 1,2] [--texture] [--turn DEG] [--focal SHARE]
//                        [--cache DIR]
//                        [--hypotheses DIR] [--catalog DATASET] [--overlays DIR] [--max-width N]
//                        [--threads N]
//     --texture     cameras that the texture gives, where they are trusted
//     --turn, --focal  deviations of the cameras given (true_cameras.h)
//     --cache, --hypotheses  keep what was derived of the parts, and what images alone show
//     --catalog     parts that are looked for instead of the scene's: all that is found is wrong
//     --overlays    what is found over the images, one file an image
//     --max-width   px of the images that are searched
//
// Of each part and image the error (px, worst vertex) of the hypothesis that ranks first, of the
// best one listed, and of what was found; of each placement found a line "placed" of what speaks
// for it: its numbers are what the decision under known cameras is fitted to
// (fit_camera_decision.py).
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <iostream>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/vision/matching/matching_options.h"
#include "server/vision/matching/texture_matching.h"
#include "server/vision/recognition/aspect_scenes/camera_search.h"
#include "server/vision/reconstruction/texture_route.h"
#include "tests/bench/aspect_catalog.h"
#include "tests/bench/searched_scene.h"
#include "tests/bench/true_cameras.h"

namespace horopter {
namespace {

constexpr int kForeign = 1000;  // added to the numbers of parts that are in no scene
constexpr double kRightPx = 10.0;

struct Arguments {
  std::string dataset, split, catalog, cache, overlays;
  std::vector<int> scenes;
  double turn_deg = 0.5, focal_share = 0.03;
  bool texture = false;
  SceneSearchOptions search;
};

// Worst vertex of a pose against the nearest true one of its part, px.
double ErrorOf(const BopImage& image,
               const AspectCatalog& catalog,
               int object,
               const PinholeCamera& camera,
               const Rigid3& pose) {
  double error = std::numeric_limits<double>::infinity();
  for (const BopInstance& truth : image.instances) {
    if (truth.obj_id != catalog.obj_ids[object]) continue;
    error =
        std::min(error,
                 WorstVertexPx(
                     catalog.models[object], camera, pose, image.camera, truth.camera_from_object));
  }
  return error;
}

std::string Px(double error) {
  return error < 1e6 ? absl::StrFormat(" %.0f", error) : " -";
}

// What single images show of a part: the first and the best of each list.
void ReportListed(const SearchedScene& searched, const AspectCatalog& catalog, int object) {
  std::string first, best;
  for (std::size_t v = 0; v < searched.images.size(); ++v) {
    std::vector<double> errors;
    for (const AspectHypothesis& h : searched.hypotheses[v]) {
      if (h.object == object)
        errors.push_back(
            ErrorOf(searched.scene.images[v], catalog, object, h.camera, h.camera_from_object));
    }
    first += Px(errors.empty() ? 1e9 : errors.front());
    best += Px(errors.empty() ? 1e9 : *std::min_element(errors.begin(), errors.end()));
  }
  std::cout << absl::StrFormat(
      "  part %d: first%s; best listed%s\n", catalog.obj_ids[object], first, best);
}

void ReportPlaced(const SearchedScene& searched,
                  const AspectCatalog& catalog,
                  const LinkedScene& found,
                  std::size_t index) {
  const LinkedObject& o = found.objects[index];
  std::string errors, scores;
  double worst = 0.0, support_px = 0.0, least = 1.0;
  int shown = 0;
  for (std::size_t v = 0; v < found.views.size(); ++v) {
    if (!found.views[v]) {
      errors += " .";
      continue;
    }
    const double error = ErrorOf(searched.scene.images[v],
                                 catalog,
                                 o.object,
                                 found.views[v]->camera,
                                 found.views[v]->camera_from_scene * o.scene_from_object);
    errors += Px(error);
    worst = std::max(worst, error);
    if (!o.shown[v]) continue;
    ++shown;
    support_px += o.views[v].support_px;
    least = std::min(least, o.views[v].precision);
    scores += absl::StrFormat(" %.2f/%.2f", o.views[v].precision, o.views[v].recall);
  }
  std::cout << absl::StrFormat(
      "  placed,%d,%d,%d,%d,%.3f,%.3f,%.3f,%.1f,%d,%d,%d,%.3f,%.3f,%d,%.1f,px%s,views%s\n",
      searched.scene.scene_id,
      catalog.obj_ids[o.object],
      static_cast<int>(index),
      worst < kRightPx ? 1 : 0,
      o.score,
      o.precision,
      least,
      support_px / std::max(1, shown),
      shown,
      found.registered(),
      o.lies ? 1 : 0,
      found.agreement.ground,
      o.surface,
      o.surface_pairs,
      worst,
      errors,
      scores);
}

void WriteOverlays(const std::string& folder,
                   const SearchedScene& searched,
                   const AspectCatalog& catalog,
                   const LinkedScene& found) {
  for (std::size_t v = 0; v < found.views.size(); ++v) {
    const BopImage& image = searched.scene.images[v];
    cv::Mat out = cv::imread(image.path, cv::IMREAD_COLOR);
    for (std::size_t i = 0; found.views[v] && i < found.objects.size(); ++i) {
      const LinkedObject& o = found.objects[i];
      const VisibleEdges edges =
          FindVisibleEdges(catalog.parts[o.object].object->mesh,
                           found.views[v]->camera,
                           found.views[v]->camera_from_scene * o.scene_from_object);
      const cv::Scalar colour(i == 0 ? 0 : 255, 255, i == 1 ? 255 : 0);
      for (const VisibleEdgePoint& p : edges.points)
        cv::circle(out, {cvRound(p.image.x()), cvRound(p.image.y())}, 1, colour, cv::FILLED);
    }
    cv::imwrite(absl::StrFormat("%s/%d_%d.png", folder, searched.scene.scene_id, image.im_id), out);
  }
}

// Nothing known where they are not trusted.
absl::StatusOr<KnownCameras> TextureCameras(const BopScene& scene, int threads) {
  std::vector<cv::Mat> images;
  std::vector<ImageSize> sizes;
  for (const BopImage& view : scene.images) {
    images.push_back(cv::imread(view.path, cv::IMREAD_COLOR));
    sizes.push_back({images.back().cols, images.back().rows});
  }
  const MatchingOptions options;
  const TextureMatching texture = MatchTexture(images, options.texture, options.views, threads);
  HOROPTER_ASSIGN_OR_RETURN(
      const Reconstruction found,
      ReconstructFromTexture(texture, sizes, {}, ReconstructionOptions().texture));
  return found.trusted ? CamerasOfReconstruction(found) : KnownCameras();
}

void ReportScene(const Arguments& arguments,
                 const AspectCatalog& catalog,
                 const SearchedScene& searched,
                 const KnownCameras& cameras) {
  std::cout << absl::StrFormat("scene %d\n", searched.scene.scene_id);
  if (cameras.known() < 2) {
    std::cout << "  cameras are not known\n";
    return;
  }
  for (int object = 0; object < static_cast<int>(catalog.parts.size()); ++object) {
    if (arguments.catalog.empty()) ReportListed(searched, catalog, object);
  }
  AspectLinkOptions options;
  options.threads = arguments.search.threads;
  int views_searched = 0;
  const std::vector<std::vector<AspectHypothesis>> none(searched.images.size());
  const auto start = std::chrono::steady_clock::now();
  const LinkedScene found = FindInCameras({searched.images,
                                           searched.priors,
                                           none,
                                           catalog.parts,
                                           [&](int v) {
                                             ++views_searched;
                                             return searched.hypotheses[v];
                                           }},
                                          cameras,
                                          options);
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::cout << absl::StrFormat("  %d of %d views, %d searched, %.2f s; focal lengths",
                               found.registered(),
                               static_cast<int>(found.views.size()),
                               views_searched,
                               seconds);
  for (std::size_t v = 0; v < found.views.size(); ++v) {
    if (found.views[v])
      std::cout << absl::StrFormat(
          " %+.1f%%",
          100 * (found.views[v]->camera.focal_px / searched.scene.images[v].camera.focal_px - 1));
  }
  std::cout << "\n";
  for (std::size_t i = 0; i < found.objects.size(); ++i) ReportPlaced(searched, catalog, found, i);
  std::cout << std::flush;
  if (!arguments.overlays.empty()) WriteOverlays(arguments.overlays, searched, catalog, found);
}

absl::Status Run(const Arguments& arguments) {
  const bool own = arguments.catalog.empty();
  auto dataset = ReadBopDataset(own ? arguments.dataset : arguments.catalog);
  if (!dataset.ok()) return dataset.status();
  AspectCatalog catalog;
  if (absl::Status s = LoadAspectCatalog(*dataset, arguments.cache, &catalog); !s.ok()) return s;
  for (int& id : catalog.obj_ids) id += own ? 0 : kForeign;
  const auto ids = ScenesOf(arguments.dataset, arguments.split, arguments.scenes);
  if (!ids.ok()) return ids.status();
  for (const int id : *ids) {
    auto read = ReadBopScene(arguments.dataset, arguments.split, id);
    if (!read.ok()) return read.status();
    const SearchedScene searched = SearchImages(arguments.search, catalog, *std::move(read));
    KnownCameras cameras;
    if (arguments.texture) {
      HOROPTER_ASSIGN_OR_RETURN(cameras, TextureCameras(searched.scene, arguments.search.threads));
    } else {
      cameras = DisturbedCameras(searched.scene, arguments.turn_deg, arguments.focal_share);
    }
    ReportScene(arguments, catalog, searched, cameras);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Arguments arguments;
  CLI::App app("Parts looked for under known cameras");
  app.add_option("DATASET", arguments.dataset)->required();
  app.add_option("SPLIT", arguments.split)->required();
  app.add_option("--scenes", arguments.scenes)->delimiter(',');
  app.add_flag("--texture", arguments.texture);
  app.add_option("--turn", arguments.turn_deg);
  app.add_option("--focal", arguments.focal_share);
  app.add_option("--cache", arguments.cache);
  app.add_option("--hypotheses", arguments.search.hypotheses);
  app.add_option("--catalog", arguments.catalog);
  app.add_option("--overlays", arguments.overlays);
  app.add_option("--max-width", arguments.search.image.max_width_px);
  app.add_option("--threads", arguments.search.threads);
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = horopter::Run(arguments);
  if (!status.ok()) {
    std::cerr << status.ToString() << "\n";
    return 1;
  }
  return 0;
}
