#include "server/vision/recognition/recognition.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/matching/ground_motion.h"
#include "server/vision/recognition/aspects/attention.h"
#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/interpretation/log_odds.h"
#include "server/vision/recognition/interpretation/pose_alternatives.h"
#include "server/vision/recognition/interpretation/scale_alternatives.h"
#include "server/vision/recognition/interpretation/shape_rivals.h"
#include "server/vision/recognition/interpretation/surface_print.h"

namespace horopter {
namespace {

AspectRecognitionOptions AspectOptionsOf(const RecognitionInput& input) {
  return input.aspects != nullptr ? *input.aspects : AspectRecognitionOptions();
}

// Without the edges of patterns and textures, and of a textured ground whose motion is known: what
// was asked for it, else what matching found.
std::vector<AspectImage> SearchedImages(const RecognitionInput& input,
                                        const JointContext& context) {
  BeginStep(context, "aspect_images");
  PlaneInViews ground(input.ground.begin(), input.ground.end());
  if (ground.empty() && input.matching != nullptr) ground = LargestPlane(*input.matching);
  return MakeAspectImagesOnGround(
      input.images, ground, AspectOptionsOf(input).images, context.options.threads, input.searched);
}

// Images and what is searched for, unless they are there.
absl::Status PrepareWork(const RecognitionInput& input,
                         const JointContext& context,
                         AspectWork* work) {
  if (!work->images.empty()) return absl::OkStatus();
  if (context.options.effort > 0.0) work->effort.Limit(context.options.effort);
  work->images = SearchedImages(input, context);
  HOROPTER_ASSIGN_OR_RETURN(work->search,
                            ChooseObjects(context, work->images, AspectOptionsOf(input).ranking));
  return absl::OkStatus();
}

// Nothing can be said of images without edges. Errors: INVALID_ARGUMENT.
absl::Status CheckInput(const RecognitionInput& input, const RecognitionOptions& options) {
  if (!input.hints.empty() && input.hints.size() != input.features.size())
    return absl::InvalidArgumentError("hints: one per image or none");
  if (!input.searched.empty() && input.searched.size() != input.images.size())
    return absl::InvalidArgumentError("searched: one per image or none");
  return Validate(options);
}

std::optional<RecognitionResult> TooFewFeatures(const RecognitionInput& input,
                                                const SceneAcceptance& acceptance,
                                                RefusalLog* log) {
  std::size_t most_segments = 0;
  for (const ImageFeatures& f : input.features)
    most_segments = std::max(most_segments, f.segments.size());
  if (static_cast<int>(most_segments) >= acceptance.min_segments) return std::nullopt;
  RecognitionResult result;
  result.views.resize(input.features.size());
  result.state = RecognitionState::kTooFewFeatures;
  result.detail = absl::StrCat(
      "at most ", most_segments, " segments in an image, need ", acceptance.min_segments);
  if (log != nullptr) {
    log->refusals.push_back({AcceptanceTest::kFeatures,
                             {},
                             result.views,
                             static_cast<double>(most_segments),
                             static_cast<double>(acceptance.min_segments)});
  }
  return result;
}

// Turns that the images leave open: the likeliest is taken, the others are said.
void WeighTurns(const JointContext& context,
                std::span<const AspectImage> images,
                RecognitionResult* result) {
  BeginStep(context, "pose_alternatives");
  TurnByPrint(context, images, result);
  const std::vector<RatedPoses> rated = TurnToLikeliest(context, images, result);
  SayPoseAlternatives(context, images, rated, result);
  WeighShapes(context, images, result);
}

// Box of a mesh's image, px; empty: it is not all in front of the camera.
ImageBox BoxOf(const TriangleMesh& mesh, const CalibratedCamera& view, const Rigid3& pose) {
  ImageBox box;
  const Rigid3 camera_from_object = view.camera_from_scene * pose;
  for (const Eigen::Vector3d& vertex : mesh.vertices) {
    const Eigen::Vector3d x = camera_from_object * vertex;
    if (!(x.z() > 0.0)) return {};
    box.extend(Project(view.camera, x));
  }
  return box.intersection(WholeImage(view.camera.width, view.camera.height));
}

// What lies mostly outside of where it was looked for is not what was asked for: parts of the
// images bear out what begins in them and goes on beside them.
void DropUnsearched(const RecognitionInput& input, RecognitionResult* result) {
  constexpr double kInside = 0.5;  // mean share of the outlines' boxes, of all views; chosen
  const auto is_outside = [&](const SceneObject& o) {
    double inside = 0.0;
    int views = 0;
    for (std::size_t v = 0; v < result->views.size(); ++v) {
      if (!result->views[v] || !input.searched[v]) continue;
      const ImageBox box =
          BoxOf(input.objects[o.object]->model.mesh, *result->views[v], o.scene_from_object);
      if (box.isEmpty()) continue;
      inside += ShareInBoxes(box, input.searched[v]->boxes);
      ++views;
    }
    return views > 0 && inside < kInside * views;
  };
  const auto dropped = std::erase_if(result->objects, is_outside);
  if (dropped == 0) return;
  result->counts["outside_regions"] += static_cast<double>(dropped);
  if (result->objects.empty()) {
    result->state = RecognitionState::kNothingFound;
    result->detail = "what was found lies outside of the regions";
  }
}

constexpr double kMetricCost = 0.4,
                 kProjectiveCost = 10.0;  // of an image's search; see AspectStarts

// What the invariants of the reconstructed structure propose, where they are asked. What is given
// outlives it. Errors: those of the catalog's index.
absl::Status AddStructureScenes(const RecognitionInput& input,
                                const JointContext& context,
                                RouteCatalog* catalog,
                                AspectStarts* starts) {
  const RecognitionRoutes& routes = context.options.routes;
  if (!routes.metric && !routes.projective) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(*catalog, MakeRouteCatalog(input.objects, input.keys, input.slots));
  const BottomUpOptions options = input.bottom_up != nullptr ? *input.bottom_up : BottomUpOptions();
  if (routes.metric && input.reconstruction != nullptr) {
    starts->lists.push_back(
        {kMetricCost, [&input, &context, catalog, options] {
           return MetricScenes(context, input.features, *input.reconstruction, *catalog, options);
         }});
  }
  if (routes.projective && input.matching != nullptr) {
    starts->lists.push_back({kProjectiveCost, [&input, &context, catalog, options] {
                               return ProjectiveScenes(
                                   context, input.features, *input.matching, *catalog, options);
                             }});
  }
  return absl::OkStatus();
}

}  // namespace

std::vector<std::vector<ImageBox>> SmallThings(std::span<const cv::Mat> images,
                                               const AspectWork& work,
                                               double most_side,
                                               int most_of_an_image) {
  AttentionOptions options;
  options.most_side = most_side;
  options.most_windows = most_of_an_image;
  const AspectImage none;
  std::vector<std::vector<ImageBox>> out;
  for (std::size_t i = 0; i < images.size(); ++i) {
    out.emplace_back();
    const AspectImage& searched = i < work.images.size() ? work.images[i] : none;
    for (const AttentionWindow& w : FindWindows(images[i], searched, options))
      out.back().push_back(w.box);
  }
  return out;
}

std::shared_ptr<AspectWork> MakeAspectWork(const AspectWork* before) {
  auto work = std::make_shared<AspectWork>();
  if (before != nullptr) work->effort = before->effort;
  return work;
}

absl::StatusOr<RecognitionResult> RecognizeWithCameras(const RecognitionInput& input,
                                                       const KnownCameras& cameras,
                                                       const RecognitionOptions& options,
                                                       const StopRequested& stop,
                                                       const StepListener& on_step,
                                                       RefusalLog* log,
                                                       AspectWork* work) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (cameras.views.size() != input.images.size() || input.images.size() != input.features.size())
    return absl::InvalidArgumentError("cameras: one entry per image");
  RecognitionResult nothing;
  nothing.views.resize(input.images.size());
  if (!options.routes.aspects || !HaveAspects(input.objects) || cameras.known() < 2) return nothing;
  if (TooFewFeatures(input, options.acceptance.scene, nullptr)) return nothing;
  const JointContext context =
      MakeContext({input.features, input.hints, input.objects}, options, stop, on_step);
  AspectWork own;
  if (work == nullptr) work = &own;
  HOROPTER_RETURN_IF_ERROR(PrepareWork(input, context, work));
  HOROPTER_ASSIGN_OR_RETURN(
      RecognitionResult found,
      RecognizeByAspectsWithCameras(context, work, cameras, log, AspectOptionsOf(input)));
  if (!input.searched.empty()) DropUnsearched(input, &found);
  if (found.objects.empty()) return nothing;
  WeighTurns(context, work->images, &found);
  if (!cameras.scale_known) SayScaleAlternatives(context, &found);
  return found;
}

absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop,
                                                   const StepListener& on_step,
                                                   RefusalLog* log,
                                                   AspectWork* work) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (input.images.size() != input.features.size())
    return absl::InvalidArgumentError("images: one per list of features");
  if (!HaveAspects(input.objects))
    return absl::InvalidArgumentError("objects: not all have aspects");
  if (auto result = TooFewFeatures(input, options.acceptance.scene, log)) return *std::move(result);
  const JointContext context =
      MakeContext({input.features, input.hints, input.objects}, options, stop, on_step);
  AspectWork own;
  if (work == nullptr) work = &own;
  HOROPTER_RETURN_IF_ERROR(PrepareWork(input, context, work));
  KnownCameras matched;
  if (options.routes.matched_cameras && input.reconstruction != nullptr)
    matched = CamerasOfReconstruction(*input.reconstruction);
  AspectStarts starts;
  if (matched.known() > 1) starts.matched = &matched;
  starts.single_images = options.routes.aspects;
  RouteCatalog catalog;
  HOROPTER_RETURN_IF_ERROR(AddStructureScenes(input, context, &catalog, &starts));
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result,
                            RecognizeByAspects(context, work, starts, log, AspectOptionsOf(input)));
  if (!input.searched.empty()) DropUnsearched(input, &result);
  WeighTurns(context, work->images, &result);
  if (!input.scale_known) SayScaleAlternatives(context, &result);
  return result;
}

bool GroundComesFirst(std::span<const ImageFeatures> features, const AspectRouteOptions& options) {
  constexpr std::size_t kLeastViews = 3;  // that say what moves with the ground
  if (features.size() < kLeastViews) return false;
  std::vector<double> shares;
  for (const ImageFeatures& f : features) {
    std::size_t points = 0;
    for (const EdgeChain& chain : f.chains) points += chain.points.size();
    shares.push_back(static_cast<double>(points) / std::max(1.0, 1.0 * f.width * f.height));
  }
  return Median(&shares) >= options.textured_share;
}

double ExpectedRight(const RecognitionResult& result) {
  double sum = 0.0;
  for (const SceneObject& o : result.objects) sum += StatedProbability(o.score, o.pose_probability);
  return sum;
}

void StateProbabilities(RecognitionResult* result) {
  for (SceneObject& o : result->objects) {
    const double there = StatedProbability(o.score, 1.0);
    o.score = StatedProbability(o.score, o.pose_probability);
    for (SceneAlternative& a : o.left_open) a.probability *= there;
    std::stable_sort(o.left_open.begin(), o.left_open.end(), [](const auto& a, const auto& b) {
      return a.probability > b.probability;
    });
  }
}

}  // namespace horopter
