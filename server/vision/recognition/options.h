// What can be set about recognition.
#pragma once

#include "absl/status/status.h"
#include "server/base/stop_token.h"

namespace horopter {

// Which routes may be taken, by cost until a scene is found that chance does not explain: metric,
// table, views (if the table gave nothing), projective (if metric had no trusted cameras).
struct RecognitionRoutes {
  bool table = true;
  bool metric = true;
  bool view_led = true;
  bool projective = true;
  bool aspects = true;  // parts by the aspects of their CAD, where objects have them
};

// How answers are found and judged by what cameras should see of the parts (aspect_route.h). Scores
// are those of AspectScore, means over the views.
struct AspectRouteOptions {
  int max_objects = 200;  // of a request; more: the route is left out
  // Median number of model edges of the objects from which on aspects are asked first: what routes
  // over sharp edges cost grows with these.
  int rich_edges = 60;
  double judge_render_px = 200.0;
  // Median score of another route's answer: above it stands, below it is refused, in between the
  // aspects' own answer is asked for and the better one taken.
  double confirming_score = 0.45;
  double contradicting_score = 0.25;
  double chance_score = 0.40;  // of wrong poses: what exceeds it counts when answers are compared
  // Log odds that an object is right: weight x (score - what makes it even). Cameras adapt to the
  // first object: it must say more than those that others share cameras with, more still when it
  // links few of the views or only by focal lengths that differ much, and most in one view alone.
  // Set by hand on cad-dev, where right objects score 0.41 - 0.92 beside others and 0.57 - 0.92
  // alone; wrong ones up to 0.60 where none of a scene's parts is enrolled
  // (tests/bench/results.md).
  double score_weight = 25.0;
  double even_score = 0.44;  // beside an object of sure_score
  double even_alone = 0.53;
  double even_in_one_view = 0.58;
  double sure_score = 0.546;
  double few_views_share = 0.55;  // of the views: fewer add ...
  double few_views_more = 0.05;   // ... this to even_alone
  double focal_spread_free =
      0.15;                        // deviation of the views' log focal lengths; what exceeds it ...
  double focal_spread_more = 0.2;  // ... adds so much of it
  double accept_probability = 0.6;
  // Least precision of what is added beside the objects of a confirmed answer of another route:
  // blocks fit into other blocks' edges; wrong ones of parts-dev had 0.59 and 0.67, right ones 0.71
  // and more.
  double other_precision = 0.70;
};

struct RecognitionOptions {
  RecognitionRoutes routes;
  AspectRouteOptions aspects;
  double focal_start_widths = 1.5;  // first focal length tried, in image widths
  double focal_log_sigma = 0.35;    // prior width of log f; larger: weaker prior
  int hypotheses_per_object = 8;    // distinct poses kept per object and view
  double accept_score = 0.55;  // joint support of an accepted object; higher: fewer, surer objects
  double accept_probability = 0.5;  // of the scene; higher: fewer, surer answers
  double ambiguity_gap = 0.03;      // a rival closer than this makes the answer ambiguous
  // ... and another pose of the same object, where it alone determines the cameras: these then
  // adapt to the wrong pose. On parts-dev such rivals of right poses lay 0.13 and more behind (one
  // of 25 by 0.06), on the dotted box of the real photographs the right pose 0.11 behind.
  double loose_ambiguity_gap = 0.12;
  double min_parallax_rad = 0.035;  // between two views of an object; less is no parallax
  int threads = 1;
  // Once it returns true no route, scale or round of search is begun any more, seeds that are
  // being looked for are left, and what was found is judged and answered. Empty: never.
  StopRequested hurry;
};

// Errors: INVALID_ARGUMENT, names the field: no route at all, values outside of their range.
absl::Status Validate(const RecognitionOptions& options);

}  // namespace horopter
