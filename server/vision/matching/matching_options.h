// What can be set about the matching stage.
#pragma once

#include "server/vision/features/feature_options.h"

namespace horopter {

// Which views are compared (view_graph.h).
struct ViewGraphOptions {
  int all_up_to = 8;  // views; so few are compared each with each
  int best = 4;       // partners of highest score that every view has at least; more: dearer, surer
};

// Which cues tell features alike (feature_similarity.h).
struct SimilarityOptions {
  bool parameters = true;   // 2.7.1: length, angle, contrast, colours, types
  bool correlation = true;  // 2.7.2: windows
};

// One-to-one assignment of candidates (assignment.h).
enum class AssignmentMethod {
  kGreedy,       // `self` alone, best first
  kSpectral,     // leading eigenvector (Leordeanu and Hebert 2005)
  kRandomWalks,  // reweighted random walks with mutual exclusion (Cho, Lee and Lee 2010)
};

struct AssignmentOptions {
  AssignmentMethod method = AssignmentMethod::kSpectral;
  int iterations = 30;       // of the power iteration, at most
  double reweighting = 0.2;  // share of the walk that follows the links; the rest jumps (alpha)
  double inflation = 30.0;   // how strongly jumps prefer likely candidates (beta)
};

// Matches of a pair of views (match_features.h).
struct FeatureMatchOptions {
  SimilarityOptions similarity;
  AssignmentOptions assignment;  // the default finds most (tests/bench/results.md)
  // 2.7.3: neighbouring matches must imply like transformations; without it only that they are
  // neighbours in both views counts.
  bool transformations = true;
  int per_feature = 5;          // candidates kept per feature, in both directions; more: slower
  double min_candidate = -1.0;  // log-likelihood ratio of a candidate; higher: fewer
  double min_accepted = 3.0;    // ... of a match with its neighbours' support; higher: surer, fewer
};

// A plane's homography from patches (plane_patches.h).
struct AlignOptions {
  // The start comes from other alignments: its first, most generous search is left out.
  bool start_is_aligned = false;
  double min_correlation = 0.7;  // NCC of 16x16 patches; locally normalised noise reaches 0.5
};

// A fundamental matrix from matches alone (robust_fundamental.h).
struct RobustFundamentalOptions {
  double inlier_px = 2.0;  // Sampson distance; higher: more inliers, more wrong ones
  int hypotheses = 1500;   // samples of seven
  int min_inliers = 10;    // seven always agree
  double min_share = 0.4;  // of the matches; fewer agree by chance
  // Inliers that the best homography does not explain, at least, and their share: before a plane F
  // has two freedoms left that wrong matches fill (98 % inliers and still wrong: measured).
  int min_off_homography = 6;
  double min_off_homography_share = 0.2;
  double homography_px = 3.0;
  // Largest predicted deviation of an epipolar line at an inlier.
  double max_sigma_px = 1.0;
  unsigned seed = 1;
};

// ... from a plane and what lies off it (plane_parallax.h).
struct ParallaxOptions {
  double on_plane_px = 2.0;   // displacement up to which a point counts as lying on the plane
  double epipolar_px = 2.0;   // inlier distance to the epipolar line
  int min_off_plane = 5;      // off-plane matches needed; two define the epipole
  double min_surprise = 2.5;  // matches found / matches expected by chance
  // Largest predicted deviation of the epipolar lines at the matches. Measured: above 0.6 px most
  // are wrong.
  double max_sigma_px = 0.55;
  // Share of the off-plane junctions that must agree; real pairs reach 0.2 - 0.7.
  double min_share = 0.15;
  int hypotheses = 1500;
  unsigned seed = 1;
};

// Camera centres of all views of a plane (plane_centres.h).
struct PlaneCentresOptions {
  double inlier_px = 2.0;     // reprojection
  double on_plane_px = 2.0;   // displacement up to which a point counts as lying on the plane
  int min_off_plane = 6;      // consistent points off the plane that a view needs
  double min_share = 0.25;    // ... and of those that the other views fix
  double max_sigma_px = 0.8;  // predicted deviation of the epipolar lines of a pair
  int starts = 6;             // pairs of views tried as a start
  int hypotheses = 300;       // samples of two points per view and start
  unsigned seed = 1;
};

// Pairs that three views contradict (three_views.h).
struct ThreeViewOptions {
  double transfer_px = 4.0;  // of a handed-on point from its epipolar line, larger of both images
  int min_handed_on = 5;     // fewer points in three views say nothing
  double min_share = 0.5;    // of them must agree, on each of the three ways round
};

// Segments that lie on the plane (on_plane.h).
struct OnPlaneOptions {
  double max_distance_px = 1.5;   // of the warped segment's ends from the found one's line
  double max_angle_rad = 0.0698;  // 4 degrees
  double min_overlap = 0.5;       // of the warped segment
  double min_epipolar_angle_rad =
      0.1745;  // 10 degrees: a segment along the epipolar line never leaves it
};

// Texture points over views (texture_matching.h).
struct TextureOptions {
  int max_keypoints = 2500;    // of an image; more: slower, quadratically
  double contrast = 0.008;     // SIFT's threshold; lower: more, weaker points
  double ratio = 0.85;         // Lowe's; higher: more, wronger matches
  double inlier_px = 1.5;      // MAGSAC's threshold, of a VGA image; grows with the image
  double homography_px = 3.0;  // likewise, of what one homography explains
  // Matches that agree, at least, and their share beyond seven: what so many agree on by chance.
  int min_inliers = 15;
  double min_share = 0.06;
  // Images are reduced to so many pixels, for time.
  int max_pixels = 500'000;
  // Matches that stand still between two images while others move (by more than this, of a VGA
  // image) show what does not belong to what moves: a background behind a turntable, dirt on a
  // lens. They are left out where so many others agree.
  double still_px = 1.5;
  // Keypoints by which the partners of a view are chosen among many (ViewGraphOptions), and the
  // ratio of a vote.
  int vote_keypoints = 300;
  double vote_ratio = 0.8;
  unsigned seed = 1;
};

struct MatchingOptions {
  double sift_contrast = 0.004;  // on the locally normalised image; lower: more, weaker points
  double ratio = 0.87;           // Lowe's ratio; higher: more, wronger matches
  double ransac_px = 2.0;        // MAGSAC threshold of the plane homography
  int min_plane_inliers = 14;    // measured: all sets >= 14 were right within 2.7 px
  double loop_max_px = 4.0;      // chained homographies must agree with direct ones within this
  double epipolar_px = 2.0;      // inlier distance to the epipolar line
  // Bound of the strongest kept per image; the efforts keep 500 to 2000 (plane_links.cc). Lower:
  // faster, fewer links on faint or large texture.
  int max_keypoints = 4000;
  // Views of a repeated texture are linked too, though a homography a whole period off looks as
  // right.
  bool repeated_texture = false;
  FeatureGraphOptions graph;  // of each view (features/feature_graph.h)
  ViewGraphOptions views;
  TextureOptions texture;
  FeatureMatchOptions features;
  AlignOptions alignment;  // start_is_aligned: where it is
  // The distance to epipolar lines and the seeds of these are the ones here. What a free F needs
  // was chosen in a one-off experiment on all pairs of parts-train without a plane; its lines may
  // be less sure than those of the end: the matches along them make it sharper.
  RobustFundamentalOptions fundamental{.min_share = 0.45, .max_sigma_px = 1.6};
  ParallaxOptions parallax;
  PlaneCentresOptions centres;
  ThreeViewOptions three_views;
  OnPlaneOptions on_plane;
  int threads = 1;  // cores to use; the result does not depend on it
  unsigned seed = 1;
};

}  // namespace horopter
