// Reports what matching and reconstruction reach on a data set in BOP layout, against its ground
// truth:
//   matching_report DATASET SPLIT [SCENE...]
// Ground truth is used for the report only. Photographs whose files do not say where the cameras
// are are measured by the world that the parts' poses give (CompleteTruth); the table is the plane
// z = 0 of a world that the files give, and is not measured in another.
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "client/bop_dataset.h"
#include "server/base/status_macros.h"
#include "server/vision/features/features.h"
#include "server/vision/matching/camera_matching.h"
#include "server/vision/matching/conic_matching.h"
#include "server/vision/matching/texture_matching.h"
#include "server/vision/reconstruction/texture_route.h"
#include "tests/bench/matching_truth.h"
#include "tests/diagnose/conic_report.h"
#include "tests/diagnose/match_report.h"
#include "tests/diagnose/reduced_images.h"
#include "tests/diagnose/relative_cameras.h"
#include "tests/diagnose/true_transfer.h"

namespace horopter {
namespace {

struct Scene {
  int id = 0;
  std::string tier;
  std::vector<cv::Mat> images;
  TrueWorld world;
  std::vector<TrueView> truth;
  bool table_known = false;  // the file gives the world, whose z = 0 is the table
};

struct Tally {
  int neighbours = 0, neighbours_right = 0, neighbours_found = 0, neighbours_chained = 0;
  int pairs = 0, found = 0, right = 0;
  std::vector<double> errors;
  int f_found = 0, f_right = 0, f_neighbours_found = 0, f_neighbours_right = 0;
  int matches = 0, matches_right = 0;  // of which the truth is known
  int texture_right = 0, texture_wrong = 0;
  int shared = 0, shared_matched = 0;  // corners and edges of parts in neighbouring views
  std::vector<int> tracked;            // per part: of them in tracks of three views and more
  ConicFinding conics;
  std::vector<double> rotations_deg;  // median of a scene
  int scenes = 0, scenes_all_in = 0, scenes_registered_right = 0, trusted = 0;
  std::vector<double> focal_errors, trusted_focal_errors;
  std::vector<double> focal_ratios;  // error over stated deviation, every view of trusted scenes
  std::vector<double> five_view_errors;  // scenes with five and more registered views
};

void ReportPlanes(const Scene& scene,
                  const MatchingResult& matching,
                  std::map<std::string, Tally>* tallies) {
  const std::vector<BopImage>& images = scene.world.scene.images;
  const int n = static_cast<int>(scene.images.size());
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    tally->pairs += n * (n - 1) / 2;
    tally->neighbours += n - 1;
    for (const PlaneHomography& p : matching.planes) {
      const auto [median, p90] = PlaneError(images[p.view_a], images[p.view_b], p.b_from_a);
      ++tally->found;
      tally->right += median >= 0 && median < 2.0;
      tally->errors.push_back(median);
      if (p.view_b - p.view_a == 1) {
        ++tally->neighbours_found;
        tally->neighbours_right += median >= 0 && median < 2.0;
      }
    }
    for (int a = 0; a + 1 < n; ++a) {
      if (matching.component[a] < 0 || matching.component[a] != matching.component[a + 1]) continue;
      const Eigen::Matrix3d H =
          matching.view_from_plane[a + 1] * matching.view_from_plane[a].inverse();
      const double e = PlaneError(images[a], images[a + 1], H).first;
      tally->neighbours_chained += e >= 0 && e < 2.0;
    }
  }
  for (const PlaneHomography& p : matching.planes) {
    const auto direct = PlaneError(images[p.view_a], images[p.view_b], p.b_from_a);
    const auto chained = PlaneError(
        images[p.view_a],
        images[p.view_b],
        matching.view_from_plane[p.view_b] * matching.view_from_plane[p.view_a].inverse());
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

void ReportPairs(const Scene& scene,
                 const TrueModels& models,
                 const std::vector<ImageFeatures>& features,
                 const MatchingResult& matching,
                 std::map<std::string, Tally>* tallies) {
  const TrueTransfer transfer(scene.world, models);
  for (const PairGeometry& p : matching.pairs) {
    if (!p.F) {
      std::printf("  pair %d-%d: refused: %s\n", p.view_a, p.view_b, p.refusal.c_str());
      continue;
    }
    const auto [share, p95] = FundamentalQuality(
        models, scene.world.scene.images[p.view_a], scene.world.scene.images[p.view_b], *p.F);
    std::map<MatchTruth, int> judged;
    for (const JunctionMatch& m : p.matches) {
      ++judged[transfer.Judge(p.view_a,
                              features[p.view_a].junctions[m.junction_a].point,
                              p.view_b,
                              features[p.view_b].junctions[m.junction_b].point)];
    }
    std::printf(
        "  pair %d-%d: F %s, %.0f %% of vertices < 2 px, 95 %% < %.2f px; matches: %d right, %d "
        "wrong, %d not known\n",
        p.view_a,
        p.view_b,
        share >= 0.95 ? "right" : "WRONG",
        100 * share,
        p95,
        judged[MatchTruth::kRight],
        judged[MatchTruth::kWrong],
        judged[MatchTruth::kUnknown]);
    for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
      ++tally->f_found;
      tally->f_right += share >= 0.95;
      if (p.view_b - p.view_a == 1) {
        ++tally->f_neighbours_found;
        tally->f_neighbours_right += share >= 0.95;
      }
    }
  }
  const MatchFinding finding = CompareMatches(matching, scene.world, models, features, scene.truth);
  const int shared = finding.shared_corners + finding.shared_edges;
  const int matched = finding.corners_matched + finding.edges_matched;
  std::printf(
      "  matches: %d right of %d whose truth is known; recall on parts %d of %d; tracks of "
      "parts:",
      finding.matches_right,
      finding.matches,
      matched,
      shared);
  for (const int count : finding.tracked) std::printf(" %d", count);
  std::printf("\n");
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    tally->matches += finding.matches;
    tally->matches_right += finding.matches_right;
    tally->shared += shared;
    tally->shared_matched += matched;
    tally->tracked.insert(tally->tracked.end(), finding.tracked.begin(), finding.tracked.end());
  }
}

// Texture points, which come before corners and edges.
void ReportTexture(const Scene& scene,
                   const TrueModels& models,
                   const TextureMatching& texture,
                   std::map<std::string, Tally>* tallies) {
  const TrueTransfer transfer(scene.world, models);
  int right = 0, wrong = 0, in_three = 0;
  for (const TexturePair& pair : texture.pairs) {
    for (const auto& [a, b] : pair.matches) {
      const MatchTruth judged = transfer.Judge(pair.view_a,
                                               texture.keypoints[pair.view_a].points[a],
                                               pair.view_b,
                                               texture.keypoints[pair.view_b].points[b]);
      right += judged == MatchTruth::kRight;
      wrong += judged == MatchTruth::kWrong;
    }
  }
  for (const FeatureTrack& track : texture.tracks) in_three += track.features.size() >= 3;
  std::printf(
      "  texture: %zu pairs, %d matches right and %d wrong, %zu tracks, %d of three views\n",
      texture.pairs.size(),
      right,
      wrong,
      texture.tracks.size(),
      in_three);
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    tally->texture_right += right;
    tally->texture_wrong += wrong;
  }
}

// Ellipses under the cameras that were found.
absl::Status ReportConics(const Scene& scene,
                          const TrueModels& models,
                          const std::vector<ImageFeatures>& features,
                          const Reconstruction& found,
                          std::map<std::string, Tally>* tallies) {
  const std::vector<std::optional<CalibratedCamera>> cameras(found.views.begin(),
                                                             found.views.end());
  const std::clock_t begin = std::clock();
  HOROPTER_ASSIGN_OR_RETURN(const ConicMatching matching, MatchConics(features, cameras));
  const double seconds = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
  const ConicFinding finding = CompareConics(
      matching, features, scene.world.scene, models, scene.world.rms_px.value_or(0.0));
  std::printf(
      "  conics: %d right of %d whose truth is known; recall on parts %d of %d; circles of parts "
      "in "
      "tracks of three views %d; in space %d; %.2f s\n",
      finding.matches_right,
      finding.matches,
      finding.shared_matched,
      finding.shared,
      finding.tracked,
      finding.in_space,
      seconds);
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    tally->conics.matches += finding.matches;
    tally->conics.matches_right += finding.matches_right;
    tally->conics.shared += finding.shared;
    tally->conics.shared_matched += finding.shared_matched;
    tally->conics.tracked += finding.tracked;
    tally->conics.in_space += finding.in_space;
  }
  return absl::OkStatus();
}

void ReportReconstruction(const Scene& scene,
                          const TrueModels& models,
                          const Reconstruction& found,
                          std::map<std::string, Tally>* tallies) {
  std::vector<double> errors, ratios;
  std::string list;
  std::vector<std::optional<EstimatedCamera>> cameras(found.views.size());
  for (size_t v = 0; v < found.views.size(); ++v) {
    if (!found.views[v]) continue;
    const double e =
        std::log(found.views[v]->camera.focal_px / scene.world.scene.images[v].camera.focal_px);
    cameras[v] = EstimatedCamera{found.views[v]->camera, found.views[v]->camera_from_scene, 0.0};
    errors.push_back(std::abs(e));
    ratios.push_back(std::abs(e) / found.views[v]->focal_log_sigma);
    char text[64];
    std::snprintf(
        text, sizeof(text), " %+.0f(%.0f)", 100 * e, 100 * found.views[v]->focal_log_sigma);
    list += text;
  }
  const double p95 = errors.empty() ? -1.0 : VertexReprojection(models, scene.world.scene, found);
  const bool all_in = errors.size() == scene.images.size() && p95 >= 0 && p95 <= 2.0;
  const auto rotation = CompareRelative(cameras, scene.world.scene).MedianRotation();
  std::printf(
      "  reconstruction: %zu of %zu views, rms %.2f px, %s; vertices 95 %% < %.2f px; "
      "rotations %.2f deg; f error (sigma) in %%:%s\n",
      errors.size(),
      scene.images.size(),
      found.rms_px,
      found.trusted ? "trusted" : found.refusal.c_str(),
      p95,
      rotation.value_or(-1.0),
      list.c_str());
  std::sort(errors.begin(), errors.end());
  for (Tally* tally : {&(*tallies)[scene.tier], &(*tallies)["ALL"]}) {
    ++tally->scenes;
    tally->scenes_all_in += all_in;
    tally->scenes_registered_right += p95 >= 0 && p95 <= 2.0;
    tally->trusted += found.trusted;
    if (rotation) tally->rotations_deg.push_back(*rotation);
    if (!errors.empty()) tally->focal_errors.push_back(errors[errors.size() / 2]);
    if (errors.size() >= 5) tally->five_view_errors.push_back(errors[errors.size() / 2]);
    if (!found.trusted) continue;
    tally->trusted_focal_errors.push_back(errors.back());
    tally->focal_ratios.insert(tally->focal_ratios.end(), ratios.begin(), ratios.end());
  }
}

// 0 of a way of matching that does not count it.
double CountOf(const MatchingResult& matching, const std::string& name) {
  const auto at = matching.counts.find(name);
  return at == matching.counts.end() ? 0.0 : at->second;
}

// As the pipeline goes about it: cameras from texture, and corners and edges along their epipolar
// lines; where texture does not tell, cameras from corners and edges.
absl::Status ReportScene(const Scene& scene,
                         const TrueModels& models,
                         std::map<std::string, Tally>* tallies) {
  std::vector<ImageFeatures> features;
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : scene.images) {
    HOROPTER_ASSIGN_OR_RETURN(ImageFeatures one, DetectFeatures(image, FeatureOptions()));
    features.push_back(std::move(one));
    sizes.push_back({image.cols, image.rows});
  }
  const std::clock_t begin = std::clock();
  MatchingOptions options;
  options.threads = 2;
  const TextureMatching texture =
      MatchTexture(scene.images, options.texture, options.views, options.threads);
  absl::StatusOr<Reconstruction> found =
      ReconstructFromTexture(texture, sizes, {}, ReconstructionOptions().texture);
  HOROPTER_RETURN_IF_ERROR(found.status());
  const bool by_texture = found->trusted;
  absl::StatusOr<MatchingResult> matching;
  if (by_texture) {
    const std::vector<std::optional<CalibratedCamera>> cameras(found->views.begin(),
                                                               found->views.end());
    matching = MatchViewsOfCameras(scene.images, features, cameras, options);
  } else {
    matching = MatchViews(scene.images, features, options);
  }
  HOROPTER_RETURN_IF_ERROR(matching.status());
  if (!by_texture)
    found = ReconstructViews(*matching, features, sizes, {}, ReconstructionOptions());
  HOROPTER_RETURN_IF_ERROR(found.status());
  std::printf(
      "scene %2d %s: %zu views, %.2f s of the processor after the features, cameras by %s, chain "
      "rms "
      "%.2f px, contradicted %.0f, component",
      scene.id,
      scene.tier.c_str(),
      scene.images.size(),
      static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC,
      by_texture ? "texture" : "corners and edges",
      CountOf(*matching, "plane_rms_px"),
      CountOf(*matching, "planes_contradicted"));
  for (int c : matching->component) std::printf(" %d", c);
  std::printf("\n");
  ReportTexture(scene, models, texture, tallies);
  if (scene.table_known && !by_texture) ReportPlanes(scene, *matching, tallies);
  ReportPairs(scene, models, features, *matching, tallies);
  ReportReconstruction(scene, models, *found, tallies);
  return ReportConics(scene, models, features, *found, tallies);
}

// With one decimal; "-" of nothing.
std::string MedianText(std::vector<double> values, double scale) {
  if (values.empty()) return "-";
  std::sort(values.begin(), values.end());
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f", scale * values[values.size() / 2]);
  return text;
}

std::string ShareText(int of, int all) {
  if (all == 0) return "-";
  char text[64];
  std::snprintf(text, sizeof(text), "%.3f (%d of %d)", static_cast<double>(of) / all, of, all);
  return text;
}

// The figures of one tier, or of all scenes.
void PrintTally(const std::string& tier, const Tally& t) {
  const char* name = tier.c_str();
  if (t.pairs > 0) {
    std::printf(
        "%-4s table H: neighbours right %d of %d found, of %d in all (chained right %d); all pairs "
        "right %d of %d found, of %d; median error %s px\n",
        name,
        t.neighbours_right,
        t.neighbours_found,
        t.neighbours,
        t.neighbours_chained,
        t.right,
        t.found,
        t.pairs,
        MedianText(t.errors, 1.0).c_str());
  }
  std::printf("%-4s texture: precision of matches %s\n",
              name,
              ShareText(t.texture_right, t.texture_right + t.texture_wrong).c_str());
  std::printf("%-4s F: neighbours right %d of %d found; all pairs right %d of %d found\n",
              name,
              t.f_neighbours_right,
              t.f_neighbours_found,
              t.f_right,
              t.f_found);
  const std::vector<double> tracked(t.tracked.begin(), t.tracked.end());
  std::printf(
      "%-4s matches: precision %s; recall on parts %s; of a part in tracks of three views: median "
      "%s\n",
      name,
      ShareText(t.matches_right, t.matches).c_str(),
      ShareText(t.shared_matched, t.shared).c_str(),
      MedianText(tracked, 1.0).c_str());
  std::printf(
      "%-4s conics: precision %s; recall on parts %s; circles of parts in tracks of three views "
      "%d; "
      "in space %d\n",
      name,
      ShareText(t.conics.matches_right, t.conics.matches).c_str(),
      ShareText(t.conics.shared_matched, t.conics.shared).c_str(),
      t.conics.tracked,
      t.conics.in_space);
  std::printf(
      "%-4s cameras: all images in and vertices < 2 px in %d of %d scenes (registered views right "
      "in %d); rotations median %s deg; focal error median %s %%; trusted %d, median of their "
      "worst "
      "views %s %%\n",
      name,
      t.scenes_all_in,
      t.scenes,
      t.scenes_registered_right,
      MedianText(t.rotations_deg, 1.0).c_str(),
      MedianText(t.focal_errors, 100.0).c_str(),
      t.trusted,
      MedianText(t.trusted_focal_errors, 100.0).c_str());
  if (t.five_view_errors.empty() || t.focal_ratios.empty()) return;
  double squared = 0.0;
  for (const double ratio : t.focal_ratios) squared += ratio * ratio;
  std::printf(
      "%-4s five views and more: focal error median %s %% (%zu scenes); trusted: error / stated "
      "deviation rms %.2f, largest %.1f (%zu views)\n",
      name,
      MedianText(t.five_view_errors, 100.0).c_str(),
      t.five_view_errors.size(),
      std::sqrt(squared / static_cast<double>(t.focal_ratios.size())),
      *std::max_element(t.focal_ratios.begin(), t.focal_ratios.end()),
      t.focal_ratios.size());
}

absl::StatusOr<Scene> LoadScene(const std::string& dataset,
                                const std::string& split,
                                int id,
                                const TrueModels& models) {
  HOROPTER_ASSIGN_OR_RETURN(const BopScene bop, ReadBopScene(dataset, split, id));
  HOROPTER_ASSIGN_OR_RETURN(ReducedScene reduced, ReadReduced(bop));
  Scene scene;
  scene.id = id;
  scene.tier = bop.tier;
  scene.table_known = PosedImages(bop) == static_cast<int>(bop.images.size());
  scene.images = std::move(reduced.images);
  scene.world = CompleteTruth(reduced.scene, models);
  for (const BopImage& image : scene.world.scene.images)
    scene.truth.push_back(MakeTrueView(image, models));
  return scene;
}

absl::Status Report(const std::string& dataset, const std::string& split, std::vector<int> ids) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset bop, ReadBopDataset(dataset));
  if (ids.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(ids, ListBopScenes(dataset, split));
  }
  HOROPTER_ASSIGN_OR_RETURN(const TrueModels models, ReadTrueModels(bop));
  std::map<std::string, Tally> tallies;
  for (int id : ids) {
    HOROPTER_ASSIGN_OR_RETURN(const Scene scene, LoadScene(dataset, split, id, models));
    HOROPTER_RETURN_IF_ERROR(ReportScene(scene, models, &tallies));
  }
  for (const auto& [tier, tally] : tallies) PrintTally(tier, tally);
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
