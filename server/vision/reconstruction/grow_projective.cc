#include "server/vision/reconstruction/grow_projective.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/vision/reconstruction/grow_steps.h"

namespace horopter {
namespace {

// A solution that explains this share needs no alternative.
constexpr double kSureShare = 0.75;

ProjectiveResult Refuse(const MultiviewTracks& tracks, ProjectiveOutcome outcome, std::string why) {
  ProjectiveResult result;
  result.outcome = outcome;
  result.reason = std::move(why);
  result.scene = EmptyScene(tracks);
  return result;
}

int InlierCount(const ProjectiveScene& scene) {
  return static_cast<int>(std::count(scene.point_inlier.begin(), scene.point_inlier.end(), true) +
                          std::count(scene.line_inlier.begin(), scene.line_inlier.end(), true));
}

using StartMaker = std::function<std::optional<ProjectiveScene>()>;

std::optional<ProjectiveScene> StartFromDepths(const GrowContext& c,
                                               const ProjectiveScene& screened) {
  auto scene = DecomposeDepths(c.tracks, c.options.depths);
  if (!scene) return std::nullopt;
  scene->point_inlier = screened.point_inlier;
  BalanceGauge(&*scene);
  Alternate(c.tracks, c.index, c.options.alternation, &*scene);
  return scene;
}

// All starts the options allow, best first; made when they are asked for. References must outlive
// them.
std::vector<StartMaker> ListStarts(const GrowContext& c,
                                   const std::vector<ViewPair>& pairs,
                                   const ProjectiveScene& screened) {
  std::vector<StartMaker> starts;
  const ProjectiveStart kind = c.options.start;
  if (kind == ProjectiveStart::kFactorisation) {
    starts.push_back([&] { return StartFromDepths(c, screened); });
  }
  if (kind == ProjectiveStart::kBestOf || kind == ProjectiveStart::kFundamental) {
    std::vector<const ViewPair*> order;
    for (const ViewPair& pair : pairs) {
      if (HasParallax(pair)) order.push_back(&pair);
    }
    std::stable_sort(order.begin(), order.end(), [](const ViewPair* x, const ViewPair* y) {
      return x->parallax > y->parallax;
    });
    for (const ViewPair* pair : order) {
      starts.push_back([&c, &screened, pair] { return StartFromPair(c, screened, *pair); });
    }
  }
  // Pairs that no parallax was found in say that triples would not find any either.
  const bool few_points = kind == ProjectiveStart::kBestOf && pairs.empty();
  if (kind == ProjectiveStart::kTrifocal || few_points) {
    for (const auto& views : RankTriples(c, std::min(3, c.options.max_starts))) {
      starts.push_back([&c, &screened, views] { return StartFromTriple(c, screened, views); });
    }
  }
  return starts;
}

ProjectiveResult ExplainNoStart(const MultiviewTracks& tracks, const std::vector<ViewPair>& pairs) {
  if (pairs.empty()) {
    return Refuse(tracks,
                  ProjectiveOutcome::kTooFewFeatures,
                  "no two views share 8 consistent points, no three 26 equations of points and "
                  "lines");
  }
  int most = 0;
  double motion = 0.0;
  bool parallax = false;
  for (const ViewPair& pair : pairs) {
    most = std::max(most, pair.off_homography);
    motion = std::max(motion, pair.motion);
    parallax = parallax || HasParallax(pair);
  }
  if (parallax) {
    return Refuse(tracks, ProjectiveOutcome::kInconsistent, "no start gave 7 points in two views");
  }
  if (motion < 3.0) {
    return Refuse(
        tracks,
        ProjectiveOutcome::kNoParallax,
        absl::StrFormat("no parallax: points move by at most %.1f sigma, the images are the same",
                        motion));
  }
  return Refuse(
      tracks,
      ProjectiveOutcome::kNoParallax,
      absl::StrFormat("no parallax: one homography explains all but %d points in every one of %d "
                      "pairs, need %d and %.0f %% (planar scene or one centre)",
                      most,
                      static_cast<int>(pairs.size()),
                      kMinOffHomography,
                      100.0 * kMinOffHomographyShare));
}

// Outcome, numbers and pixel cameras of the best scene.
ProjectiveResult Conclude(const MultiviewTracks& tracks,
                          const GrowContext& c,
                          ProjectiveScene scene) {
  ProjectiveResult result;
  BalanceGauge(&scene);
  result.inlier_share = InlierShare(c, scene);
  LeaveIfStopped();
  const auto covariance = ProjectiveCovariance(c.tracks, scene);
  LeaveIfStopped();
  result.scene = std::move(scene);
  CamerasToPixels(tracks.sizes, &result.scene);
  result.summary = Summarize(tracks, result.scene);
  if (!covariance) {
    result.outcome = ProjectiveOutcome::kUndetermined;
    result.reason = "as many unknowns as observations";
    return result;
  }
  result.redundancy = covariance->redundancy;
  result.weakest_deviation =
      covariance->WeakestDeviation() * std::sqrt(std::max(1.0, covariance->variance_factor));
  if (!(result.weakest_deviation <= c.options.max_deviation)) {
    result.outcome = ProjectiveOutcome::kUndetermined;
    result.reason = absl::StrFormat("cameras known to %.2g of their size, need %.2g",
                                    std::min(result.weakest_deviation, 1e6),
                                    c.options.max_deviation);
    return result;
  }
  result.outcome = ProjectiveOutcome::kReconstructed;
  return result;
}

}  // namespace

absl::Status Validate(const GrowOptions& options) {
  if (options.max_starts < 1) return absl::InvalidArgumentError("max_starts: at least 1");
  if (options.min_views < 2) return absl::InvalidArgumentError("min_views: at least 2");
  if (!(options.min_inlier_share >= 0.0 && options.min_inlier_share <= 1.0)) {
    return absl::InvalidArgumentError("min_inlier_share: need 0..1");
  }
  if (!(options.outlier_chi2 > 0.0)) return absl::InvalidArgumentError("outlier_chi2: need > 0");
  if (!(options.max_deviation > 0.0)) return absl::InvalidArgumentError("max_deviation: need > 0");
  if (!(options.pairs.gate_sigma > 0.0) || options.pairs.max_iterations < 1 ||
      options.pairs.min_inliers < 8) {
    return absl::InvalidArgumentError(
        "pairs: need gate_sigma > 0, max_iterations >= 1 and min_inliers >= 8");
  }
  return absl::OkStatus();
}

absl::StatusOr<ProjectiveResult> ReconstructProjective(const MultiviewTracks& tracks,
                                                       const GrowOptions& options,
                                                       const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  HOROPTER_RETURN_IF_ERROR(Validate(tracks));
  if (static_cast<int>(tracks.sizes.size()) < options.min_views) {
    return Refuse(
        tracks,
        ProjectiveOutcome::kTooFewViews,
        absl::StrFormat(
            "%d views, need %d", static_cast<int>(tracks.sizes.size()), options.min_views));
  }
  const MultiviewTracks normalized = NormalizeTracks(tracks);
  const TrackIndex index = IndexTracks(normalized);
  const GrowContext context{normalized, index, options, stop};
  const std::vector<ViewPair> pairs = EstimateViewPairs(normalized, index, options.pairs, stop);
  ProjectiveScene screened = EmptyScene(normalized);
  ScreenObservations(pairs, &screened);

  std::optional<ProjectiveScene> best;
  int tried = 0;
  for (const StartMaker& make : ListStarts(context, pairs, screened)) {
    if (tried >= options.max_starts) break;
    std::optional<ProjectiveScene> scene = make();
    if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
    if (!scene) continue;
    ++tried;
    std::mt19937 rng(options.seed + static_cast<unsigned>(tried));
    RegisterViews(context, &rng, &*scene);
    const bool finished = Finish(context, &*scene);
    if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
    if (!finished) continue;
    const bool complete = KnownCameras(*scene) == static_cast<int>(tracks.sizes.size());
    if (!best || InlierCount(*scene) > InlierCount(*best)) best = std::move(scene);
    if (complete && InlierShare(context, *best) > kSureShare) break;
  }
  if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
  if (tried == 0) return ExplainNoStart(tracks, pairs);
  if (!best || KnownCameras(*best) < options.min_views) {
    ProjectiveResult refused = Refuse(
        tracks,
        ProjectiveOutcome::kInconsistent,
        absl::StrFormat("of %d starts none explained %.0f %% of the observations of %d views",
                        tried,
                        100.0 * options.min_inlier_share,
                        options.min_views));
    refused.starts = tried;
    return refused;
  }
  ProjectiveResult result = Conclude(tracks, context, std::move(*best));
  result.starts = tried;
  return result;
}

}  // namespace horopter
