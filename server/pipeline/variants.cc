#include "server/pipeline/variants.h"

#include <algorithm>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"

namespace horopter {
namespace {

struct Variant {
  const char* name;
  const char* value;
  void (*apply)(PipelineOptions*);
};

BottomUpOptions& BottomUp(PipelineOptions* o) {
  return o->bottom_up;
}

void CheckLineSets(PipelineOptions* o, bool check) {
  BottomUp(o).projective.route.support.check_line_sets = check;
  BottomUp(o).metric.route.support.check_line_sets = check;
}

void Only(PipelineOptions* o, bool RecognitionRoutes::*route) {
  RecognitionRoutes& routes = o->recognition.routes;
  routes.matched_cameras = routes.metric = routes.projective = routes.aspects = false;
  routes.*route = true;
}

constexpr Variant kVariants[] = {
    {"detector",
     "linked_field",
     [](PipelineOptions* o) { o->features.detector = EdgeDetector::kLinkedField; }},
    {"detector",
     "edge_drawing",
     [](PipelineOptions* o) { o->features.detector = EdgeDetector::kEdgeDrawingChannels; }},
    {"splitting",
     "chords",
     [](PipelineOptions* o) {
       o->features.splitting.method = ChainSplittingMethod::kSplitAndMerge;
     }},
    {"splitting",
     "curvature_threshold",
     [](PipelineOptions* o) {
       o->features.splitting.method = ChainSplittingMethod::kCurvatureThreshold;
     }},
    {"splitting",
     "curvature_templates",
     [](PipelineOptions* o) {
       o->features.splitting.method = ChainSplittingMethod::kCurvatureTemplates;
     }},
    {"conic_fit", "rim", [](PipelineOptions* o) { o->refit_arcs = false; }},
    {"conic_fit", "orthogonal", [](PipelineOptions* o) { o->refit_arcs = true; }},
    {"line_sets", "off", [](PipelineOptions* o) { CheckLineSets(o, false); }},
    {"line_sets", "verify", [](PipelineOptions* o) { CheckLineSets(o, true); }},
    {"association",
     "cyclic_order",
     [](PipelineOptions* o) {
       BottomUp(o).projective.association = AssociationForm::kCyclicOrder;
     }},
    {"association",
     "axes",
     [](PipelineOptions* o) { BottomUp(o).projective.association = AssociationForm::kAxes; }},
    {"decomposition",
     "none",
     [](PipelineOptions* o) { BottomUp(o).decomposition = DecompositionMethod::kNone; }},
    {"decomposition",
     "per_object",
     [](PipelineOptions* o) { BottomUp(o).decomposition = DecompositionMethod::kPerObject; }},
    {"decomposition",
     "common",
     [](PipelineOptions* o) { BottomUp(o).decomposition = DecompositionMethod::kCommon; }},
    {"decomposition",
     "metric",
     [](PipelineOptions* o) { BottomUp(o).decomposition = DecompositionMethod::kMetric; }},
    {"decomposition",
     "images",
     [](PipelineOptions* o) { BottomUp(o).decomposition = DecompositionMethod::kImages; }},
    {"ground", "followed", [](PipelineOptions* o) { o->follow_ground = true; }},
    {"ground", "unused", [](PipelineOptions* o) { o->follow_ground = false; }},
    {"cameras", "texture", [](PipelineOptions* o) { o->cameras_from_texture = true; }},
    {"cameras", "parts", [](PipelineOptions* o) { o->cameras_from_texture = false; }},
    {"lens", "terms", [](PipelineOptions* o) { o->euclidean.lens.estimate = true; }},
    {"lens", "k1", [](PipelineOptions* o) { o->euclidean.lens.estimate = false; }},
    {"routes", "default", [](PipelineOptions* o) { o->recognition.routes = {}; }},
    {"routes",
     "all",
     [](PipelineOptions* o) {
       o->recognition.routes.metric = o->recognition.routes.projective = true;
     }},
    {"routes", "metric", [](PipelineOptions* o) { Only(o, &RecognitionRoutes::metric); }},
    {"routes", "projective", [](PipelineOptions* o) { Only(o, &RecognitionRoutes::projective); }},
    {"routes", "aspects", [](PipelineOptions* o) { Only(o, &RecognitionRoutes::aspects); }},
};

}  // namespace

std::vector<std::string> AllVariants() {
  std::vector<std::string> all;
  for (const Variant& v : kVariants) all.push_back(absl::StrCat(v.name, "=", v.value));
  return all;
}

absl::Status ApplyVariants(std::string_view variants, PipelineOptions* options) {
  PipelineOptions changed = *options;
  std::set<std::string> named;
  const std::string all(variants);
  for (const std::string& pair : std::vector<std::string>(absl::StrSplit(all, ','))) {
    const auto found = std::find_if(std::begin(kVariants), std::end(kVariants), [&](const auto& v) {
      return pair == absl::StrCat(v.name, "=", v.value);
    });
    if (found == std::end(kVariants)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "variants: '", pair, "' is not known; there are ", absl::StrJoin(AllVariants(), ", ")));
    }
    if (!named.insert(found->name).second) {
      return absl::InvalidArgumentError(absl::StrCat("variants: ", found->name, " is named twice"));
    }
    found->apply(&changed);
  }
  *options = std::move(changed);
  return absl::OkStatus();
}

}  // namespace horopter
