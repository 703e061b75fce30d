#include "server/pipeline/variants.h"

#include <functional>
#include <optional>
#include <set>
#include <utility>

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
    {"effort", "any", [](PipelineOptions* o) { o->recognition.effort = 0.0; }},
    {"effort", "2", [](PipelineOptions* o) { o->recognition.effort = 2.0; }},
    {"effort", "4", [](PipelineOptions* o) { o->recognition.effort = 4.0; }},
    {"effort", "6", [](PipelineOptions* o) { o->recognition.effort = 6.0; }},
    {"effort", "8", [](PipelineOptions* o) { o->recognition.effort = 8.0; }},
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

// NAME=off leaves a mechanism of recognition out; "on" is what the options are.
struct Mechanism {
  const char* name;
  void (*leave_out)(PipelineOptions*);
};

AspectLinkOptions& Link(PipelineOptions* o) {
  return o->aspects.link;
}

constexpr Mechanism kMechanisms[] = {
    {"pairs", [](PipelineOptions* o) { o->aspects.find.votes.max_pair_matches = 0; }},
    {"ellipses", [](PipelineOptions* o) { o->aspects.find.votes.max_ellipse_matches = 0; }},
    {"smoothing", [](PipelineOptions* o) { o->aspects.images.noisy = 1e6; }},
    {"smooth_figures", [](PipelineOptions* o) { o->aspects.images.smooth_figures = false; }},
    {"coloured_figures", [](PipelineOptions* o) { o->aspects.images.coloured_figures = false; }},
    {"jpeg_blocks", [](PipelineOptions* o) { o->aspects.images.jpeg_blocks = false; }},
    {"patterns", [](PipelineOptions* o) { o->aspects.images.drop_pattern = false; }},
    {"dot_patterns", [](PipelineOptions* o) { o->aspects.images.pattern.dots = false; }},
    {"printed_surfaces", [](PipelineOptions* o) { Link(o).printed_surfaces = false; }},
    {"doubtful_views", [](PipelineOptions* o) { Link(o).doubtful_views = false; }},
    {"standing", [](PipelineOptions* o) { Link(o).standing = 0; }},
    {"faint_parts", [](PipelineOptions* o) { Link(o).faint_parts = false; }},
    {"competing_parts", [](PipelineOptions* o) { Link(o).competing_parts = false; }},
    {"half_turns", [](PipelineOptions* o) { o->recognition.aspects.half_turns = false; }},
};

// What sets NAME=VALUE, and the name; nullopt where there is none.
std::optional<std::pair<const char*, std::function<void(PipelineOptions*)>>> FindVariant(
    const std::string& pair) {
  for (const Variant& v : kVariants) {
    if (pair == absl::StrCat(v.name, "=", v.value)) return {{v.name, v.apply}};
  }
  for (const Mechanism& m : kMechanisms) {
    if (pair == absl::StrCat(m.name, "=on")) return {{m.name, [](PipelineOptions*) {}}};
    if (pair == absl::StrCat(m.name, "=off")) return {{m.name, m.leave_out}};
  }
  return std::nullopt;
}

}  // namespace

std::vector<std::string> AllVariants() {
  std::vector<std::string> all;
  for (const Variant& v : kVariants) all.push_back(absl::StrCat(v.name, "=", v.value));
  for (const Mechanism& m : kMechanisms) {
    for (const char* value : {"=on", "=off"}) all.push_back(absl::StrCat(m.name, value));
  }
  return all;
}

absl::Status ApplyVariants(std::string_view variants, PipelineOptions* options) {
  PipelineOptions changed = *options;
  std::set<std::string> named;
  const std::string all(variants);
  for (const std::string& pair : std::vector<std::string>(absl::StrSplit(all, ','))) {
    const auto found = FindVariant(pair);
    if (!found) {
      return absl::InvalidArgumentError(absl::StrCat(
          "variants: '", pair, "' is not known; there are ", absl::StrJoin(AllVariants(), ", ")));
    }
    const auto& [name, apply] = *found;
    if (!named.insert(name).second) {
      return absl::InvalidArgumentError(absl::StrCat("variants: ", name, " is named twice"));
    }
    apply(&changed);
  }
  *options = std::move(changed);
  return absl::OkStatus();
}

}  // namespace horopter
