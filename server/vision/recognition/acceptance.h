// Everything that decides whether what was found is answered. The rooms read these values and hold
// none of their own.
//
// What is fitted stands in learnt_constants.h. The others were set by hand on answers of the data
// set named, last in the commit named (tests/bench/history). What they do is seen in the answers of
//   `aspect_scene_report DATASET SPLIT [--without-truth]`.
#pragma once

#include "absl/status/status.h"
#include "server/vision/recognition/learnt_constants.h"

namespace horopter {

// Which scenes are answered.
struct SceneAcceptance {
  // Segments in the image that has most: of fewer nothing can be said. Chosen, commit 312385b.
  int min_segments = 5;
  // Radians between two views of an object; less is no parallax. Commit 59d2f2d, the real
  // photographs (tests/bench/history/photographs.md).
  double min_parallax_rad = 0.035;
  // Another part that scores only so much less in an object's place makes the answer ambiguous.
  // Chosen before there was data, commit 3e1b11e, and kept.
  double ambiguity_gap = 0.03;
};

// Which objects are answered (interpretation/aspect_decision.h). Scores are those of AspectScore,
// means over the views.
struct AspectAcceptance {
  // Of the likelihood ratio of what is known of an object (decision_cues.h), for an answer. Of
  // 1,980 such answers of sets held out from the fit 29 are of a part that is not there, most where
  // one of the scene's own is left out; from 0.8 on 15 of 1,931, but parts of photographs are left
  // out then (ADR 63).
  double min_probability = 0.7;
  // A part whose print stays in its places from view to view is even at this score, and with so
  // much more of the share of views that show none of it; log odds a unit of score. This share of
  // what three views and more show on it and CAD has not must be the same (AspectScore::print). Of
  // 62 scenes of which no part was looked for one had a part of .5 - .6, none more; right printed
  // boxes in noise, blur and small images score .49 - .54. ADR 53.
  double even_printed = 0.46;
  double missing_views_more = 0.16;
  double score_weight = 25.0;
  double print_tells = 0.7;
  int print_views = 3;
  // Print says nothing where views disagree so much on how bright the surface is: right parts that
  // are best of their scene have 0.27 and more.
  double surface_disagrees = 0.15;
};

// Which poses an answer names as left open (interpretation/pose_alternatives.h). All of commit
// 29794ee; `aspect_scene_report cad-dev val`.
struct PoseChoiceAcceptance {
  double min_probability = 0.02;  // less likely ones are not listed
  // Chance that an edge of the kind is found in the image where the part has it and nothing hides
  // it: contours; creases, which light may hide.
  double found_contour = 0.8;
  double found_crease = 0.55;
  // Length of edge (working px) whose points say one thing: less makes few pixels sure.
  double independent_px = 14.0;
  // No image says more than this, and half of it where its edges say as much: what they are assumed
  // to say is not all there is.
  double most_log_odds = 12.0;
  // An answer is turned when the images show it so rather than as it is with these log odds.
  double turned_log_odds = 0.1;
  double ambiguous_share = 0.3;  // alternatives this likely together make the answer ambiguous
  int most = 6;                  // listed of an object
  int most_tried = 32;           // for time
  int turns = 12;                // that stand for all of a near symmetry by any angle
};

// Which adjusted objects do not fit the cameras of the others and are left out
// (euclidean/findings.h).
struct MisfitAcceptance {
  // The edges found scatter more than this (working px) and `factor` times as widely as the
  // others'. Commit 264310e, which names no data.
  double least_px = 0.8;
  double factor = 3.0;
  // ... where aspects found the parts, by how much least_px is larger: rims and fillets scatter
  // more than sharp edges, a right part of cad-dev, scene 17, more than 0.8 px. Commit e69dd09,
  // `dataset recognize cad-dev val`.
  double aspect_scatter = 2.0;
  // An expected sample is found when an edge point is this near, working px. Commit 8251326, which
  // names no data.
  double found_px = 2.5;
  // Share of the samples expected in a view, relative to the others' share, that must be found;
  // higher: more objects are left out. Commit 3adafc1, which names no data.
  double least_found = 0.6;
  // Expected samples of a view that has a say. Chosen, commit 3adafc1.
  int min_samples = 20;
};

struct AcceptanceOptions {
  SceneAcceptance scene;
  AspectAcceptance aspects;
  PoseChoiceAcceptance pose_choices;
  MisfitAcceptance misfits;
};

// Errors: INVALID_ARGUMENT, names the field: not finite, a share or probability outside of [0, 1],
// a length, weight or count that is not positive.
absl::Status Validate(const AcceptanceOptions& options);

}  // namespace horopter
