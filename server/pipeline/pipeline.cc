#include "server/pipeline/pipeline.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <iterator>
#include <map>
#include <numeric>
#include <span>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/answer.h"
#include "server/pipeline/exception_status.h"
#include "server/pipeline/explain.h"
#include "server/vision/matching/known_cameras.h"
#include "server/vision/recognition/explained_recognition.h"
#include "server/vision/recognition/object/prepared_blob.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// What the catalog keeps of an object.
constexpr PrepareOptions kCatalogPreparation{.aspects = true};

// Times one stage and keeps its counts.
class StageClock {
 public:
  StageClock(std::string stage, std::vector<StageReport>* reports)
      : reports_(reports),
        report_{std::move(stage), 0.0, {}},
        start_(std::chrono::steady_clock::now()) {}
  void Finish(std::map<std::string, double> counts) {
    report_.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    report_.counts = std::move(counts);
    reports_->push_back(std::move(report_));
  }

 private:
  std::vector<StageReport>* reports_;
  StageReport report_;
  std::chrono::steady_clock::time_point start_;
};

// Adds up the wall time of a stage's steps under "seconds_<step>".
class StepClock {
 public:
  void Begin(std::string_view step) {
    End();
    step_ = std::string(step);
    start_ = std::chrono::steady_clock::now();
  }
  void End() {
    if (step_.empty()) return;
    seconds_["seconds_" + step_] +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    step_.clear();
  }
  const std::map<std::string, double>& seconds() const { return seconds_; }

 private:
  std::string step_;
  std::chrono::steady_clock::time_point start_;
  std::map<std::string, double> seconds_;
};

// What the caller says about the cameras, for the reconstruction.
std::vector<ViewPrior> PriorsOf(const SceneRequest& request) {
  if (request.hints.empty() && request.camera_poses.empty()) return {};
  std::vector<ViewPrior> priors(request.images.size());
  for (std::size_t i = 0; i < request.hints.size(); ++i) {
    const CameraHint& hint = request.hints[i];
    priors[i].focal_px = hint.focal_px;
    priors[i].focal_log_sigma = hint.focal_log_sigma.value_or(priors[i].focal_log_sigma);
    priors[i].principal_point_px = hint.principal_point;
    priors[i].k1 = hint.k1;
  }
  for (std::size_t i = 0; i < request.camera_poses.size(); ++i) {
    if (!request.camera_poses[i]) continue;
    priors[i].camera_from_world = request.camera_poses[i]->camera_from_base;
    priors[i].rotation_sigma_rad = request.camera_poses[i]->rotation_sigma_rad;
    priors[i].position_sigma_m = request.camera_poses[i]->position_sigma_m;
  }
  return priors;
}

absl::Status ValidateRequest(const SceneRequest& request) {
  if (request.images.empty()) return absl::InvalidArgumentError("images: at least one is needed");
  if (!request.hints.empty() && request.hints.size() != request.images.size()) {
    return absl::InvalidArgumentError("hints: one per image or none");
  }
  if (!request.camera_poses.empty() && request.camera_poses.size() != request.images.size()) {
    return absl::InvalidArgumentError("camera_poses: one per image or none");
  }
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

const std::string& IdAt(const CatalogSnapshot& catalog, int index) {
  return catalog.stored.empty() ? catalog.objects[index]->model.id : catalog.stored[index]->id();
}

// Index of the object, or -1.
int FindObject(const CatalogSnapshot& catalog, const std::string& id) {
  int low = 0, high = ObjectCount(catalog);
  while (low < high) {
    const int middle = low + (high - low) / 2;
    if (IdAt(catalog, middle) < id) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return low < ObjectCount(catalog) && IdAt(catalog, low) == id ? low : -1;
}

struct Selection {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<int> slots;  // of the objects in the catalog's keys; empty when it has none
};

absl::StatusOr<Selection> SelectObjects(const SceneRequest& request,
                                        const CatalogSnapshot& catalog,
                                        int most) {
  if (request.reference && FindObject(catalog, request.reference->object_id) < 0) {
    return absl::NotFoundError(
        absl::StrCat("reference.object: ", request.reference->object_id, " is not enrolled"));
  }
  if (!request.explained.empty() && FindObject(catalog, request.explained) < 0) {
    return absl::NotFoundError(
        absl::StrCat("explained: object ", request.explained, " is not enrolled"));
  }
  std::vector<int> selected;
  if (request.candidates.empty()) {
    selected.resize(ObjectCount(catalog));
    std::iota(selected.begin(), selected.end(), 0);
  }
  std::vector<std::string> wanted = request.candidates;
  if (!wanted.empty() && request.reference) wanted.push_back(request.reference->object_id);
  if (!wanted.empty() && !request.explained.empty()) wanted.push_back(request.explained);
  std::sort(wanted.begin(), wanted.end());
  wanted.erase(std::unique(wanted.begin(), wanted.end()), wanted.end());
  for (const std::string& id : wanted) {
    selected.push_back(FindObject(catalog, id));
    if (selected.back() < 0) {
      return absl::NotFoundError(absl::StrCat("candidate_objects: ", id, " is not enrolled"));
    }
  }
  if (static_cast<int>(selected.size()) > most) {
    return absl::InvalidArgumentError(absl::StrCat("candidate_objects: ",
                                                   selected.size(),
                                                   " objects, at most ",
                                                   most,
                                                   " are searched for at once "
                                                   "(max_searched_objects)"));
  }
  const bool keyed = static_cast<int>(catalog.slots.size()) == ObjectCount(catalog);
  Selection out;
  for (const int index : selected) {
    HOROPTER_ASSIGN_OR_RETURN(out.objects.emplace_back(), ObjectAt(catalog, index));
    if (keyed) out.slots.push_back(catalog.slots[index]);
  }
  return out;
}

absl::StatusOr<std::vector<ImageFeatures>> DetectAll(const SceneRequest& request,
                                                     const PipelineOptions& options,
                                                     const StopRequested& stop) {
  const int n = static_cast<int>(request.images.size());
  std::vector<absl::StatusOr<ImageFeatures>> found(n,
                                                   absl::CancelledError("stopped during features"));
  ParallelFor(n, options.threads, [&](int i) {
    if (!IsStopRequested(stop)) found[i] = DetectFeatures(request.images[i], options.features);
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

// Notes whether a stage was told to hurry, and in which step: stages read no clock, so one that
// never heard it gave all it has. Begin() on the thread of the request; the token on any.
class HurryWatch {
 public:
  explicit HurryWatch(StopRequested hurry) : hurry_(std::move(hurry)) {}

  StopRequested Token() {
    if (!hurry_) return {};
    return [this] {
      if (!hurry_()) return false;
      int none = -1;
      heard_in_.compare_exchange_strong(none, static_cast<int>(steps_begun_.load()));
      return true;
    };
  }
  void Begin(std::string_view step) {
    steps_.emplace_back(step);
    ++steps_begun_;
  }
  bool heard() const { return heard_in_ >= 0; }
  // Empty: not heard, or before the first step.
  std::string step() const {
    return heard_in_ > 0 ? steps_[static_cast<std::size_t>(heard_in_) - 1] : std::string();
  }

 private:
  const StopRequested hurry_;
  std::vector<std::string> steps_;
  std::atomic<int> steps_begun_{0};
  std::atomic<int> heard_in_{-1};
};

// Routes that were due but not asked for want of time: in the counts as "unasked_<route>".
std::vector<std::string> UnaskedRoutes(const RecognitionResult& recognition) {
  constexpr std::string_view kUnasked = "unasked_";
  std::vector<std::string> routes;
  for (const auto& [name, count] : recognition.counts) {
    if (name.rfind(kUnasked, 0) == 0) routes.push_back(name.substr(kUnasked.size()));
  }
  return routes;
}

// What recognition says of the scene as a whole, in terms of the answer.
void TellState(const RecognitionResult& recognition, SceneAnswer* answer) {
  switch (recognition.state) {
    case RecognitionState::kRecognized:
      return;
    case RecognitionState::kNothingFound:
      return AddReason(ReasonKind::kNothingFound, recognition.detail, answer);
    case RecognitionState::kAmbiguous:
      return AddReason(ReasonKind::kAmbiguous, recognition.detail, answer);
    case RecognitionState::kTooFewFeatures:
      return AddReason(ReasonKind::kTooFewFeatures, recognition.detail, answer);
    case RecognitionState::kNoParallax:
      return AddReason(ReasonKind::kNoParallax, recognition.detail, answer);
  }
}

// The second pass of the drawing: matching called again, cameras known.
absl::StatusOr<MatchingResult> LinkUnderCameras(const SceneRequest& request,
                                                const SceneTrace& trace,
                                                const MatchingOptions& options,
                                                const StopRequested& stop) {
  std::vector<std::optional<PosedView>> views;
  for (const auto& posed : trace.metric->cameras) {
    views.emplace_back();
    if (posed) views.back() = PosedView{posed->camera, posed->camera_from_scene};
  }
  KnownCameras known{views, Eigen::Vector3d::Zero()};
  const double count = static_cast<double>(trace.metric->objects.size());
  for (const PosedObject& o : trace.metric->objects) known.middle += o.scene_from_object.t / count;
  return MatchUnderCameras(request.images, trace.features, known, trace.matching, options, stop);
}

}  // namespace

int ObjectCount(const CatalogSnapshot& catalog) {
  return static_cast<int>(std::max(catalog.objects.size(), catalog.stored.size()));
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> ObjectAt(const CatalogSnapshot& catalog,
                                                               int index) {
  if (catalog.stored.empty()) return catalog.objects[index];
  return catalog.stored[index]->Get();
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareCatalogObject(ObjectModel model) {
  return PrepareObject(std::move(model), kCatalogPreparation);
}

const ObjectModel& ModelOf(const PreparedObject& object) {
  return object.model;
}

ObjectPreparer CatalogPreparer() {
  ObjectPreparer preparer;
  preparer.version = kPreparedVersion;
  preparer.prepare = PrepareCatalogObject;
  preparer.encode = [](const PreparedObject& object) {
    return EncodePrepared(object, kCatalogPreparation);
  };
  preparer.restore = [](ObjectModel model, const PreparedBytes& bytes) {
    return RestorePrepared(std::move(model), bytes, kCatalogPreparation);
  };
  preparer.decode_keys = DecodePreparedKeys;
  preparer.model_of = ModelOf;
  preparer.keys_of = [](const PreparedObject& object) -> const ObjectKeys& { return object.keys; };
  return preparer;
}

PipelineOptions ResolveOptions(PipelineOptions options) {
  options.matching.threads = options.threads;
  options.recognition.threads = options.threads;
  options.euclidean.threads = options.threads;
  options.euclidean.focal_start_widths = options.recognition.focal_start_widths;
  return options;
}

namespace {

// Matching and reconstruction.
absl::Status Reconstruct(const SceneRequest& request,
                         const PipelineOptions& options,
                         const StopRequested& stop,
                         SceneTrace* trace,
                         std::vector<StageReport>* stages) {
  StageClock matching_clock("matching", stages);
  HOROPTER_ASSIGN_OR_RETURN(trace->matching,
                            MatchViews(request.images, trace->features, options.matching, stop));
  matching_clock.Finish(trace->matching.counts);

  StageClock reconstruction_clock("reconstruction", stages);
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : request.images) sizes.push_back({image.cols, image.rows});
  HOROPTER_ASSIGN_OR_RETURN(trace->reconstruction,
                            ReconstructViews(trace->matching,
                                             trace->features,
                                             sizes,
                                             PriorsOf(request),
                                             options.reconstruction,
                                             stop));
  reconstruction_clock.Finish(trace->reconstruction.counts);
  return absl::OkStatus();
}

// One call of recognition with the time of its steps.
using Recognize = absl::StatusOr<RecognitionResult>(const RecognitionInput&,
                                                    const RecognitionOptions&,
                                                    const StopRequested&,
                                                    const StepListener&,
                                                    RefusalLog*);
absl::StatusOr<RecognitionResult> TimedRecognition(Recognize* recognize,
                                                   const RecognitionInput& input,
                                                   const PipelineOptions& options,
                                                   const StopRequested& stop,
                                                   HurryWatch* watch,
                                                   RefusalLog* log,
                                                   std::vector<StageReport>* stages) {
  StageClock clock("recognition", stages);
  StepClock steps;
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result,
                            recognize(
                                input,
                                options.recognition,
                                stop,
                                [&](std::string_view step) {
                                  steps.Begin(step);
                                  watch->Begin(step);
                                },
                                log));
  steps.End();
  std::map<std::string, double> counts = steps.seconds();
  counts.insert(result.counts.begin(), result.counts.end());
  clock.Finish(std::move(counts));
  return result;
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

// Recognition by the aspects alone, else after matching and reconstruction, which `input` then
// holds: the metric stage uses the matches too. The step in which time ran short, and what was not
// begun for it, is told in the answer.
absl::Status RunRecognition(PipelineOptions options,
                            const SceneRequest& request,
                            const StopRequested& stop,
                            RefusalLog* log,
                            RecognitionInput* input,
                            PipelineResult* result) {
  SceneTrace& trace = result->trace;
  SceneAnswer& answer = result->answer;
  HurryWatch watch(options.recognition.hurry);
  options.recognition.hurry = watch.Token();
  const auto recognize = [&](Recognize* by) {
    return TimedRecognition(by, *input, options, stop, &watch, log, &answer.stages);
  };
  std::vector<std::string> unasked;
  bool aspects_first = AspectsComeFirst(input->objects, options.recognition);
  if (aspects_first) {
    HOROPTER_ASSIGN_OR_RETURN(trace.recognition, recognize(RecognizeByAspectsAlone));
    // Of a large catalog the images may say that it need not have been.
    aspects_first = trace.recognition.counts.count("aspects_searched") > 0;
  }
  if (trace.recognition.objects.empty() && IsStopRequested(options.recognition.hurry)) {
    unasked = {"matching", "reconstruction", "recognition"};
  } else if (trace.recognition.objects.empty()) {
    watch.Begin("matching");
    HOROPTER_RETURN_IF_ERROR(Reconstruct(request, options, stop, &trace, &answer.stages));
    if (!aspects_first || trace.reconstruction.trusted) {
      input->matching = &trace.matching;
      input->reconstruction = &trace.reconstruction;
      HOROPTER_ASSIGN_OR_RETURN(RecognitionResult found, recognize(RecognizeObjects));
      unasked = UnaskedRoutes(found);
      if (!aspects_first || !found.objects.empty()) trace.recognition = std::move(found);
    }
  }
  answer.time_limited = watch.heard();
  if (!watch.step().empty()) answer.unsearched.push_back({UnsearchedCause::kTime, watch.step()});
  for (std::string& step : unasked) {
    answer.unsearched.push_back({UnsearchedCause::kTime, std::move(step)});
  }
  if (options.recognition.routes.aspects &&
      std::ssize(input->objects) > options.recognition.aspects.max_objects) {
    answer.unsearched.push_back({UnsearchedCause::kCatalogSize, "aspects"});
  }
  TellState(trace.recognition, &answer);
  return absl::OkStatus();
}

// Adjusts what was recognised; nothing to do without. Of a station under what is known of it.
absl::Status RunEuclidean(const PipelineOptions& options,
                          const SceneRequest& request,
                          const RecognitionInput& input,
                          const StopRequested& stop,
                          PipelineResult* result) {
  SceneTrace& trace = result->trace;
  trace.metric.reset();
  if (trace.recognition.objects.empty()) return absl::OkStatus();
  StageClock clock("euclidean", &result->answer.stages);
  if (!request.station) {
    HOROPTER_ASSIGN_OR_RETURN(trace.metric,
                              RefineMetricScene(input, trace.recognition, options.euclidean, stop));
  } else {
    HOROPTER_ASSIGN_OR_RETURN(StationScene scene,
                              RefineUnderStation(input,
                                                 trace.recognition,
                                                 request.station->state,
                                                 request.station->views,
                                                 options.station,
                                                 options.euclidean,
                                                 stop));
    trace.metric = std::move(scene.metric);
    result->station = {std::move(scene.test), scene.prior_used, std::move(scene.evidence)};
  }
  clock.Finish(trace.metric->counts);
  return absl::OkStatus();
}

// Recognition with what is known of the station, and again without it where it finds nothing or the
// images contradict it. Both answer by the images alone what they say of the cameras.
absl::Status RunStation(const PipelineOptions& options,
                        const SceneRequest& request,
                        const StopRequested& stop,
                        RefusalLog* log,
                        RecognitionInput* input,
                        PipelineResult* result) {
  const SceneRequest hinted = WithStationHints(request, options.station);
  const auto lenses = [](const SceneRequest& r) {
    return std::count_if(
        r.hints.begin(), r.hints.end(), [](const CameraHint& h) { return h.focal_px.has_value(); });
  };
  const bool anything_known =
      lenses(hinted) > lenses(request) || hinted.camera_poses.size() > request.camera_poses.size();
  result->station.emplace();
  for (const bool with_prior : {true, false}) {
    if (with_prior && !anything_known) continue;
    const SceneRequest& asked = with_prior ? hinted : request;
    result->trace.recognition = {};
    result->trace.matching = {};
    result->trace.reconstruction = {};
    result->answer.reasons.clear();
    result->answer.unsearched.clear();
    input->hints = asked.hints;
    input->matching = nullptr;
    input->reconstruction = nullptr;
    HOROPTER_RETURN_IF_ERROR(RunRecognition(options, asked, stop, log, input, result));
    input->hints = request.hints;
    HOROPTER_RETURN_IF_ERROR(RunEuclidean(options, request, *input, stop, result));
    if (result->trace.metric && (result->station->prior_used || result->station->test.agrees))
      return absl::OkStatus();
  }
  // What was found under a prior that the images contradict teaches nothing.
  if (!result->trace.metric) result->station->evidence = {};
  return absl::OkStatus();
}

// The options are resolved.
absl::StatusOr<PipelineResult> RunStages(const SceneRequest& request,
                                         const CatalogSnapshot& catalog,
                                         const PipelineOptions& options,
                                         const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(ValidateRequest(request));
  HOROPTER_ASSIGN_OR_RETURN(const Selection selection,
                            SelectObjects(request, catalog, options.max_searched_objects));
  const auto& objects = selection.objects;
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
                         selection.slots};
  RefusalLog log;
  log.object = IndexOf(request.explained, objects);
  RefusalLog* const kept = log.object < 0 ? nullptr : &log;
  if (request.station) {
    HOROPTER_RETURN_IF_ERROR(RunStation(options, request, stop, kept, &input, &result));
  } else {
    HOROPTER_RETURN_IF_ERROR(RunRecognition(options, request, stop, kept, &input, &result));
    HOROPTER_RETURN_IF_ERROR(RunEuclidean(options, request, input, stop, &result));
  }
  if (!trace.metric) {
    HOROPTER_RETURN_IF_ERROR(Explain(input, log, request, options, stop, &result));
    return result;
  }
  HOROPTER_RETURN_IF_ERROR(
      FillAnswer(*trace.metric,
                 objects,
                 request.station ? WithStationBase(request, options.station) : request,
                 options.euclidean.grasps,
                 &answer));
  if (answer.objects.empty()) AddReason(ReasonKind::kNothingFound, "no object is left", &answer);
  HOROPTER_RETURN_IF_ERROR(Explain(input, log, request, options, stop, &result));
  if (!options.second_pass) return result;

  StageClock second_pass_clock("second_pass", &answer.stages);
  HOROPTER_ASSIGN_OR_RETURN(trace.linked, LinkUnderCameras(request, trace, options.matching, stop));
  second_pass_clock.Finish(trace.linked->counts);
  return result;
}

}  // namespace

absl::StatusOr<PipelineResult> RecognizeScene(const SceneRequest& request,
                                              const CatalogSnapshot& catalog,
                                              const PipelineOptions& options,
                                              const StopRequested& stop) {
  if (options.threads < 1) return absl::InvalidArgumentError("threads: at least one is needed");
  const CoreBudget budget(options.threads);
  const StopScope scope(stop);
  return CatchExceptions(
      [&] { return RunStages(request, catalog, ResolveOptions(options), stop); });
}

}  // namespace horopter
