#include "tests/diagnose/diagnose_scene.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <utility>

#include "server/base/status_macros.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/features/feature_graph.h"
#include "tests/diagnose/camera_report.h"
#include "tests/diagnose/feature_json.h"
#include "tests/diagnose/feature_report.h"
#include "tests/diagnose/match_report.h"
#include "tests/diagnose/object_report.h"
#include "tests/diagnose/overlay.h"
#include "tests/diagnose/reduced_images.h"
#include "tests/diagnose/true_world.h"

namespace horopter {
namespace {

// Images as the stages get them, and the truth in their pixels.
struct LoadedScene {
  std::vector<cv::Mat> images;
  TrueWorld world;
  std::vector<TrueView> truth;
};

absl::StatusOr<LoadedScene> Load(const BopScene& scene, const TrueModels& models) {
  if (!scene.has_ground_truth) {
    return absl::InvalidArgumentError("scene " + std::to_string(scene.scene_id) +
                                      " has no ground truth");
  }
  HOROPTER_ASSIGN_OR_RETURN(ReducedScene reduced, ReadReduced(scene));
  LoadedScene loaded;
  loaded.images = std::move(reduced.images);
  loaded.world = CompleteTruth(reduced.scene, models);
  for (const BopImage& image : loaded.world.scene.images) {
    loaded.truth.push_back(MakeTrueView(image, models));
  }
  return loaded;
}

// Ratio as a figure, absent when nothing was there to find.
void SetShare(const std::string& name, double found, double of, SceneReport* report) {
  if (of > 0.0) {
    report->figures[name] = found / of;
  }
}

void ReportFeatures(const LoadedScene& scene,
                    const std::vector<FeatureFinding>& findings,
                    SceneReport* report) {
  double edges = 0, found = 0, usable = 0, pieces = 0, corners = 0, corners_found = 0, square = 0;
  double arcs = 0, arcs_found = 0, segments = 0, texture = 0;
  for (size_t v = 0; v < findings.size(); ++v) {
    for (size_t e = 0; e < findings[v].edges.size(); ++e) {
      const EdgeFinding& edge = findings[v].edges[e];
      edges += 1;
      if (edge.covered >= kFoundEdgeShare) {
        found += 1;
        usable += edge.covered_usable >= kFoundEdgeShare ? 1 : 0;
        pieces += edge.pieces;
      }
      if (scene.truth[v].edges[e].kind == CurveKind::kCircle) {
        arcs += 1;
        arcs_found += edge.covered_by_arcs >= kFoundEdgeShare ? 1 : 0;
      }
    }
    for (double error : findings[v].corner_error_px) {
      corners += 1;
      if (error < kCornerPx) {
        corners_found += 1;
        square += error * error;
      }
    }
    segments += findings[v].segments;
    texture += findings[v].segments_in_texture;
  }
  SetShare("edge_recall", found, edges, report);
  SetShare("edge_fragments", pieces, found, report);
  SetShare("junction_recall", corners_found, corners, report);
  if (corners_found > 0) {
    report->figures["junction_rms_px"] = std::sqrt(square / corners_found);
  }
  SetShare("arc_recall", arcs_found, arcs, report);
  SetShare("segments", segments, static_cast<double>(findings.size()), report);
  SetShare("texture_share", texture, segments, report);
  SetShare("texture_on_parts", found - usable, found, report);
}

void ReportMatches(const std::string& prefix, const MatchFinding& finding, SceneReport* report) {
  SetShare(prefix + "_precision", finding.matches_right, finding.matches, report);
  SetShare(prefix + "_recall",
           finding.corners_matched + finding.edges_matched,
           finding.shared_corners + finding.shared_edges,
           report);
  std::vector<int> tracked = finding.tracked;
  if (tracked.empty()) return;
  std::sort(tracked.begin(), tracked.end());
  report->figures[prefix + "_tracked"] = tracked[tracked.size() / 2];
}

// Reconstructed points that belong to a true corner by the junctions they were made of.
std::vector<double> ReconstructedCornerErrors(const Reconstruction& reconstruction,
                                              const std::vector<WorldCorner>& corners,
                                              const LoadedScene& scene,
                                              const std::vector<FeatureFinding>& findings,
                                              const CameraFinding& alignment) {
  std::vector<double> errors;
  for (const ReconstructedPoint& point : reconstruction.points) {
    std::map<std::pair<int, int>, int> votes;
    for (const auto& [view, junction] : point.observations) {
      for (size_t c = 0; junction >= 0 && c < scene.truth[view].corners.size(); ++c) {
        if (findings[view].nearest_junction[c] == junction &&
            findings[view].corner_error_px[c] < kCornerPx) {
          const TrueCorner& corner = scene.truth[view].corners[c];
          ++votes[{corner.instance, corner.vertex}];
        }
      }
    }
    for (const WorldCorner& corner : corners) {
      const auto it = votes.find({corner.instance, corner.vertex});
      if (it != votes.end() && it->second >= 2) {
        errors.push_back(DistanceMm(alignment, point.point_in_world, corner.point_in_world));
      }
    }
  }
  return errors;
}

void ReportCameras(const PipelineResult& result,
                   const BopScene& scene,
                   const LoadedScene& loaded,
                   const TrueModels& models,
                   const std::vector<FeatureFinding>& findings,
                   SceneReport* report) {
  const std::vector<WorldCorner> corners = TrueWorldCorners(scene, models);
  std::vector<std::optional<EstimatedView>> before(scene.images.size()), after(scene.images.size());
  for (size_t v = 0; v < result.trace.reconstruction.views.size(); ++v) {
    if (const auto& view = result.trace.reconstruction.views[v]) {
      before[v] = {view->camera, view->camera_from_scene};
    }
  }
  for (size_t v = 0; v < result.answer.cameras.size(); ++v) {
    if (const auto& view = result.answer.cameras[v]) {
      after[v] = {view->camera, view->camera_from_scene};
    }
  }
  const CameraFinding model_free = CompareCameras(before, scene, corners, Freedom::kCollineation);
  if (model_free.measured) report->figures["cameras_model_free"] = model_free.recovered;
  report->figures["views_model_free"] =
      static_cast<double>(model_free.registered) / scene.images.size();
  if (model_free.aligned) {
    report->figures["model_free_px"] = model_free.worst_view_px;
    const std::vector<double> errors = ReconstructedCornerErrors(
        result.trace.reconstruction, corners, loaded, findings, model_free);
    if (!errors.empty()) {
      report->figures["corner_error_mm"] = Median(errors);
    }
  }
  if (const auto error = FocalError(before, scene)) {
    report->figures["focal_error_model_free"] = *error;
  }
  const CameraFinding recovered = CompareCameras(after, scene, corners, Freedom::kSimilarity);
  if (recovered.measured) report->figures["cameras_recovered"] = recovered.recovered;
  report->figures["views_recovered"] =
      static_cast<double>(recovered.registered) / scene.images.size();
  if (recovered.aligned) {
    report->figures["recovered_px"] = recovered.worst_view_px;
  }
  if (const auto error = FocalError(after, scene)) {
    report->figures["focal_error"] = *error;
  }
}

void ReportWords(const PipelineResult& result, SceneReport* report) {
  if (const std::string reasons = ReasonsText(result.answer); !reasons.empty()) {
    report->notes.push_back("answer: " + reasons);
  }
  if (!result.trace.reconstruction.refusal.empty()) {
    report->notes.push_back("reconstruction: " + result.trace.reconstruction.refusal);
  }
  const std::vector<std::string>& refusals = result.trace.reconstruction.view_refusals;
  for (size_t v = 0; v < refusals.size(); ++v) {
    if (refusals[v].empty() || refusals[v] == result.trace.reconstruction.refusal) continue;
    report->notes.push_back("reconstruction, view " + std::to_string(v) + ": " + refusals[v]);
  }
  for (const StageReport& stage : result.answer.stages) {
    report->figures["seconds_" + stage.stage] = stage.seconds;
    for (const auto& [name, value] : stage.counts) {
      if (name.starts_with("seconds_")) {
        report->figures["seconds_" + stage.stage + name.substr(7)] = value;
      }
    }
  }
}

std::vector<std::vector<DrawnObject>> AnswerWireframes(const PipelineResult& result,
                                                       const CatalogSnapshot& catalog,
                                                       size_t views) {
  std::vector<std::vector<DrawnObject>> wireframes(views);
  for (size_t v = 0; v < std::min(views, result.answer.cameras.size()); ++v) {
    if (!result.answer.cameras[v]) {
      continue;
    }
    for (const AnswerObject& object : result.answer.objects) {
      for (const auto& prepared : catalog.objects) {
        if (ModelOf(*prepared).id == object.object_id) {
          wireframes[v].push_back(
              {&ModelOf(*prepared),
               result.answer.cameras[v]->camera,
               result.answer.cameras[v]->camera_from_scene * object.scene_from_object});
        }
      }
    }
  }
  return wireframes;
}

// The first stage alone.
absl::StatusOr<PipelineResult> RunFeatures(const std::vector<cv::Mat>& images,
                                           const FeatureOptions& options) {
  PipelineResult result;
  for (const cv::Mat& image : images) {
    HOROPTER_ASSIGN_OR_RETURN(ImageFeatures one, DetectFeatures(image, options));
    result.trace.features.push_back(std::move(one));
  }
  return result;
}

absl::StatusOr<PipelineResult> RunAll(const std::vector<cv::Mat>& images,
                                      const CatalogSnapshot& catalog,
                                      const DiagnoseOptions& options) {
  SceneRequest request;
  request.images = images;
  PipelineOptions pipeline;
  pipeline.features = options.features;
  pipeline.threads = options.threads;
  pipeline.least_side_px = 0;  // Load has done this, so that the trace has the truth's pixels
  pipeline.small_side_px = 0;
  return RecognizeScene(request, catalog, pipeline);
}

void WritePictures(const BopScene& scene,
                   const LoadedScene& loaded,
                   const std::vector<ImageFeatures>& features,
                   const std::vector<FeatureFinding>& findings,
                   const std::vector<std::vector<DrawnObject>>& wireframes,
                   const MatchingResult& matching,
                   const std::string& folder) {
  std::filesystem::create_directories(folder);
  for (size_t v = 0; v < features.size(); ++v) {
    char name[64];
    std::snprintf(name, sizeof name, "/%06d_%06d", scene.scene_id, scene.images[v].im_id);
    cv::imwrite(folder + name + "_features.png", DrawFeatures(loaded.images[v], features[v]));
    const FeatureGraph graph = BuildFeatureGraph(features[v], FeatureGraphOptions());
    cv::imwrite(folder + name + "_graph.png",
                DrawFeatureGraph(loaded.images[v], features[v], graph));
    std::ofstream(folder + name + "_features.json") << FeaturesToJson(features[v], graph);
    cv::imwrite(
        folder + name + "_truth.png",
        DrawTruth(loaded.images[v], features[v], loaded.truth[v], findings[v], wireframes[v]));
  }
  for (size_t v = 0; v + 1 < features.size(); ++v) {
    char name[64];
    std::snprintf(name, sizeof name, "/%06d_%zu_%zu_tracks.png", scene.scene_id, v, v + 1);
    const int a = static_cast<int>(v);
    cv::imwrite(folder + name,
                DrawTracks({loaded.images[v], loaded.images[v + 1]},
                           {features[v], features[v + 1]},
                           {a, a + 1},
                           matching));
  }
}

}  // namespace

absl::StatusOr<SceneReport> DiagnoseScene(const BopScene& as_read,
                                          const TrueModels& models,
                                          const CatalogSnapshot& catalog,
                                          const DiagnoseOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(const LoadedScene loaded, Load(as_read, models));
  const BopScene& scene = loaded.world.scene;
  SceneReport report;
  report.scene_id = scene.scene_id;
  report.tier = scene.tier;
  report.notes = loaded.world.notes;
  if (loaded.world.rms_px) report.figures["truth_px"] = *loaded.world.rms_px;
  const auto begin = std::chrono::steady_clock::now();
  HOROPTER_ASSIGN_OR_RETURN(const PipelineResult result,
                            options.features_only ? RunFeatures(loaded.images, options.features)
                                                  : RunAll(loaded.images, catalog, options));
  report.figures["seconds"] =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  const std::vector<ImageFeatures>& features = result.trace.features;
  std::vector<FeatureFinding> findings;
  for (size_t v = 0; v < features.size(); ++v) {
    findings.push_back(CompareFeatures(features[v], loaded.truth[v]));
  }
  ReportFeatures(loaded, findings, &report);
  if (!options.features_only && features.size() == scene.images.size()) {
    std::vector<std::string> ids;
    for (const auto& prepared : catalog.objects) {
      ids.push_back(ModelOf(*prepared).id);
    }
    ReportMatches(
        "match",
        CompareMatches(result.trace.matching, loaded.world, models, features, loaded.truth),
        &report);
    ReportCameras(result, scene, loaded, models, findings, &report);
    report.objects = FollowObjects(result, ids, scene, models, loaded.truth, findings);
    ReportWords(result, &report);
  }
  if (!options.overlay_folder.empty()) {
    WritePictures(scene,
                  loaded,
                  features,
                  findings,
                  AnswerWireframes(result, catalog, features.size()),
                  result.trace.matching,
                  options.overlay_folder);
  }
  return report;
}

}  // namespace horopter
