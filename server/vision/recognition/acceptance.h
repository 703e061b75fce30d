// Everything that decides whether what was found is answered, by edges or by aspects. The rooms
// read these values and hold none of their own.
//
// What is fitted stands in learnt_constants.h. The others were set by hand on answers of the data
// set named, last in the commit named (tests/bench/history). What they do is seen in the answers of
//   `recognition_report DATASET SPLIT --trials all,none`  (edges; unless said otherwise) and
//   `aspect_scene_report DATASET SPLIT [--without-truth]` (aspects).
#pragma once

#include "absl/status/status.h"
#include "server/vision/recognition/learnt_constants.h"

namespace horopter {

// Which placements make up a scene (interpretation/scene_expansion.h).
struct PlacementAcceptance {
  // Joint support of an accepted object on the supporting plane, or when no plane is known; higher:
  // fewer, surer objects. Commit 21eea77, parts-dev.
  double min_score = kChanceSupport;
  // ... of one that rests on nothing known. Commit 312385b, parts-dev.
  double off_plane_score = 0.78;
  // Metres between the lowest point of a part and what it stands on. Commit 312385b, parts-dev.
  double plane_tolerance_m = 0.006;
  // Share of the smaller volume that two solid parts may have in common, for the error of their
  // poses and shapes of cells. Commit 312385b, parts-dev.
  double max_shared_volume = 0.08;
  // Share of an object's explained edges that accepted objects explain already: one image edge
  // serves one object. Commit e5b8d30, parts-dev.
  double max_shared_edges = 0.5;
  // Log-likelihood ratio (log_odds.h) of an upright part that stands on nothing known. Commit
  // bec4545, parts-dev and parts-train.
  double floating_log_odds = 4.0;
  // Of half hidden parts (AddHiddenObjects): of 258 wrong placements beside the parts of scenes of
  // parts-dev, parts-train and of other parts none stands so and reaches both, of 6 right ones 5
  // do. Commits b6e7799 and, for the slack before its own refinement, de757fa.
  double hidden_score = 0.50;
  double hidden_sharpness = 0.50;
  double hidden_slack = 0.06;
  // Probability of a scene to which they are added. Commit b6e7799, the same scenes.
  double sure_scene = 0.9;
  // Cosine of the angle between a stable pose's upward direction and the plane's normal, 6 degrees:
  // within it a part stands upright. Commit 312385b, parts-dev.
  double upright_cos = 0.9945;
  // Metres by which the planes that parts stand on may differ and be one. Commit 312385b,
  // parts-dev.
  double same_plane_m = 0.008;
  // Placements come in the order of their score above this by the root of what supports it, working
  // px: sure and large ones first. Commit 312385b, parts-dev.
  double priority_score = 0.45;
  // A placement behind a plane of matched texture must have so many times the priority of any on it
  // to show that the plane carries no parts. Commit 0f32eb3, which names no data.
  double behind_factor = 2.0;
};

// Which scenes, and which objects of a scene, are answered (interpretation/decision.h, answer.h).
struct SceneAcceptance {
  // Segments in the image that has most: of fewer nothing can be said. Chosen, commit 312385b.
  int min_segments = 5;
  // Of a scene, by the fit kScenePriorLogOdds; higher: fewer, surer answers. An even bet is what
  // the fit is made for. Commit d8af989, parts-train.
  double min_probability = 0.5;
  // Of an object beside others, by the fit kObjectPriorLogOdds: of 16 look-alikes in the place of a
  // part left out of the catalog seven are below and no right object. Commit 7b5f2c2, parts-train
  // with --trials all,one.
  double min_object_probability = 0.4;
  // A focal length may lie so many prior deviations from where the images alone, or the caller, put
  // it. Commit 4ed3457, parts-train.
  double max_focal_deviations = 4.0;
  // Radians between two views of an object; less is no parallax. Commit 59d2f2d, the real
  // photographs (tests/bench/history/photographs.md).
  double min_parallax_rad = 0.035;
  // An alternative hypothesis closer than this in score makes the answer ambiguous. Chosen before
  // there was data, commit 3e1b11e, and kept.
  double ambiguity_gap = 0.03;
  // ... and another pose of the same object, where it alone determines the cameras: these then
  // adapt to the wrong pose. On parts-dev such alternatives of right poses lay 0.13 and more behind
  // (one of 25 by 0.06), on the dotted box of the real photographs the right pose 0.11 behind.
  // Commit 59d2f2d.
  double loose_ambiguity_gap = 0.12;
};

// What takes the place of an accepted object (interpretation/alternative_hypotheses.h).
struct AlternativeAcceptance {
  // Mean distance of the edges, in diameters, after a turn that is nearly a symmetry. Commit
  // 59d2f2d, parts-dev.
  double misfit_diameters = 0.06;
  // Share of its volume that a placement has in common with another in the same place. Commits
  // 59d2f2d and, for the best competing placements, 9a238d6, parts-dev among 1,000 objects.
  double min_shared_volume = 0.3;
  // Of score before its own refinement: worse ones are not looked at. Commit 59d2f2d, parts-dev.
  double max_score_deficit = 0.15;
  int most_per_object = 8;  // for time
  // Of score that another object of the scene may lose. Commit 4ed3457, parts-train.
  double max_harm = 0.1;
  // Of score a unit of log odds of texture is worth between two placements. Commit 50f91b5, the
  // real photographs (`recognition_report REAL SPLIT`).
  double texture_weight = 0.05;
  // Difference in texture (log odds) that decides alone: shadow and what stands before a plain part
  // say as much by chance as less. Commit 5f7c679, parts-dev and the real photographs.
  double clear_texture = 3.5;
  // Lead in score that decides between two poses of one object, whatever their description-length
  // gain, which penalises predicted edges that are not seen, and the pose that shows a pocket
  // predicts more of them. Commit 5f7c679, parts-dev.
  double clear_lead = 0.01;
  // Of score a unit of sharpness is worth between such poses. Commit 584e846, parts-dev.
  double sharpness_weight = 0.2;
};

// Which objects the aspects answer, and which answers of other routes stand before what cameras
// should see of them (interpretation/aspect_route.h). Scores are those of AspectScore, means over
// the views.
struct AspectAcceptance {
  // How sure an object is: by a likelihood ratio of what is known of it (decision_cues.h), or by
  // thresholds over its score (even_lying and so on), which were set by hand.
  enum class Decision { kFitted, kThresholds };
  Decision decision = Decision::kFitted;
  // Of the likelihood ratio, for an answer. Of 1,980 such answers of sets held out from the fit 29
  // are of a part that is not there, most where one of the scene's own is left out; from 0.8 on 15
  // of 1,931, but parts of photographs are left out then (ADR 63).
  double min_fitted_probability = 0.7;
  // Median score of another route's answer: above it stands, below it is refused, in between the
  // aspects' own answer is asked for and the better one taken (they find nothing: refused).
  // Commit 4502559, parts-dev and cad-dev.
  double confirming_score = 0.45;
  double contradicting_score = 0.25;
  double chance_score = 0.40;  // of wrong poses: what exceeds it counts when answers are compared
  // Log odds that an object is right: weight x (score - what makes it even). Cameras adapt to the
  // first object: it must say more than those that others share cameras with, more still when it
  // links few of the views or only by focal lengths that differ much, and most in one view alone.
  // On cad-dev right objects score 0.41 - 0.92 beside others and 0.57 - 0.92 alone; wrong ones up
  // to 0.60 where none of a scene's parts is enrolled, see "Decision" in tests/bench/results.md.
  // Commits 4502559 (weight), 980bbdf (one view) and fbe0dae, `aspect_scene_report cad-dev val`
  // with and without --without-truth.
  double score_weight = 25.0;
  // Beside an object of sure_score: of one that lies on a plane with it or on it, and of another.
  // Below 0.46 there were 18 right and one wrong of the first and none right of 181 of the second.
  // Commit of ADR 39, `aspect_scene_report --least 0.28` on cad-dev, parts-dev, parts-train and 18
  // scenes of other people's parts, the same without their parts.
  double even_lying = 0.335;
  double even_score = 0.475;
  // ... of one that is level with a plane of others, above it, and whose surface views do not deny:
  // it stands on something that is no part. Of such beside sure parts five right ones had .40 - .61
  // and the best wrong one .33. ADR 54.
  double even_level = 0.42;
  double surface_level = 0.3;
  // ... and of one that lies on a plane and on whose surface the views agree: this correlation of
  // brightness, of so many ordered pairs of views. ADR 54. Of the places that ADR 57's search lists
  // wrong ones reach .25 - .29, right ones begin at .26.
  double even_lying_surface = 0.30;
  double surface_tells = 0.5;
  int surface_pairs = 6;
  // Of one that leans where several others lie on a plane: six such had up to 0.53, and all were
  // wrong; right ones that lie on nothing known are level. ADR 52.
  double even_leaning = 0.56;
  double even_alone = 0.53;
  double even_in_one_view = 0.58;
  double sure_score = 0.546;
  // Of the best part and of another one in cameras that three and more views share: then the first
  // counts as one beside others, too. Of 56 such scenes of which no part was looked for none
  // reached both (0.58 and 0.44, 0.49 and 0.49); of 82 scenes with their parts 10 more right parts
  // are answered and no wrong one. Commit c2db53f, `aspect_decision_report.py` on what
  // `aspect_scene_report` says of cad-dev, parts-dev, parts-train and two one-off sets.
  double accompanied_score = 0.52;
  double companion_score = 0.47;
  double companion_lying = 0.42;  // ... that lies on a plane with it
  // The same of the best part and so many parts of this score in all: granite leaves little of any
  // one. Of the 56 scenes of which no part was looked for that have three views none has more than
  // two parts of 0.40; one without known parts had 0.50, 0.43 and 0.41.
  int company_objects = 3;
  // So many parts that lie on a plane together are company with so little: each pose was settled
  // freely, and by chance one in some thousand lies on another's plane. Of 46 scenes of which no
  // part was looked for one has two parts that do, none three. Commit of ADR 40, cad-dev and 30
  // scenes of other people's parts.
  double company_lying = 0.38;
  // Two of this score are company where the views agree on the brightness of the best one's
  // surface (its correlation between them): then no view is turned. ADR 52.
  double pair_lying = 0.45;
  double pair_surface = 0.8;
  double company_score = 0.44;
  double company_best_score = 0.47;
  double company_even = 0.43;  // each of them
  // Most that company makes sure of: less than sure_probability, so that the dearer routes are
  // asked too. Scene 13 of parts-train: two objects by aspects in company, four by the supporting
  // plane.
  double company_probability = 0.85;
  // Of focal_spread_free: how much the focal lengths may differ where parts agree; zooming cameras
  // of rendered sets differ by 0.11 at most, and are known to some per cent. The scenes of
  // missing_views_more: none without its parts is lifted by what is above 0.7.
  double accompanied_focal_share = 0.85;
  int accompanied_views = 3;  // of such a scene, at least; two adapt to a wrong part
  // All images show the scene: what a part alone must score more where no view is linked; of the
  // views that are not so much of it. Wrong parts alone in 3 of 4 views had up to 0.575, in all of
  // four and more 0.513; right ones left out none of four and more. cad-dev and 18 scenes of other
  // people's parts, with and without their parts; commit of ADR 39, `aspect_decision_report.py`.
  double missing_views_more = 0.16;
  // What a part alone must score where three views and more agree on the texture of the plane it
  // rests on (surface_agreement.h), whose correlation is this in each of them: then its cameras
  // hold for what is around it. Of 36 scenes of which no part was looked for none has more than
  // 0.27. Commit of ADR 41, `aspect_scene_report` on cad-dev and 12 scenes of other people's parts.
  double ground_agrees = 0.35;
  double even_on_ground = 0.46;
  // As much is enough for a part whose print stays in its places from view to view: this share of
  // what three views and more show on it and CAD has not (AspectScore::print, of the middle view).
  // Of 62 scenes of which no part was looked for one had a part of .5 - .6, none more; right
  // printed boxes in noise, blur and small images score .49 - .54. ADR 53.
  double print_tells = 0.7;
  // ... and what it must score more where the views do not agree on how bright its surface is:
  // right parts that are best of their scene have 0.27 and more. The same commit and scenes.
  double surface_disagrees = 0.15;
  double disagreement_more = 0.25;
  // As much more where the ground around the first part has texture (grey levels), the views agree
  // on it less than so much, and neither two parts lie on a plane together nor three are company;
  // surfaces of revolution are left out. Of 40 linked scenes with their parts 3 are like that: one
  // of wrong parts, one of a part turned wrongly in a view, one of two views of four; of 30 without
  // their parts 15. Commit of ADR 43, `aspect_scene_report` on sets D, E and F of results.md.
  double telling_texture = 7.0;
  double ground_disagrees = 0.15;
  double focal_spread_free =
      0.15;  // deviation of the views' log focal lengths; what exceeds it ...
  double focal_spread_more = 0.45;  // ... adds so much of it
  double min_probability = 0.6;     // commit 4502559, the same scenes
  // Of the surest object of an answer that no other route shares: below it the dearer routes are
  // asked too, and the answer with more log odds is taken. Scene 13 of parts-train: one object by
  // aspects, 0.62, against four, 0.97 and more. Commit of ADR 32, `dataset recognize parts-train`.
  double sure_probability = 0.9;
  // Precision of what is added beside the objects of a confirmed answer of another route: blocks
  // fit into other blocks' edges; wrong ones had 0.59 and 0.67, right ones 0.69 and more. Commit
  // 07f9a46, `aspect_scene_report parts-dev val`.
  double other_precision = 0.70;
  // Share of its projected diameter by which two placements of one part are one place in an image.
  // Commit f9fb7b8, which names no data.
  double same_place_share = 0.2;
  // Share of the smaller diameter within which two parts' centres are one place: an object of
  // another route's answer that got lost is not put back there. The same commit.
  double apart_share = 0.4;
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
  PlacementAcceptance placements;
  SceneAcceptance scene;
  AlternativeAcceptance alternatives;
  AspectAcceptance aspects;
  PoseChoiceAcceptance pose_choices;
  MisfitAcceptance misfits;
};

// Errors: INVALID_ARGUMENT, names the field: not finite, a share or probability outside of [0, 1],
// a length, weight or count that is not positive.
absl::Status Validate(const AcceptanceOptions& options);

}  // namespace horopter
