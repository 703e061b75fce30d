// What can be set about recognition.
#pragma once

#include "absl/status/status.h"
#include "server/base/stop_token.h"
#include "server/vision/recognition/acceptance.h"
#include "server/vision/recognition/learnt_constants.h"

namespace horopter {

// Which generators propose what is verified in all images.
struct RecognitionRoutes {
  bool aspects = true;          // parts in single images, by the aspects of their CAD
  bool matched_cameras = true;  // cameras of the matched features are tried first
  // The thesis's ways (initialization/bottom_up_route.h), which propose little that aspects do not:
  bool metric = false;      // similarity invariants of corners in space, cameras known up to scale
  bool projective = false;  // projective invariants of matched corners, nothing known of cameras
};

// How single images are searched; what is accepted of that stands in AspectAcceptance.
struct AspectRouteOptions {
  int max_objects = 200;  // of a request; more: the images choose some of them
  // Share of the pixels that are edges from which on the ground's motion is asked before aspects
  // are: it has a texture that hides parts. Blank grounds have .01 - .03, perforated plate .05,
  // granite, gravel and print .09 - .18. Lower: slower. Higher: parts lost. ADR 56.
  double textured_share = 0.05;
  // Poorly supported answers are held against themselves end for end and upside down.
  bool half_turns = true;
  // What a whole request of six VGA images and 25 parts may take on two cores.
  double full_search_s = 8.0;
};

struct RecognitionOptions {
  RecognitionRoutes routes;
  AspectRouteOptions aspects;
  AcceptanceOptions acceptance;
  double focal_start_widths = 1.5;  // first focal length tried, in image widths
  double focal_log_sigma = 0.35;    // prior width of log f; larger: weaker prior
  // Of what may be taken for a part of the catalog, the share that is none of it, before anything
  // is seen; > 0 and < 1. Larger: fewer answers, less sure.
  double unknown_share = kNominalUnknownShare;
  int threads = 1;
  // Once it returns true no round of search is begun any more, initial hypotheses
  // that are being looked for are left, and what was found is linked, judged and answered. Empty:
  // never.
  StopRequested hurry;
  // For all of the request, 0: any. Less than AspectRouteOptions::full_search_s: single images are
  // searched with less effort, so that some are linked and answered.
  double allowed_s = 0.0;
  // That may be made in all attempts, in searches of one image for all parts (search_effort.h); 0:
  // any. Once it is spent, what was found is answered as in a hurry, but on every machine the same.
  double effort = 0.0;
};

// Whether single images are searched with less effort.
inline bool IsBrief(const RecognitionOptions& options) {
  return options.allowed_s > 0.0 && options.allowed_s < options.aspects.full_search_s;
}

// Errors: INVALID_ARGUMENT, names the field: no route at all, values outside of their range.
absl::Status Validate(const RecognitionOptions& options);

}  // namespace horopter
