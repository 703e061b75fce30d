// Where the way of projective invariants alone stops, part by part, on the images of a data set:
// features, matching, projective reconstruction, structure, invariants of six points in the
// catalog's index, collineation, cameras, verification (thesis 3, 4.2 - 4.4). Nothing is known or
// assumed of the cameras, and no image is searched by itself.
//
//   projective_report DATASET SPLIT [--scenes 1,2] [--cache DIR] [--keys N] [--sets N] [--tuples N]
//     --cache       folder that keeps what was derived of the parts between runs
//     --keys, --sets, --tuples  six-tuples of each part, and of each component (ObjectKeyOptions,
//                   SixTupleOptions); answers are those of the default ones
//
// Of each part the vertices that a track of junctions follows in two views and more, those among
// the structure's points, and those in one component; the rank of its first hypothesis and of its
// first right one (half of the vertices matched are the points of these vertices, or of their
// mirror images about a symmetry: those are counted as wrong); and the step that it did not pass.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <iostream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <set>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "server/vision/reconstruction/matched_tracks.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {
namespace {

constexpr double kNearPx = 4.0;    // of a junction from the image of its vertex
constexpr double kRightPx = 10.0;  // worst vertex of an answer, in an image
constexpr std::size_t kSixPoints = 6;

struct Arguments {
  std::string dataset, split, cache;
  std::vector<int> scenes;
  ObjectKeyOptions keys;
  BottomUpOptions options;
};

// Steps in their order; a part has passed those before the one it is counted at.
constexpr const char* kSteps[] = {
    "tracks", "reconstruction", "structure", "component", "index", "collineation", "answer"};
constexpr std::size_t kStepCount = std::size(kSteps);

struct Totals {
  int parts = 0, answered = 0, wrong = 0;
  std::array<int, kStepCount> stopped{};
};

// The part's vertex that a track of junctions follows: near its image in two views and more, and
// nearer than any other; -1: none. By track.
std::vector<int> VerticesOfTracks(const BopScene& scene,
                                  int obj_id,
                                  const ObjectModel& model,
                                  std::span<const FeatureTrack> tracks,
                                  std::span<const ImageFeatures> features) {
  std::vector<int> out(tracks.size(), -1);
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    std::map<int, int> views;  // of each vertex
    for (const FeatureTrack::Feature& f : tracks[t].features) {
      const BopImage& image = scene.images[f.view];
      const Eigen::Vector2d at = features[f.view].junctions[f.feature].point.cast<double>();
      double nearest = kNearPx;
      int vertex = -1;
      for (const BopInstance& truth : image.instances) {
        if (truth.obj_id != obj_id) continue;
        for (std::size_t k = 0; k < model.vertices.size(); ++k) {
          const Eigen::Vector3d x = truth.camera_from_object * model.vertices[k];
          if (!(x.z() > 0.0)) continue;
          const double off = (Project(image.camera, x) - at).norm();
          if (off < nearest) nearest = off, vertex = static_cast<int>(k);
        }
      }
      if (vertex >= 0) ++views[vertex];
    }
    for (const auto& [vertex, count] : views) {
      if (count >= 2 && 2 * count > static_cast<int>(tracks[t].features.size())) out[t] = vertex;
    }
  }
  return out;
}

// What the steps before verification leave of one scene.
struct Steps {
  MatchedTracks matched;
  std::optional<SceneStructure> structure;
  StructureRouteResult found;
  std::string reason;
};

Steps TakeSteps(const SceneTrace& trace,
                const RouteCatalog& catalog,
                const BottomUpOptions& options) {
  Steps out;
  std::vector<ImageSize> sizes;
  for (const ImageFeatures& f : trace.features) sizes.push_back({f.width, f.height});
  out.matched = TracksOfMatches(trace.matching, MatchedPairs::kAll, trace.features, sizes);
  const auto scene = ReconstructProjective(out.matched.tracks, options.reconstruction);
  if (!scene.ok() || scene->outcome != ProjectiveOutcome::kReconstructed) {
    out.reason = scene.ok() ? scene->reason : std::string(scene.status().message());
    return out;
  }
  auto structure = ProjectiveStructure(
      out.matched.tracks, scene->scene, TrackEdges(out.matched.points, trace.features));
  if (!structure.ok()) {
    out.reason = std::string(structure.status().message());
    return out;
  }
  out.structure = *std::move(structure);
  auto found =
      ProjectiveHypotheses(*out.structure, catalog.index, catalog.objects, options.projective);
  if (found.ok()) out.found = *std::move(found);
  return out;
}

// Worst vertex (px) of what was answered for a part, the least over its answers; of two views and
// more.
double ErrorOfAnswer(const BopScene& scene,
                     const AspectCatalog& catalog,
                     int object,
                     const RecognitionResult& answer) {
  double least = std::numeric_limits<double>::infinity();
  for (const SceneObject& o : answer.objects) {
    if (o.object != object) continue;
    double worst = 0.0;
    for (std::size_t v = 0; v < answer.views.size(); ++v) {
      if (!answer.views[v]) continue;
      double nearest = std::numeric_limits<double>::infinity();
      for (const BopInstance& truth : scene.images[v].instances) {
        if (truth.obj_id != catalog.obj_ids[object]) continue;
        nearest = std::min(nearest,
                           WorstVertexPx(catalog.models[object],
                                         answer.views[v]->camera,
                                         answer.views[v]->camera_from_scene * o.scene_from_object,
                                         scene.images[v].camera,
                                         truth.camera_from_object));
      }
      worst = std::max(worst, nearest);
    }
    least = std::min(least, worst);
  }
  return least;
}

// What is known of a part's vertices step by step.
struct PartCounts {
  std::size_t tracked = 0, structured = 0, component = 0;
  int listed = -1, right = -1;  // ranks; -1: none
};

PartCounts CountPart(const Steps& steps, int object, const std::vector<int>& vertex_of_track) {
  PartCounts out;
  const auto distinct = [](const std::vector<int>& vertices) {
    std::set<int> seen(vertices.begin(), vertices.end());
    seen.erase(-1);
    return seen.size();
  };
  out.tracked = distinct(vertex_of_track);
  if (!steps.structure) return out;
  const auto vertex_of = [&](int point) {
    return vertex_of_track[steps.structure->point_track[point]];
  };
  std::vector<int> all;
  for (std::size_t i = 0; i < steps.structure->points.size(); ++i)
    all.push_back(vertex_of(static_cast<int>(i)));
  out.structured = distinct(all);
  for (const std::vector<int>& component : steps.found.components) {
    std::vector<int> of;
    for (const int i : component) of.push_back(vertex_of(i));
    out.component = std::max(out.component, distinct(of));
  }
  for (std::size_t rank = 0; rank < steps.found.hypotheses.size(); ++rank) {
    const StructureHypothesis& h = steps.found.hypotheses[rank];
    if (h.object != object) continue;
    if (out.listed < 0) out.listed = static_cast<int>(rank);
    const auto hits = std::count_if(h.vertices.begin(), h.vertices.end(), [&](const auto& m) {
      return vertex_of(m.point) == m.vertex;
    });
    if (out.right < 0 && 2 * hits >= std::ssize(h.vertices)) out.right = static_cast<int>(rank);
  }
  return out;
}

// Index into kSteps of the first that was not passed.
std::size_t StoppedAt(const PartCounts& counts, bool reconstructed) {
  if (counts.tracked < kSixPoints) return 0;
  if (!reconstructed) return 1;
  if (counts.structured < kSixPoints) return 2;
  if (counts.component < kSixPoints) return 3;
  if (counts.listed < 0) return 4;
  return counts.right < 0 ? 5 : 6;
}

void ReportScene(const BopScene& scene,
                 const AspectCatalog& catalog,
                 const SceneTrace& trace,
                 const Steps& steps,
                 Totals* totals) {
  std::cout << absl::StrFormat("scene %d: %d tracks, %d points in space, %d hypotheses %s\n",
                               scene.scene_id,
                               steps.matched.points.size(),
                               steps.structure ? steps.structure->points.size() : 0,
                               steps.found.hypotheses.size(),
                               steps.reason);
  std::set<int> ids;
  for (const BopImage& image : scene.images) {
    for (const BopInstance& truth : image.instances) ids.insert(truth.obj_id);
  }
  for (std::size_t object = 0; object < catalog.obj_ids.size(); ++object) {
    const int o = static_cast<int>(object);
    const double error = ErrorOfAnswer(scene, catalog, o, trace.recognition);
    const bool is_there = ids.contains(catalog.obj_ids[object]);
    const bool is_answered =
        std::any_of(trace.recognition.objects.begin(),
                    trace.recognition.objects.end(),
                    [&](const SceneObject& answer) { return answer.object == o; });
    totals->wrong += is_answered && !(error < kRightPx);
    if (!is_there) continue;
    const PartCounts counts = CountPart(steps,
                                        o,
                                        VerticesOfTracks(scene,
                                                         catalog.obj_ids[object],
                                                         catalog.models[object],
                                                         steps.matched.points,
                                                         trace.features));
    ++totals->parts;
    std::string stopped = "answered";
    if (error < kRightPx) {
      ++totals->answered;
    } else {
      const std::size_t step = StoppedAt(counts, steps.structure.has_value());
      ++totals->stopped[step];
      stopped = absl::StrCat("stopped at ", kSteps[step]);
    }
    std::cout << absl::StrFormat(
        "  part %d: %d vertices, %d tracked, %d in space, %d in a component, first "
        "hypothesis %d, first right %d: %s\n",
        catalog.obj_ids[object],
        catalog.models[object].vertices.size(),
        counts.tracked,
        counts.structured,
        counts.component,

        counts.listed,
        counts.right,
        stopped);
  }
}

absl::Status Run(const Arguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(arguments.dataset));
  AspectCatalog catalog;
  HOROPTER_RETURN_IF_ERROR(LoadAspectCatalog(dataset, arguments.cache, &catalog));
  std::vector<ObjectKeys> keys;
  for (const ObjectModel& model : catalog.models)
    keys.push_back(ComputeObjectKeys(model, arguments.keys));
  RouteCatalog route;
  std::vector<const ObjectKeys*> of_index;
  for (std::size_t i = 0; i < keys.size(); ++i) {
    of_index.push_back(&keys[i]);
    route.objects.push_back({&catalog.models[i], &keys[i], static_cast<int>(i)});
  }
  HOROPTER_ASSIGN_OR_RETURN(KeyIndex index, KeyIndex::Build(of_index, 0));
  route.index = index.Snapshot();
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> ids,
                            ScenesOf(arguments.dataset, arguments.split, arguments.scenes));
  CatalogSnapshot snapshot;
  snapshot.objects = catalog.objects;
  Totals totals;
  for (const int id : ids) {
    HOROPTER_ASSIGN_OR_RETURN(const BopScene scene,
                              ReadBopScene(arguments.dataset, arguments.split, id));
    SceneRequest request;
    request.variants = "routes=projective,cameras=parts";
    for (const BopImage& image : scene.images)
      request.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    HOROPTER_ASSIGN_OR_RETURN(const PipelineResult result,
                              RecognizeScene(request, snapshot, PipelineOptions()));
    ReportScene(
        scene, catalog, result.trace, TakeSteps(result.trace, route, arguments.options), &totals);
  }
  std::cout << absl::StrFormat(
      "%d of %d parts answered, %d wrong; stopped at", totals.answered, totals.parts, totals.wrong);
  for (std::size_t step = 0; step < kStepCount; ++step)
    std::cout << absl::StrFormat(" %s %d", kSteps[step], totals.stopped[step]);
  std::cout << "\n";
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Where the way of projective invariants stops, part by part");
  Arguments arguments;
  app.add_option("dataset", arguments.dataset)->required()->check(CLI::ExistingDirectory);
  app.add_option("split", arguments.split)->required();
  app.add_option("--scenes", arguments.scenes)->delimiter(',');
  app.add_option("--keys", arguments.keys.max_six_points);
  app.add_option("--sets", arguments.keys.six_point_sets);
  app.add_option("--tuples", arguments.options.projective.tuples.max_tuples);
  app.add_option("--hits", arguments.options.projective.route.max_hits);
  app.add_option("--cache", arguments.cache)->check(CLI::ExistingDirectory);
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = Run(arguments);
  if (!status.ok()) std::cerr << status << "\n";
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
