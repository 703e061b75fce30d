// How placements are looked for by edges: what the searches and fits of the rooms from scoring to
// interpretation try, and within which reach. It decides what is found and how long that takes;
// what is answered of it stands in acceptance.h.
#pragma once

#include "absl/status/status.h"

namespace horopter {

// Gauss-Newton of one object (scoring/pose_refine.h).
struct RefineOptions {
  int iterations = 8;
  double start_reach_px = 10.0;   // association radius of the first iteration, working pixels
  double end_reach_px = 3.0;      // ... and of the last
  double focal_log_sigma = 0.35;  // prior of log f about focal_prior_px; 0 keeps f fixed
  double focal_prior_px = 0.0;
};

// Gauss-Newton of a whole scene (scene/scene_refine.h).
struct SceneRefineOptions {
  int iterations = 8;
  double start_reach_px = 8.0;
  double guess_reach_px = 12.0;  // ... of poses that are only suggested yet
  double end_reach_px = 3.0;
  int plane_matches = 240;    // at most, of all pairs
  double plane_weight = 0.5;  // of a plane match against an edge sample
};

// The plane that upright parts say (scene/standing_plane.h).
struct StandingPlaneOptions {
  double near_m = 0.025;      // feet of upright parts so near the plane count as standing on it
  double upright_rad = 0.14;  // between a stable pose's direction and the plane's normal
  double foot_sigma_m = 0.001;
  double tilt_sigma_rad = 0.02;   // prior of the given plane's normal
  double offset_sigma_m = 0.006;  // ... and of its offset
  double robust_scale_m = 0.002;  // Cauchy: a part on top of a flat one does not lift the plane
  int min_objects = 2;
};

// Texture on faces (scene/surface_texture.h).
struct SurfaceTextureOptions {
  double spacing = 1.0 / 16.0;    // of the patches on the surface, in diameters of the object
  int half_window = 5;            // a patch is a square of 2 h + 1 pixels (of images 640 wide)
  double min_deviation = 5.0;     // grey levels of 255; fainter patches say nothing
  double min_correlation = 0.7;   // alike
  double max_correlation = 0.5;   // unlike
  double shift_px = 3.0;          // a patch this far off must look clearly worse ...
  double shift_loss = 0.1;        // ... by this much in correlation
  double max_depth_share = 0.12;  // depth (diameters) that may hide in the shift: parallax needed
};

// Poses of single views (candidates/view_hypotheses.h).
struct ViewHypothesisOptions {
  int max_paths = 450;  // image paths tried; more: slower, finds smaller and more hidden parts
  float quick_reach_px = 6.0f;  // working pixels
  float give_up = 0.25f;        // mean support of the first quarter below which a pose is dropped
  int pool = 600;               // poses kept by quick score before non-maximum suppression
  int refined = 90;             // distinct poses refined
  int verified = 24;            // ... of which verified with hidden lines removed
  double distinct_px = 12.0;    // working pixels
  double min_radius_px = 12.0;  // projected radius of the part, working pixels
  double max_radius_px = 420.0;
  RefineOptions refine;  // its prior of the focal length is the request's
  // Arcs that are compared with circles of the part: angle, and width in working pixels.
  double min_sweep_rad = 1.6;
  double min_minor_px = 2.5;
  int turns = 24;  // about a circle's axis that are tried
};

// Corners in space (candidates/space_corners.h).
struct SpaceCornerOptions {
  double reach_px = 2.5;        // of a junction from the projected point, working pixels
  double direction_rad = 0.09;  // of an image edge from the projected direction
  double min_parallax_rad = 0.03;
  double min_plane_angle_rad = 0.06;  // between the planes of rays that give a direction
  double same_point_m = 0.003;        // nearer corners are one
  int max_corners = 400;              // those that most views show are kept
};

// Circles in space (candidates/space_circles.h).
struct SpaceCircleOptions {
  double reach_px = 3.0;       // of an ellipse's centre from the projected one, working pixels
  double radius_log = 0.08;    // difference of the radii that views give
  double normal_rad = 0.25;    // ... and of the normals
  double min_sweep_rad = 1.6;  // shorter arcs say too little
  double min_minor_px = 2.5;   // working pixels
  double min_parallax_rad = 0.03;
  int max_circles = 150;  // those that most views show are kept
};

// Which of many poses are kept (candidates/standing_poses.h).
struct SettleOptions {
  int settled = 24;                                               // distinct poses refined
  int kept = 8;                                                   // of these
  RefineOptions refine{.iterations = 6, .start_reach_px = 14.0};  // over all views
  float settled_reach_px = 3.0f;  // of the quick score of the refined poses
};

// Poses from corners and circles in space (candidates/corner_search.h).
struct CornerSearchOptions {
  double angle_rad = 0.10;        // between the angles of two edges, seen and of the model
  double length_share = 0.06;     // an edge may look so much longer than it is, and
  double length_slack_m = 0.002;  // ... so much
  double min_length_share = 0.2;  // of the model edge that is seen at least
  bool one_complete = false;      // one of a corner's two edges is seen in its whole length
  double radius_log = 0.06;       // difference of a circle's radius from the model's
  int turns = 24;                 // about a circle's axis that are tried
  float quick_reach_px = 7.0f;    // working pixels
  float min_quick = 0.42f;        // mean over the views
  float near_best = 1.0f;         // poses that score so much less than the best are not kept
  SettleOptions settle{.settled = 12, .kept = 4};
};

// Accumulator of poses on the plane (candidates/pose_votes.h).
struct PoseVoteOptions {
  double cell_m = 0.006;    // of position
  double cell_rad = 0.087;  // of yaw
  double cell_log = 0.04;   // of log scale
};

// Poses on the supporting plane (candidates/plane_search.h).
struct PlaneSearchOptions {
  int max_paths = 700;           // image paths per view, scale unknown
  double path_tolerance = 0.12;  // misfit of the third point, share of the path
  float quick_reach_px = 10.0f;  // working pixels
  float min_quick = 0.42f;       // mean over the views
  float known_reach_px = 7.0f;   // ... once the cameras are known well
  SettleOptions settle;
  PoseVoteOptions votes{};
  int kept_per_object = 8;      // distinct poses, scale unknown
  int refined_initial = 40;     // ... of all objects that are verified as initial hypotheses
  double min_edge_px = 14.0;    // working pixels, scale known
  double min_partial = 0.5;     // seen share of an edge of which one end is hidden
  double min_path_votes = 2.0;  // of two-edge paths, scale unknown
  double min_edge_votes = 2.2;  // of edges seen whole; 0.5 for one of which an end is hidden
  int peaks = 150;              // poses scored per standing pose of an object
  int peaks_over = 40;          // ... on a surface that is only searched over other parts
};

// Which objects of a large catalog are searched (candidates/shortlist.h).
struct ShortlistOptions {
  int searched = 32;  // objects of the best promise; a catalog that is not larger is not ranked
  int refined = 150;  // objects, best quick score first, of which poses are refined at all
  int corners_asked = 80;  // in space, best shown first, that rank the objects
  int circles_asked = 30;
  int plane_paths_asked = 120;  // ... that rank the objects standing on the plane
  // Fewer poses of each: one of a corner's edges is seen whole, circles are turned in large steps,
  // and only what comes near the best is kept.
  CornerSearchOptions corners{.min_length_share = 0.4,
                              .one_complete = true,
                              .turns = 6,
                              .min_quick = 0.47f,
                              .near_best = 0.06f,
                              .settle = {.settled = 3, .kept = 1}};
  int paths_asked = 24;  // of each image, best rank first, that rank the objects in single views
};

// Scenes from one view's hypothesis (initialization/rig_initialization.h).
struct RigInitializationOptions {
  int hypotheses_per_object = 3;  // best of each view
  int scale_steps = 48;
  // The part's depth tried, over the depth of the matched plane on its ray.
  double nearest = 0.35;
  double farthest = 1.6;
  float reach_px = 10.0f;  // working pixels
  double min_quick = 0.45;
  int refined = 24;
};

// Placements in a scene whose cameras are known (interpretation/scene_expansion.h).
struct PlacementSearchOptions {
  int kept_per_object = 12;        // distinct placements refined over all views
  double same_distance_m = 0.006;  // placements of one object nearer than this are one ...
  double same_turn_rad = 0.12;     // ... unless turned by more
  double min_raw_score = 0.35;     // placements below are not worth keeping
  float quick_reach_px = 9.0f;     // working pixels, of the transfer into the other views
  float min_quick = 0.40f;         // mean quick score over the views
  // Of a hypothesis in its own view, the scene's camera fixed, before it is transferred.
  RefineOptions settle{.iterations = 3, .start_reach_px = 6.0, .focal_log_sigma = 0.0};
  RefineOptions refine;  // over all views
  // Log-likelihood ratio of parts whose edges are taken out of the search for others.
  double sure_log_odds = 4.0;
  double doubtful_score = 0.42;  // of parts whose tops are searched though they are not accepted
  int max_surfaces = 6;          // heights searched, the plane included
  int plane_voters = 40;         // best placements that vote for the plane
};

struct EdgeSearchOptions {
  ViewHypothesisOptions views;
  RefineOptions linking{.start_reach_px = 14.0};  // of a view to others (view_linking.h)
  SceneRefineOptions scene_refine;
  SpaceCornerOptions space_corners;
  SpaceCircleOptions space_circles;
  CornerSearchOptions corners;
  PlaneSearchOptions plane;
  // The first round's, whose cameras know one part only.
  PlaneSearchOptions plane_first_look{.settle = {.settled = 8, .kept = 4}, .peaks = 50};
  int plane_scales = 3;  // of the supporting plane's scenes that are grown
  ShortlistOptions shortlist;
  RigInitializationOptions rig;
  StandingPlaneOptions standing_plane;
  SurfaceTextureOptions texture;
  PlacementSearchOptions placements;
};

// Errors: INVALID_ARGUMENT, names the field: not finite, a count, reach or size that is not
// positive, a share outside of [0, 1].
absl::Status Validate(const EdgeSearchOptions& options);

}  // namespace horopter
