// What can be set about the reconstruction stage.
#pragma once

#include <vector>

#include "server/vision/reconstruction/robust_loss.h"

namespace horopter {

// Adjustment over a plane (bundle_adjustment.h).
struct BundleOptions {
  double focal_prior_widths = 1.5;
  double focal_prior_log_sigma = 0.5;
  double k1_sigma = 0.04;  // prior of the radial coefficient about 0
  // Of each coordinate of the principal point, which is fixed at the image's centre unless it is
  // given. 0.012: uniform within 2 %.
  double principal_point_sigma_widths = 0.012;
  double loss_px = 1.0;  // Cauchy scale
  int max_iterations = 40;
  bool covariance = false;  // fill the deviations of log f
};

// Pairs of views of tracks (view_pairs.h).
struct ViewPairOptions {
  double gate_sigma = 3.0;    // Sampson distance of an inlier; raising it lets more outliers in
  int max_iterations = 1500;  // of RANSAC; enough for 50 % wrong pairs
  double confidence = 0.999;
  int min_inliers = 8;
  unsigned seed = 1;
};

// Cameras and points by factorisation (alternation.h).
struct DepthDecompositionOptions {
  int rounds = 30;
  // Views that see fewer than this share of the points are left out; raising it leaves less to
  // impute.
  double min_view_share = 0.5;
};

struct AlternationOptions {
  int max_sweeps = 25;
  // Divides rows by the depths of the previous sweep, so that image distances are minimised.
  // Without it the distances are algebraic, as first proposed.
  bool geometric = true;
  RobustLoss loss = RobustLoss::kTukey;
  // Scale of the loss in the first sweep, in sigmas times its tuning constant; shrinks by `anneal`
  // per sweep down to 1. Larger: a worse start is forgiven.
  double start_scale = 8.0;
  double anneal = 0.75;
  double relative_change = 1e-4;  // of the rms between sweeps, at which it stops early
};

// Adjustment of a projective scene (projective_bundle.h).
struct ProjectiveBundleOptions {
  RobustLoss loss = RobustLoss::kCauchy;
  double loss_scale = 1.0;  // times TuningConstant(loss), in sigmas
  int max_iterations = 30;
  double function_tolerance = 1e-6;
};

// A projective scene of tracks (grow_projective.h).
enum class ProjectiveStart {
  kBestOf,        // pairs, then triples where pairs do not suffice
  kFundamental,   // the pair with most parallax
  kTrifocal,      // three views, points and lines
  kFactorisation  // decomposition of the projective depths; wants few outliers and complete tracks
};

struct GrowOptions {
  ProjectiveStart start = ProjectiveStart::kBestOf;
  ViewPairOptions pairs;
  DepthDecompositionOptions depths;
  AlternationOptions alternation;  // sweeps and scale: of a start; the growth has its own
  int max_starts = 8;
  // Share of a view's observations of known features that must fit, or it is not registered.
  double min_inlier_share = 0.5;
  // An observation is an outlier beyond this chi^2 (2 degrees of freedom, 99.9 %), times the
  // estimated variance.
  double outlier_chi2 = 13.8;
  // The first adjustment is rough: it sorts out what the others should see. Tolerance: 1/50 of what
  // one observation adds to the cost. A milder last one: kCauchy.
  ProjectiveBundleOptions rough{
      .loss = RobustLoss::kCauchy, .max_iterations = 3, .function_tolerance = 1e-5};
  ProjectiveBundleOptions bundle{
      .loss = RobustLoss::kTukey, .max_iterations = 15, .function_tolerance = 1e-5};
  bool bundle_adjust = true;  // false: alternation alone, the thesis's result
  // Largest standard deviation of the least determined camera parameters (|P| = 1, balanced gauge)
  // that is still called a reconstruction.
  double max_deviation = 0.06;
  int min_views = 2;
  unsigned seed = 1;
};

// Adjustment of a calibrated scene (calibrated_bundle.h).
struct CalibratedBundleOptions {
  double focal_prior_widths = 1.5;  // weak prior of every focal length, image widths
  double focal_prior_log_sigma = 1.0;
  double principal_point_sigma_widths = 0.02;  // about the image's centre
  bool estimate_k1 = false;                    // one radial coefficient per view
  double k1_sigma = 0.05;
  RobustLoss loss = RobustLoss::kCauchy;
  double loss_scale = 1.0;
  int max_iterations = 40;
  bool covariance = false;  // fill the deviations of the result
  // Per view which camera took it; views of one camera share their lens. Empty: a camera each.
  std::vector<int> camera_of_view = {};
  // ... up to these deviations from their mean.
  double tied_focal_log_sigma = 0.002;
  double tied_principal_point_sigma_px = 1.0;
  double tied_k1_sigma = 0.002;
};

// From a projective scene to a metric one (self_calibration.h).
struct SelfCalibrationOptions {
  CalibratedBundleOptions bundle{};  // its priors; loss and covariance are chosen here
  double min_focal_widths = 0.3;     // bounds of the grid and of an answer, image widths
  double max_focal_widths = 8.0;
  int focal_steps = 12;  // of the grid, each of two views; more: finer starts, quadratic time
  int max_starts = 4;    // distinct ones that are refined
  int max_pairs = 15;    // pairs of views the grid is tried on
  // Largest posterior deviation of a log focal length that is called metric.
  double max_focal_log_sigma = 0.12;
  double max_rms_ratio = 1.3;         // metric to projective residuals, in sigmas
  double min_alternative_gap = 10.0;  // chi^2 by which a different calibration must be worse
};

// Views left over (camera_resection.h).
struct ResectionOptions {
  double gate_px = 3.0;  // of an inlier; of a segment, for both ends from the projected line
  // Focal lengths tried, image widths; a given one is tried alone.
  double min_focal_widths = 0.6;
  double max_focal_widths = 3.2;
  int focal_steps = 7;
  int max_iterations = 1500;  // of RANSAC: a fifth of right matches is found
  int min_points = 8;         // that agree
  int min_support = 12;       // points and half the lines that agree
  double focal_prior_widths = 1.5;
  double focal_prior_log_sigma = 0.5;
  double max_focal_log_sigma = 0.3;  // posterior
  unsigned seed = 1;
};

// Incremental reconstruction of points (incremental_scene.h).
struct IncrementalOptions {
  std::vector<double> focal_widths = {0.8, 1.3, 2.2};  // of the starts, image widths
  int start_pairs = 3;  // tried while none explains the images; more: slower
  // Share of what nothing would explain, up to which a scene explains the images.
  double sure_share = 0.2;
  // Of points, in pixels: of a start, and of what is left at the end.
  double start_gate_px = 8.0;
  double gate_px = 4.0;
  double outlier_chi2 = 16.0;  // what an observation costs at most
  int min_points = 10;         // of a start, and known ones of a view to be registered
  CalibratedBundleOptions bundle{.focal_prior_widths = 1.2,
                                 .focal_prior_log_sigma = 0.5,
                                 .estimate_k1 = true,
                                 .max_iterations = 25};
  // Times the deviations of one camera's views from their mean while a scene grows: whether it is
  // one camera is asked at the end.
  double loose_tie = 30.0;
  ResectionOptions resection{.min_support = 8, .max_focal_log_sigma = 1.0};
};

// Planes among reconstructed points (point_planes.h).
struct PointPlaneOptions {
  int max_planes = 3;
  int min_points = 25;  // of a plane
  int samples = 300;    // of three points each
  // Of all points, that may lie beyond a plane that things stand on: wrong ones, and what is seen
  // past its border.
  double max_share_under = 0.15;
  unsigned seed = 1;
};

// Cameras from texture points (texture_route.h).
struct TextureRouteOptions {
  IncrementalOptions growth{};
  int growth_of_view = 300;  // observations of a view in it, for time
  // Images are of one camera unless a lens for each explains them by so much better. Photographs of
  // one camera gain .01 - .14 of the cost, renders with a focal length each .15 - .7.
  double one_camera_gain = 0.2;
  // What is given: cost as a share of what nothing would explain. Right ones .04 - .12 in real
  // photographs, a wrong one of repeated marks .48.
  double max_unexplained = 0.25;
  double max_k1 = 0.15;  // three deviations of its prior; beyond it a lens takes up what is wrong
  int min_points_of_view = 20;
  double min_share_of_view = 0.5;  // of its observations that agree
  // Scenes within this ratio of the best's cost explain the images as well, and what they say of
  // the focal lengths is part of their deviation.
  double equal_cost = 1.2;
  // Deviations of focal lengths know nothing of matches that are wrong together, nor of lenses that
  // the model leaves out.
  double sigma_factor = 2.0;
  double focal_log_sigma_floor = 0.02;
  // Where images of different focal lengths see little beside a plane, texture points alone leave
  // the focal lengths to the noise: share of a pair's points that one homography explains.
  double plane_share = 0.85;
  PointPlaneOptions planes{};
  // Of the points of a plane, in units of the cameras' mean distance.
  double plane_tolerance = 0.008;
};

// Views whose deviation of log f is beyond this are not trusted. Four views of a plane know the
// focal lengths to 15 % when the principal points are not known; a search for parts works with
// that.
inline constexpr double kMaxTrustedFocalSigma = 0.16;

struct ReconstructionOptions {
  double focal_prior_widths = 1.5;  // prior focal length in image widths
  double focal_prior_log_sigma = 0.5;
  double max_rms_px = 1.5;  // accepted reprojection error of the inliers
  int min_views = 2;
  // Their priors of the focal length and seeds are the ones here.
  BundleOptions bundle;  // of the supporting plane and what stands on it
  BundleOptions start_bundle{.max_iterations = 25};  // ... of the plane alone, of each start
  GrowOptions tracks;                                // without a plane
  SelfCalibrationOptions calibration{.max_focal_log_sigma = kMaxTrustedFocalSigma};
  ResectionOptions registration;  // of views left over
  TextureRouteOptions texture;
  unsigned seed = 1;
};

}  // namespace horopter
