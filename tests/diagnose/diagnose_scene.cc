#include "tests/diagnose/diagnose_scene.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "server/base/status_macros.h"
#include "server/pipeline/pipeline.h"
#include "tests/diagnose/feature_report.h"
#include "tests/diagnose/overlay.h"

namespace horopter {
namespace {

struct LoadedScene {
  std::vector<cv::Mat> images;
  std::vector<TrueView> truth;
};

absl::StatusOr<LoadedScene> Load(const BopScene& scene, const TrueModels& models) {
  if (!scene.has_ground_truth) {
    return absl::InvalidArgumentError("scene " + std::to_string(scene.scene_id) +
                                      " has no ground truth");
  }
  LoadedScene loaded;
  for (const BopImage& image : scene.images) {
    loaded.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    if (loaded.images.back().empty()) {
      return absl::InvalidArgumentError(image.path + ": not an image");
    }
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
      if (edge.covered >= kFoundShare) {
        found += 1;
        usable += edge.covered_usable >= kFoundShare ? 1 : 0;
        pieces += edge.pieces;
      }
      if (scene.truth[v].edges[e].kind == CurveKind::kCircle) {
        arcs += 1;
        arcs_found += edge.covered_by_arcs >= kFoundShare ? 1 : 0;
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

void WritePictures(const BopScene& scene,
                   const LoadedScene& loaded,
                   const std::vector<ImageFeatures>& features,
                   const std::vector<FeatureFinding>& findings,
                   const std::vector<std::vector<Wireframe>>& wireframes,
                   const std::string& folder) {
  std::filesystem::create_directories(folder);
  for (size_t v = 0; v < features.size(); ++v) {
    char name[64];
    std::snprintf(name, sizeof name, "/%06d_%06d", scene.scene_id, scene.images[v].im_id);
    cv::imwrite(folder + name + "_features.png", DrawFeatures(loaded.images[v], features[v]));
    cv::imwrite(
        folder + name + "_truth.png",
        DrawTruth(loaded.images[v], features[v], loaded.truth[v], findings[v], wireframes[v]));
  }
}

}  // namespace

absl::StatusOr<SceneReport> DiagnoseScene(const BopScene& scene,
                                          const TrueModels& models,
                                          const CatalogSnapshot& catalog,
                                          const DiagnoseOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(const LoadedScene loaded, Load(scene, models));
  SceneReport report;
  report.scene_id = scene.scene_id;
  report.tier = scene.tier;
  std::vector<ImageFeatures> features;
  const auto begin = std::chrono::steady_clock::now();
  (void)catalog;
  for (const cv::Mat& image : loaded.images) {
    HOROPTER_ASSIGN_OR_RETURN(ImageFeatures one, DetectFeatures(image, FeatureOptions()));
    features.push_back(std::move(one));
  }
  report.figures["seconds"] =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  std::vector<FeatureFinding> findings;
  for (size_t v = 0; v < features.size(); ++v) {
    findings.push_back(CompareFeatures(features[v], loaded.truth[v]));
  }
  ReportFeatures(loaded, findings, &report);
  if (!options.overlay_folder.empty()) {
    WritePictures(scene,
                  loaded,
                  features,
                  findings,
                  std::vector<std::vector<Wireframe>>(features.size()),
                  options.overlay_folder);
  }
  return report;
}

}  // namespace horopter
