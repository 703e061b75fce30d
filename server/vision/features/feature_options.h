// What can be set about the features stage.
#pragma once

#include <vector>

#include "absl/status/status.h"

namespace horopter {

// How the gradients of a colour image become fields in which edges are linked.
enum class ColourGradient {
  // One field for each of B, G, R, 1.5 (R - G) and 1.5 ((R + G) / 2 - B): finds most, because two
  // edges 2 px apart rarely hide each other in every channel.
  kEachChannel,
  // One field: the strongest of the five, each over its own noise threshold.
  kStrongestChannel,
  // Root of the largest eigenvalue of J^T J over B, G, R (Di Zenzo 1986).
  kVectorValued,
  // (1 - s) x intensity gradient + s x colour gradient, s the saturation (thesis 2.2).
  kSaturationWeighted,
  // Of 0.114 B + 0.587 G + 0.299 R.
  kIntensity,
};

struct GradientOptions {
  ColourGradient colour = ColourGradient::kStrongestChannel;
  // A channel's threshold (of |dx| + |dy| summed over 3x3 pixels: 6 x the slope in grey levels per
  // pixel) is noise_factor x its median gradient, between the two bounds, but never below
  // noise_floor x the median that its quietest 5 % suggest: in an image full of noise a fixed
  // bound would make all of it an edge.
  double noise_factor = 5.0;
  double min_threshold = 6.0;
  double max_threshold = 20.0;
  double noise_floor = 2.2;
};

struct LinkingOptions {
  // Hysteresis in thresholds of the field: chains start at `high` and go on down to `low`. Higher:
  // fewer edges, more gaps.
  double high = 2.5;
  double low = 1.2;
  int max_gap_px = 4;     // pixels without a maximum across the edge that a chain may bridge
  double gap_low = 0.35;  // ... while the gradient is at least this many thresholds
  int min_chain_px = 8;   // shorter chains are dropped
};

struct SplitAndMergeOptions {
  double split_px = 1.4;  // a piece whose points leave its chord by more is cut; higher: fewer cuts
  double merge_rms_px = 0.7;  // neighbours that one line fits this well are joined again
  int min_points = 6;         // shorter pieces are left out of the result
};

// Which edge detector feeds the stage.
enum class EdgeDetector {
  // One gradient field over all channels, ridge linking, split and merge.
  kLinkedField,
  // EDLines (OpenCV) on five channels, joined: the recipe of the front-end study.
  kEdgeDrawingChannels,
};

// How chains are cut into pieces; see chain_splitting.h.
enum class ChainSplittingMethod {
  kSplitAndMerge,       // chord distance and joint line fits; straight pieces only
  kCurvatureThreshold,  // maxima of |curvature| above one threshold for all chains
  kCurvatureTemplates,  // correlation of the curvature with peaks and steps (thesis 2.3)
};

// When two pieces are the same straight edge.
enum class MergeTest {
  kTolerances,   // merge_angle_rad and merge_offset_px
  kStatistical,  // chi-square of offset and angle under the deviations of both (thesis 2.5)
};

// Curvature along a chain (chain_curvature.h).
enum class CurvatureMethod {
  // Curvature, at the point, of the ellipse fitted to the points of a window (thesis 2.3). A window
  // whose points leave no ellipse (a line) has curvature 0.
  kEllipse,
  // Circle through the point and the two that are half_width away (Menger): the cross-check.
  kCircle,
};

struct CurvatureOptions {
  CurvatureMethod method = CurvatureMethod::kEllipse;
  // l: the window is the points i - l .. i + l. Higher: less noise, lower and wider peaks.
  int half_width = 5;
};

// Shapes of thesis figure 2.6, as we read them: kPeak is 0 over L1, a triangle over L2, 0 over L3
// (two lines meet); kStepUp is 0 over L1, rises over L2, 1 over L3 (a line runs into an arc, or an
// arc into a tighter one); kStepDown is its mirror image.
enum class TemplateShape { kPeak, kStepUp, kStepDown };

// Lengths in chain points.
struct CurvatureTemplate {
  TemplateShape shape = TemplateShape::kPeak;
  int before = 0;  // L1
  int middle = 0;  // L2: about the window of the curvature
  int after = 0;   // L3

  int Length() const { return before + middle + after; }
};

// Two parametrisations of each shape, for curvature of half-width 5: short ones for features close
// together, long ones that hear weaker steps.
std::vector<CurvatureTemplate> DefaultTemplates();

// Cuts where the curvature has the shape of a template (template_splitting.h).
struct TemplateSplittingOptions {
  std::vector<CurvatureTemplate> templates = DefaultTemplates();
  double threshold = 0.5;  // of the correlation; higher: fewer cuts
  // Curvature (1/px) that noise gives: it counts as part of the signal that no template explains,
  // so that the correlation of a shape no higher than it stays low. 0: the plain normalised
  // correlation, which cuts straight edges wherever their noise has one of the shapes.
  double noise_curvature = 0.014;
  int suppression = 8;  // points on both sides of a cut in which there is no other
};

// Pieces of chains (chain_splitting.h).
struct ChainSplittingOptions {
  ChainSplittingMethod method = ChainSplittingMethod::kSplitAndMerge;
  SplitAndMergeOptions split_and_merge;
  CurvatureOptions curvature;          // of the two curvature methods
  TemplateSplittingOptions templates;  // of kCurvatureTemplates
  double max_curvature = 0.045;        // 1/px, of kCurvatureThreshold; higher: fewer cuts
  int suppression = 8;                 // points, of kCurvatureThreshold
  int min_points = 6;                  // of the two curvature methods: shorter pieces are left out
  // Neighbouring pieces of the two curvature methods are joined again while one line or one ellipse
  // leaves at most this many times what their own leave (rms). 0: never, as in the thesis, which
  // joins fitted features later (2.5). Higher: fewer cuts across smooth curves, weak corners lost.
  double rejoin_factor = 1.3;
  double rejoin_rms_px = 0.4;  // ... and leaves no more than this
  // A piece is curved when the parabola over its line rises by more, and by 3 of its deviations.
  double straight_sagitta_px = 0.7;
};

// First guesses of ellipses (arc_seeds.h).
struct ArcSeedOptions {
  double max_rms_px = 0.7;      // of the points about the ellipse
  double min_sweep_rad = 1.0;   // of one run of points; higher: fewer rounded corners taken
  double min_sagitta_px = 1.5;  // how far a run must leave its chord
  double min_semi_minor_px = 2.0;
  double max_aspect = 10.0;
  int max_run_seeds = 150;          // of the longest runs; higher: slower in texture
  int max_bows = 500;               // bows paired at most, the strongest
  int partners = 6;                 // tried for each bow, the nearest
  double max_bow_distance_px = 90;  // between the middles of two that are paired
  double max_pair_rms_px = 0.4;
  int max_pairs = 150;  // the best fits are kept
};

// ... grown along their rims (rim_evidence.h).
struct RimOptions {
  double min_strength = 0.5;  // thresholds; of a place that counts as seen
  double max_offset_px = 1.0;
  double first_look_share = 0.5;  // of a few places, on guesses that claim the whole rim
  int rounds = 2;                 // of measuring and fitting again
};

// Elliptic arcs (arcs.h).
struct ArcOptions {
  ArcSeedOptions seeds;
  RimOptions rim;
  double min_sweep_rad = 1.0;       // of an arc grown from one run
  double min_pair_sweep_rad = 4.0;  // ... from two bows, which prove less by themselves
  double min_seen_share = 0.7;      // of the arc's sweep with a gradient across it
  double max_covered_share = 0.8;   // of an arc by better ones; more: it is dropped
  int max_arcs = 400;               // those of which most is seen are kept
};

// Segments and arcs that are one edge (co_conic.h).
struct CoConicOptions {
  double near_px = 1.2;       // of a segment's points from the arc
  double angle_rad = 0.35;    // between directions; a chord's ends turn by half of what it spans
  double chord_share = 0.75;  // of a segment along the arc: the segment is one of its chords
  // Of the arc along segments that go on straight beyond it: the arc only touches them and is
  // dropped.
  double max_straight_share = 0.35;
};

// Where segments meet arcs (conic_junctions.h).
struct ConicJunctionOptions {
  double max_gap_px = 8.0;         // from the segment's end to the ellipse, along the line
  double max_gap_fraction = 0.35;  // ... and at most this share of the segment
  double end_gap_px = 8.0;         // from an end of the arc: the arc ends here too
  double tangent_rad = 0.2;        // between line and ellipse: they run into each other
};

// What lies next to what; asked for by the next stage (feature_graph.h).
struct FeatureGraphOptions {
  double reach_px = 48.0;           // between the nearest points of two related segments
  double collinear_px = 1.5;        // offset of the shorter from the longer one's line
  double collinear_rad = 0.0524;    // 3 degrees
  double parallel_rad = 0.0873;     // 5 degrees: images of parallel edges converge
  double parallel_overlap = 0.5;    // of the shorter one
  double min_parallel_px = 2.0;     // nearer ones are one edge
  double max_region_colour = 24.0;  // distance in BGR; higher: more regions join
  int max_neighbours = 8;           // of kCollinear and of kParallel for each segment, the nearest
};

// gradient_threshold to smoothing_sigma_px belong to kEdgeDrawingChannels and are the recipe of the
// front-end study: gradient 20, anchor 4, sigma 1.
struct FeatureOptions {
  EdgeDetector detector = EdgeDetector::kLinkedField;
  GradientOptions gradient;
  LinkingOptions linking;
  // Moves the points of kLinkedField to where the light has its step: see light_response.h.
  bool undo_response = true;
  ChainSplittingOptions splitting;  // of kLinkedField
  // Threshold of a channel's gradient (sum of |dx| + |dy| over 3x3 pixels: 6 x the slope per pixel)
  // = noise_factor x the channel's median gradient, between the two bounds: quiet images show
  // weaker edges. Higher: fewer, stronger edges.
  double gradient_threshold = 20.0;
  double min_gradient_threshold = 6.0;
  double noise_factor = 5.0;
  double anchor_threshold = 4.0;        // higher: fewer, longer chains
  double smoothing_sigma_px = 1.0;      // higher: less noise, rounder corners
  double min_segment_length_px = 10.0;  // shorter pieces are dropped
  MergeTest merge_test = MergeTest::kTolerances;
  double merge_chi_square = 13.8;          // of two degrees of freedom: 0.1 % of true pairs refused
  double merge_angle_rad = 0.0524;         // 3 degrees
  double merge_offset_px = 1.5;            // lateral
  double merge_gap_px = 10.0;              // along
  double junction_gap_px = 14.0;           // end to intersection, at most
  double junction_gap_fraction = 0.35;     // ... and at most this share of the segment
  double junction_min_angle_rad = 0.2618;  // 15 degrees
  double texture_max_length_px = 40.0;     // longer segments are never texture
  double texture_density = 0.07;  // points of short chains per pixel; higher: fewer segments marked
  ArcOptions arcs;
  CoConicOptions co_conic;
  ConicJunctionOptions conic_junctions;
  int max_segments = 4000;  // the strongest are kept; the cut is said in counts
};

}  // namespace horopter
