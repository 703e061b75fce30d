#include "server/vision/recognition/aspect_search/find_aspects.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr double kLeastHypothesis = 0.05;  // hypotheses below are dropped
constexpr double kVoteSearchShare = 0.05;  // of the size: edges looked for around a vote
// Of the size: poses nearer than this are one. Turns of a surface of revolution are listed every 10
// degrees, which leaves 0.043.
constexpr double kSameShare = 0.045;
constexpr std::size_t kVotePoints = 120;  // of an aspect, for the first refinement
constexpr int kVoteIterations = 6;        // Gauss-Newton; chosen, for time
constexpr int kCoarsePoints = 160;        // for the second refinement; chosen, for time
// Of the size. A vote's turn may be 6 degrees wrong, and its perspective that of another distance:
// of 194 parts in 56 images 145 were listed, 139 when edges were looked for .03 (at most 14 px)
// around one rendering (ADR 61).
constexpr double kCoarseSearchShare = 0.045, kFineSearchShare = 0.015;
constexpr double kCoarseSearchPx[] = {6.0, 20.0}, kFineSearchPx[] = {4.0, 8.0};  // least, most
constexpr int kCoarseRenderings = 2, kFineRenderings = 2;
// Of a brief search; measured on eight scenes of cad-dev (ADR 60).
constexpr int kBriefMatches = 20, kBriefPairMatches = 500, kBriefEllipseMatches = 200;
constexpr int kBriefVotes = 30, kBriefCoarse = 3, kBriefFine = 2;
constexpr std::size_t kHurriedVotes = 12;  // refined once time is up: some 50 ms; chosen
constexpr double kStalePx = 2.0;  // working pixels; poses that shifted by less keep their rendering

// A pose on its way through the steps. Camera and score are of the original image.
struct Candidate {
  int model = -1;
  PinholeCamera camera;
  Rigid3 pose;
  double rank = 0.0;
  AspectScore score;
};

// Best first, each differing from all before it; at most `count`.
std::vector<Candidate> Distinct(std::vector<Candidate> list, const AspectModel& model, int count) {
  std::stable_sort(list.begin(), list.end(), [](const Candidate& a, const Candidate& b) {
    return a.rank > b.rank;
  });
  std::vector<Candidate> out;
  for (const Candidate& c : list) {
    if (static_cast<int>(out.size()) >= count) break;
    const double same = kSameShare * SizePx(model, c.camera, c.pose);
    const bool known = std::any_of(out.begin(), out.end(), [&](const Candidate& other) {
      return PoseDistancePx(model, c.camera, c.pose, other.camera, other.pose) < same;
    });
    if (!known) out.push_back(c);
  }
  return out;
}

constexpr int kPrinted = 2;              // poses of a part that are kept beside the best; chosen
constexpr double kPresumedRecall = 0.6;  // of these; chosen

// ... and those that would be better than they are, were the part printed on: of a printed face
// every rectangle fits some pattern, and has a better recall than the face itself.
std::vector<Candidate> DistinctOrPrinted(const std::vector<Candidate>& list,
                                         const AspectModel& model,
                                         int count) {
  std::vector<Candidate> out = Distinct(list, model, count);
  std::vector<Candidate> presumed;
  for (const Candidate& c : list) {
    const AspectScore& s = c.score;
    const double score = PresumedScore(s.precision, s.recall, s.support_px, kPresumedRecall);
    if (score <= s.score) continue;
    presumed.push_back(c);
    presumed.back().rank = score;
  }
  for (Candidate& c : Distinct(std::move(presumed), model, kPrinted)) {
    const double same = kSameShare * SizePx(model, c.camera, c.pose);
    c.rank = c.score.score;
    if (std::none_of(out.begin(), out.end(), [&](const Candidate& other) {
          return PoseDistancePx(model, c.camera, c.pose, other.camera, other.pose) < same;
        }))
      out.push_back(c);
  }
  return out;
}

class Finder {
 public:
  Finder(const AspectImage& image,
         const FragmentIndex& index,
         const FindAspectOptions& options,
         const PinholeCamera* known,
         const StopRequested& stop)
      : image_(image),
        index_(index),
        options_(options),
        free_focal_(known == nullptr),
        stop_(stop) {
    camera_ = known != nullptr ? *known : NominalCamera(image, options.nominal_focal_share);
    working_ = WorkingCamera(image, camera_);
  }

  // All votes of a part, refined on the points of their aspects; ranked by supported length.
  std::vector<Candidate> FromVotes(int model, const std::vector<AspectVote>& votes) const {
    std::vector<Candidate> out;
    int aspect = -1;
    std::vector<ModelEdgePoint> points;
    for (const AspectVote& vote : votes) {
      if (IsStopRequested(stop_)) break;
      if (vote.aspect != aspect) {
        aspect = vote.aspect;
        points = PointsOf(aspect);
      }
      PoseEdgeOptions refine;
      refine.iterations = kVoteIterations;
      refine.search_px = std::clamp(kVoteSearchShare * vote.size_px, 4.0, 24.0);
      const Rigid3 pose = PoseOfVote(vote, index_, working_);
      const RefinedAspect refined =
          RefinePose(image_,
                     points,
                     index_.models[model].object->mesh.center.cast<double>(),
                     camera_,
                     pose,
                     refine);
      Candidate c{model, refined.camera, refined.camera_from_object, 0.0, {}};
      c.rank = index_.aspects[vote.aspect].edge_length * vote.size_px *
               (PointSupport(image_, points, c.camera, c.pose, options_.votes.free_chance) -
                options_.votes.rank_support);
      out.push_back(c);
    }
    return Distinct(std::move(out), index_.models[model], options_.coarse_per_object);
  }

  // Renders, refines and scores.
  void Improve(double render_px, int renderings, double search_px, Candidate* c) const {
    const RenderMesh& mesh = index_.models[c->model].object->mesh;
    PoseEdgeOptions refine;
    refine.render_px = render_px;
    refine.renderings = renderings;
    refine.search_px = search_px;
    refine.max_points = kCoarsePoints * (render_px > options_.coarse_render_px ? 2 : 1);
    refine.refine_focal = free_focal_;
    refine.nominal_focal_share = options_.nominal_focal_share;
    refine.log_focal_sigma = options_.log_focal_sigma;
    VisibleEdgeOptions visible;
    visible.render_px = render_px;
    PoseRendering rendering(mesh, visible, kStalePx);
    const RefinedAspect refined = RefinePose(image_, mesh, c->camera, c->pose, refine, &rendering);
    c->camera = refined.camera;
    c->pose = refined.camera_from_object;
    c->score = ScoreEdges(
        image_, mesh, rendering.At(WorkingCamera(image_, c->camera), c->pose), c->camera, c->pose);
    c->rank = c->score.score;
  }

 private:
  std::vector<ModelEdgePoint> PointsOf(int aspect) const {
    const IndexedAspect& a = index_.aspects[aspect];
    std::vector<ModelEdgePoint> points;
    for (const AspectPoint& p :
         AspectPoints(index_.models[a.model].object->aspects, a.aspect, kVotePoints))
      points.push_back({p.point, p.direction, 1.0f});
    return points;
  }

  const AspectImage& image_;
  const FragmentIndex& index_;
  const FindAspectOptions& options_;
  bool free_focal_;
  const StopRequested& stop_;
  PinholeCamera camera_, working_;
};

}  // namespace

PinholeCamera NominalCamera(const AspectImage& image, double nominal_focal_share) {
  return CenteredCamera(
      image.image_width, image.image_height, nominal_focal_share * image.image_width);
}

double SizePx(const AspectModel& model, const PinholeCamera& camera, const Rigid3& pose) {
  const double depth = (pose * model.object->mesh.center.cast<double>()).z();
  return camera.focal_px * model.object->mesh.diameter_m / std::max(depth, 1e-6);
}

double PoseDistancePx(const AspectModel& model,
                      const PinholeCamera& camera_a,
                      const Rigid3& a,
                      const PinholeCamera& camera_b,
                      const Rigid3& b) {
  // A cube about the centre stands for the part.
  const double half = 0.35 * model.object->mesh.diameter_m;
  const Eigen::Vector3d center = model.object->mesh.center.cast<double>();
  const auto distance = [&](const Rigid3* symmetry) {
    double worst = 0.0;
    for (int corner = 0; corner < 8; corner += 1) {
      const Eigen::Vector3d x =
          center +
          half * Eigen::Vector3d(corner & 1 ? 1 : -1, corner & 2 ? 1 : -1, corner & 4 ? 1 : -1);
      const Eigen::Vector3d in_a = a * x;
      const Eigen::Vector3d in_b = b * (symmetry != nullptr ? *symmetry * x : x);
      if (in_a.z() <= 0 || in_b.z() <= 0) return std::numeric_limits<double>::infinity();
      worst = std::max(worst, (Project(camera_a, in_a) - Project(camera_b, in_b)).norm());
    }
    return worst;
  };
  double best = distance(nullptr);
  for (const Rigid3& symmetry : model.symmetries) best = std::min(best, distance(&symmetry));
  return best;
}

FindAspectOptions Brief(FindAspectOptions options) {
  options.votes.max_matches = std::min(options.votes.max_matches, kBriefMatches);
  options.votes.max_pair_matches = std::min(options.votes.max_pair_matches, kBriefPairMatches);
  options.votes.max_ellipse_matches =
      std::min(options.votes.max_ellipse_matches, kBriefEllipseMatches);
  options.votes.max_per_object = std::min(options.votes.max_per_object, kBriefVotes);
  options.coarse_per_object = std::min(options.coarse_per_object, kBriefCoarse);
  options.fine_per_object = std::min(options.fine_per_object, kBriefFine);
  return options;
}

namespace {

// Leaves the best of all parts, at most so many.
void KeepBest(std::size_t most, std::vector<std::vector<AspectVote>>* of_model) {
  std::vector<float> ranks;
  for (const auto& votes : *of_model) {
    for (const AspectVote& vote : votes) ranks.push_back(vote.rank);
  }
  if (ranks.size() <= most) return;
  std::nth_element(ranks.begin(),
                   ranks.begin() + static_cast<std::ptrdiff_t>(most),
                   ranks.end(),
                   std::greater<>());
  for (auto& votes : *of_model)
    std::erase_if(votes, [&](const AspectVote& vote) { return vote.rank <= ranks[most]; });
}

// Best first, of all parts.
std::vector<AspectHypothesis> HypothesesOf(const std::vector<std::vector<Candidate>>& of_model) {
  std::vector<AspectHypothesis> out;
  for (const auto& list : of_model) {
    for (const Candidate& c : list) {
      const AspectScore& s = c.score;
      if (s.score < kLeastHypothesis) continue;
      out.push_back({c.model, c.camera, c.pose, s.precision, s.recall, s.support_px, s.score});
    }
  }
  std::stable_sort(
      out.begin(), out.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  return out;
}

// Diameter (working px) of the largest part that may lie in what is searched.
double LargestSearched(const AspectImage& image) {
  constexpr double kForeshortened = 1.5;  // of the largest diagonal; chosen
  if (!image.searched) return std::numeric_limits<double>::infinity();
  double largest = 0.0;
  for (const ImageBox& box : *image.searched) largest = std::max(largest, box.sizes().norm());
  return std::max(1.0, kForeshortened * largest * image.working_from_image);
}

// Those in what is searched.
AspectVotes VotesOf(const AspectImage& image,
                    const FragmentIndex& index,
                    const FindAspectOptions& options,
                    const StopRequested& stop) {
  AspectVoteOptions voting = options.votes;
  voting.threads = options.threads;
  voting.max_size_share = std::min(voting.max_size_share, LargestSearched(image) / image.width);
  AspectVotes out = VoteForAspects(image, index, voting, stop);
  for (auto& votes : out.of_model) {
    std::erase_if(votes, [&](const AspectVote& v) { return !IsSearched(image, v.x, v.y); });
  }
  return out;
}

}  // namespace

AspectFindings FindAspectHypotheses(const AspectImage& image,
                                    const FragmentIndex& index,
                                    const FindAspectOptions& options,
                                    const PinholeCamera* known,
                                    const StopRequested& stop) {
  AspectFindings out;
  out.votes = VotesOf(image, index, options, stop);
  if (image.width == 0) return out;
  const bool hurried = IsStopRequested(stop);
  if (hurried) KeepBest(kHurriedVotes, &out.votes.of_model);
  const StopRequested rest = hurried ? StopRequested() : stop;
  const Finder finder(image, index, options, known, rest);
  // Working pixels.
  const auto search_of = [&](const Candidate& c, double share, const double(&bounds)[2]) {
    const double size = SizePx(index.models[c.model], c.camera, c.pose) * image.working_from_image;
    return std::clamp(share * size, bounds[0], bounds[1]);
  };
  const int models = static_cast<int>(index.models.size());
  std::vector<std::vector<Candidate>> of_model(models);
  ParallelFor(models, options.threads, [&](int p) {
    of_model[p] = finder.FromVotes(p, out.votes.of_model[p]);
    for (Candidate& c : of_model[p]) {
      if (IsStopRequested(rest)) return;
      finder.Improve(options.coarse_render_px,
                     kCoarseRenderings,
                     search_of(c, kCoarseSearchShare, kCoarseSearchPx),
                     &c);
    }
    of_model[p] = DistinctOrPrinted(of_model[p], index.models[p], options.fine_per_object);
  });
  double best = 0.0;
  for (int p = 0; p < models; ++p) {
    out.refined += static_cast<int>(out.votes.of_model[p].size());
    for (const Candidate& c : of_model[p]) best = std::max(best, c.rank);
  }
  ParallelFor(models, options.threads, [&](int p) {
    std::erase_if(of_model[p],
                  [&](const Candidate& c) { return c.rank < options.fine_share * best; });
    for (Candidate& c : of_model[p]) {
      if (IsStopRequested(rest)) return;
      finder.Improve(options.fine_render_px,
                     kFineRenderings,
                     search_of(c, kFineSearchShare, kFineSearchPx),
                     &c);
    }
    of_model[p] = DistinctOrPrinted(of_model[p], index.models[p], options.fine_per_object);
  });
  for (const auto& list : of_model) out.fine += static_cast<int>(list.size());
  out.hypotheses = HypothesesOf(of_model);
  return out;
}

}  // namespace horopter
