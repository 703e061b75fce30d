#include "server/pipeline/pipeline.h"

#include <algorithm>
#include <map>
#include <optional>
#include <span>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/answer.h"
#include "server/pipeline/clocks.h"
#include "server/pipeline/exception_status.h"
#include "server/pipeline/expected_stage.h"
#include "server/pipeline/explain.h"
#include "server/pipeline/hint_check.h"
#include "server/pipeline/hinted_runs.h"
#include "server/pipeline/large_images.h"
#include "server/pipeline/recognition_stage.h"
#include "server/pipeline/select_objects.h"
#include "server/pipeline/variants.h"
#include "server/pipeline/wider_question.h"
#include "server/vision/features/arc_refit.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

absl::Status ValidateRequest(const SceneRequest& request) {
  if (request.images.empty()) return absl::InvalidArgumentError("images: at least one is needed");
  if (!request.hints.empty() && request.hints.size() != request.images.size()) {
    return absl::InvalidArgumentError("hints: one per image or none");
  }
  if (!request.camera_poses.empty() && request.camera_poses.size() != request.images.size()) {
    return absl::InvalidArgumentError("camera_poses: one per image or none");
  }
  if (!request.searched.empty() && request.searched.size() != request.images.size())
    return absl::InvalidArgumentError("searched: one per image or none");
  HOROPTER_RETURN_IF_ERROR(Validate(PriorsOf(request), request.images.size()));
  if (request.station && request.station->views.size() != request.images.size()) {
    return absl::InvalidArgumentError("station: one camera per image");
  }
  for (std::size_t i = 0; i < request.images.size(); ++i) {
    const int type = request.images[i].type();
    if (request.images[i].empty() || (type != CV_8UC1 && type != CV_8UC3)) {
      return absl::InvalidArgumentError(absl::StrCat("images[", i, "]: need 8-bit grey or BGR"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<ImageFeatures>> DetectAll(const SceneRequest& request,
                                                     const PipelineOptions& options,
                                                     const StopRequested& stop) {
  const int n = static_cast<int>(request.images.size());
  std::vector<absl::StatusOr<ImageFeatures>> found(n,
                                                   absl::CancelledError("stopped during features"));
  ParallelFor(n, options.threads, [&](int i) {
    if (IsStopRequested(stop)) return;
    found[i] = DetectFeatures(request.images[i], options.features);
    if (found[i].ok() && options.refit_arcs) RefitArcs(&*found[i]);
  });
  std::vector<ImageFeatures> features;
  for (int i = 0; i < n; ++i) {
    if (!found[i].ok()) {
      return absl::Status(
          found[i].status().code(),
          absl::StrCat("images[", i, "]: ", std::string(found[i].status().message())));
    }
    features.push_back(std::move(*found[i]));
  }
  return features;
}

std::map<std::string, double> SumCounts(const std::vector<ImageFeatures>& features) {
  std::map<std::string, double> sum;
  for (const ImageFeatures& f : features) {
    sum["segments"] += static_cast<double>(f.segments.size());
    sum["junctions"] += static_cast<double>(f.junctions.size());
    sum["arcs"] += static_cast<double>(f.arcs.size());
    for (const auto& [name, value] : f.counts) sum[name] += value;
  }
  return sum;
}

int IndexOf(const std::string& id, std::span<const std::shared_ptr<const PreparedObject>> objects) {
  const auto at = std::find_if(
      objects.begin(), objects.end(), [&](const auto& o) { return o->model.id == id; });
  return id.empty() || at == objects.end() ? -1 : static_cast<int>(at - objects.begin());
}

// What the request asks for beside the answer.
absl::Status Explain(const RecognitionInput& input,
                     const RefusalLog& log,
                     const SceneRequest& request,
                     const PipelineOptions& options,
                     const StopRequested& stop,
                     PipelineResult* result) {
  if (log.object < 0 && !request.unexplained_edges) return absl::OkStatus();
  StageClock clock("explanation", &result->answer.stages);
  HOROPTER_RETURN_IF_ERROR(ExplainAnswer(
      input, log, request, result->trace, options.recognition, stop, &result->answer));
  clock.Finish({});
  return absl::OkStatus();
}

// Where references say that the cameras are in the base frame, per image; else empty.
std::vector<std::optional<CameraBase>> BasesSeen(const SceneAnswer& answer,
                                                 const StationOptions& options) {
  std::vector<std::optional<CameraBase>> out;
  for (const auto& base_from_camera : answer.base_from_camera_by_reference) {
    out.emplace_back();
    if (base_from_camera) out.back() = BaseSeen(*base_from_camera, options);
  }
  return out;
}

// The options are resolved.
absl::StatusOr<PipelineResult> RunStages(const SceneRequest& request,
                                         const CatalogSnapshot& catalog,
                                         const PipelineOptions& options,
                                         const StopRequested& stop) {
  HOROPTER_ASSIGN_OR_RETURN(Selection selection,
                            SelectObjects(request, catalog, options.max_searched_objects));
  HOROPTER_ASSIGN_OR_RETURN(std::optional<Selection> wider,
                            WiderQuestion(request, selection, catalog, options));
  std::vector<std::shared_ptr<const PreparedObject>> asked;  // of a wider question's objects
  if (wider) {
    asked = std::move(selection.objects);
    selection = *std::move(wider);
  }
  const std::span<const std::shared_ptr<const PreparedObject>> objects = selection.objects;
  PipelineResult result;
  SceneAnswer& answer = result.answer;
  SceneTrace& trace = result.trace;
  answer.cameras.resize(request.images.size());
  if (objects.empty()) {
    AddReason(ReasonKind::kEmptyCatalog, "no object is enrolled", &answer);
    return result;
  }

  StageClock features_clock("features", &answer.stages);
  HOROPTER_ASSIGN_OR_RETURN(trace.features, DetectAll(request, options, stop));
  features_clock.Finish(SumCounts(trace.features));

  RecognitionInput input{request.images,
                         trace.features,
                         request.hints,
                         nullptr,
                         nullptr,
                         objects,
                         selection.slots.empty() ? nullptr : &catalog.keys,
                         selection.slots,
                         &options.bottom_up,
                         &options.aspects};
  input.scale_known = std::count_if(request.camera_poses.begin(),
                                    request.camera_poses.end(),
                                    [](const auto& p) { return p.has_value(); }) > 1;
  input.searched = request.searched;
  const CameraKnowledge known = KnowledgeOf(request);
  HintTest hint_test;
  RefusalLog log;
  log.object = IndexOf(request.explained, objects);
  RefusalLog* const kept = log.object < 0 ? nullptr : &log;
  HOROPTER_RETURN_IF_ERROR(RunWithHints(options, known, stop, kept, &input, &result, &hint_test));
  if (!trace.metric) {
    if (!hint_test.agrees) TellContradictedHints(request.hints, hint_test, {}, &answer);
    HOROPTER_RETURN_IF_ERROR(Explain(input, log, request, options, stop, &result));
    return result;
  }
  const SceneRequest placed =
      request.station ? WithStationBase(request, result.station->test) : request;
  HOROPTER_RETURN_IF_ERROR(
      FillAnswer(*trace.metric, objects, placed, options.euclidean.grasps, &answer));
  if (!hint_test.agrees)
    TellContradictedHints(request.hints, hint_test, trace.metric->cameras, &answer);
  if (request.station) result.station->bases_seen = BasesSeen(answer, options.station);
  if (!asked.empty()) LeaveAsked(asked, &answer);
  if (answer.objects.empty()) AddReason(ReasonKind::kNothingFound, "no object is left", &answer);
  HOROPTER_RETURN_IF_ERROR(Explain(input, log, request, options, stop, &result));
  return result;
}

// The same, and what the answer's cameras rest on.
absl::StatusOr<PipelineResult> RunTold(const SceneRequest& request,
                                       const CatalogSnapshot& catalog,
                                       const PipelineOptions& options,
                                       const StopRequested& stop) {
  HOROPTER_ASSIGN_OR_RETURN(PipelineResult result, RunStages(request, catalog, options, stop));
  const bool with_station = result.station && result.station->prior_used;
  TellCameraBases(request, result.trace, with_station, &result.answer);
  HOROPTER_RETURN_IF_ERROR(TellExpected(request, catalog, &result.answer));
  return result;
}

// The same, with large images made smaller and small ones larger. A station knows its cameras in
// their own pixels.
absl::StatusOr<PipelineResult> RunReduced(const SceneRequest& request,
                                          const CatalogSnapshot& catalog,
                                          const PipelineOptions& options,
                                          const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  HOROPTER_RETURN_IF_ERROR(ValidateRequest(request));
  std::vector<double> factors;
  for (const cv::Mat& image : request.images)
    factors.push_back(ReductionOf(image.size(), options.least_side_px, options.small_side_px));
  if (request.station ||
      std::all_of(factors.begin(), factors.end(), [](double factor) { return factor == 1.0; }))
    return RunTold(request, catalog, options, stop);
  HOROPTER_ASSIGN_OR_RETURN(PipelineResult result,
                            RunTold(ReducedRequest(request, factors), catalog, options, stop));
  TellInOriginalPixels(request, factors, &result.answer);
  return result;
}

}  // namespace

PipelineOptions ResolveOptions(PipelineOptions options) {
  options.matching.threads = options.threads;
  options.recognition.threads = options.threads;
  options.euclidean.threads = options.threads;
  options.euclidean.focal_start_widths = options.recognition.focal_start_widths;
  options.euclidean.misfits = options.recognition.acceptance.misfits;
  return options;
}

absl::StatusOr<PipelineResult> RecognizeScene(const SceneRequest& request,
                                              const CatalogSnapshot& catalog,
                                              const PipelineOptions& options,
                                              const StopRequested& stop) {
  if (options.threads < 1) return absl::InvalidArgumentError("threads: at least one is needed");
  const CoreBudget budget(options.threads);
  const StopScope scope(stop);
  return CatchExceptions([&]() -> absl::StatusOr<PipelineResult> {
    PipelineOptions chosen = options;
    if (!request.variants.empty())
      HOROPTER_RETURN_IF_ERROR(ApplyVariants(request.variants, &chosen));
    return RunReduced(request, catalog, ResolveOptions(std::move(chosen)), stop);
  });
}

}  // namespace horopter
