// What can be set about recognition.
#pragma once

#include "absl/status/status.h"
#include "server/base/stop_token.h"
#include "server/vision/recognition/acceptance.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

// Which routes may be taken, by cost until a scene is found that chance does not explain: metric,
// supporting plane, views (if the plane gave nothing), projective (if metric had no trusted
// cameras).
struct RecognitionRoutes {
  bool supporting_plane = true;
  bool metric = true;
  bool view_led = true;
  bool projective = true;
  bool aspects = true;  // parts by the aspects of their CAD, where objects have them
};

// When objects are asked for by their aspects (interpretation/aspect_route.h); what is accepted of
// that stands in AspectAcceptance.
struct AspectRouteOptions {
  int max_objects = 200;  // of a request; more: the images choose some of them
  // Median number of model edges of the objects from which on aspects are asked first: what routes
  // over sharp edges cost grows with these.
  int rich_edges = 60;
  double judge_render_px = 200.0;  // diameter of what answers are compared with
  // Share of the pixels that are edges from which on the ground's motion is asked before aspects
  // are: it has a texture that hides parts. Blank grounds have .01 - .03, perforated plate .05,
  // granite, gravel and print .09 - .18. Lower: slower. Higher: parts lost. ADR 56.
  double textured_share = 0.05;
  // What a whole request of six VGA images and 25 parts may take on two cores.
  double full_search_s = 8.0;
};

struct RecognitionOptions {
  RecognitionRoutes routes;
  AspectRouteOptions aspects;
  AcceptanceOptions acceptance;
  EdgeSearchOptions search;         // of all routes but the aspects
  double focal_start_widths = 1.5;  // first focal length tried, in image widths
  double focal_log_sigma = 0.35;    // prior width of log f; larger: weaker prior
  int hypotheses_per_object = 8;    // distinct poses kept per object and view
  int threads = 1;
  // Once it returns true no route, scale or round of search is begun any more, initial hypotheses
  // that are being looked for are left, and what was found is linked, judged and answered. Empty:
  // never.
  StopRequested hurry;
  // For all of the request, 0: any. Less than AspectRouteOptions::full_search_s: single images are
  // searched with less effort, so that some are linked and answered.
  double allowed_s = 0.0;
};

// Whether single images are searched with less effort.
inline bool IsBrief(const RecognitionOptions& options) {
  return options.allowed_s > 0.0 && options.allowed_s < options.aspects.full_search_s;
}

// Errors: INVALID_ARGUMENT, names the field: no route at all, values outside of their range.
absl::Status Validate(const RecognitionOptions& options);

}  // namespace horopter
