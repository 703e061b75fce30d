// Calls the stages in order. One page; see docs in README.md for the drawing.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/pipeline/scene.h"
#include "server/pipeline/stored_object.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "server/vision/recognition/invariant_matching/key_index.h"
#include "server/vision/recognition/object/aspect_options.h"
#include "server/vision/recognition/object/prepared_bytes.h"

namespace horopter {

// Immutable view of the catalog that a request works on: everything recognition derives from the
// models is computed once, when an object is enrolled or changed. Readers hold a shared_ptr and are
// never blocked.
struct CatalogSnapshot {
  long generation = 0;
  // Ordered by id. One of the two lists is empty: objects are in memory, or, when there are too
  // many for that, read when they are asked for.
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<std::shared_ptr<const StoredObject>> stored;
  // Invariant keys of the objects; object i has slot slots[i] in it.
  KeyIndexSnapshot keys;
  std::vector<int> slots;
};

// Number of objects, and one of them. Errors: those of StoredObject::Get.
int ObjectCount(const CatalogSnapshot& catalog);
absl::StatusOr<std::shared_ptr<const PreparedObject>> ObjectAt(const CatalogSnapshot& catalog,
                                                               int index);

// Prepares one object, its aspects included (about three seconds). Errors: INVALID_ARGUMENT when
// the model has no mesh or no extent.
absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareCatalogObject(ObjectModel model);

// The model inside a prepared object.
const ObjectModel& ModelOf(const PreparedObject& object);

// How the catalog makes prepared objects, keeps what was costly about them, and gets them back.
// `restore` gives exactly what `prepare` would; its errors: FAILED_PRECONDITION (the data are of
// another version or geometry), DATA_LOSS (damaged), those of `prepare`. `decode_keys` gives the
// keys alone, with the same errors but for another geometry, which it cannot notice.
struct ObjectPreparer {
  using Prepared = std::shared_ptr<const PreparedObject>;
  int version = 0;  // of the data that `encode` makes
  std::function<absl::StatusOr<Prepared>(ObjectModel)> prepare;
  std::function<PreparedBytes(const PreparedObject&)> encode;
  std::function<absl::StatusOr<Prepared>(ObjectModel, const PreparedBytes&)> restore;
  std::function<absl::StatusOr<ObjectKeys>(std::string_view keys, int vertex_count)> decode_keys;
  std::function<const ObjectModel&(const PreparedObject&)> model_of;
  std::function<const ObjectKeys&(const PreparedObject&)> keys_of;
};
ObjectPreparer CatalogPreparer();

struct PipelineOptions {
  FeatureOptions features;
  MatchingOptions matching;
  ReconstructionOptions reconstruction;
  RecognitionOptions recognition;
  EuclideanOptions euclidean;
  BottomUpOptions bottom_up;         // recognition's routes through the reconstructed structure
  AspectRecognitionOptions aspects;  // ... and by the aspects of the parts
  // Fits arcs once more by orthogonal distance (features/arc_refit.h, thesis 2.4).
  bool refit_arcs = false;
  StationOptions station;  // of requests that name one
  // The ground under parts that gave the cameras takes part in the joint adjustment (ADR 62).
  bool follow_ground = true;
  // Cameras are sought in the images' texture before parts are (ADR 75).
  bool cameras_from_texture = true;
  // Images are made smaller by a whole number while so much of their larger side stays, pixels (of
  // 12 megapixels a ninth is left); higher: finer edges, slower; 0: never. A request that names a
  // station is asked as it is. Commit of ADR 45.
  int least_side_px = 1280;
  // Images whose larger side is shorter are made twice as large, pixels; 0: none. Segments, texture
  // and scores are measured in pixels: parts-dev 16 in half its size had one part of four, enlarged
  // again all. Commit of ADR 49.
  int small_side_px = 448;
  // Cores one request uses; the stages get this value (ResolveOptions). More: a faster answer.
  int threads = 2;
  // Objects that are searched for at once; a request over a larger catalog has to name candidates.
  // Raising it costs 0.2 MB and a search each.
  int max_searched_objects = 5000;
};

// The whole tree. Errors: INVALID_ARGUMENT, names the field by its branches.
absl::Status Validate(const PipelineOptions& options);

struct PipelineResult {
  SceneAnswer answer;
  SceneTrace trace;
  std::optional<StationOutcome> station;  // of a request that names one
};

// The options as the stages see them: what several stages share has one place in the tree, and is
// copied from there to the others. `threads` goes to matching, recognition and euclidean,
// recognition's focal_start_widths and misfits to euclidean.
PipelineOptions ResolveOptions(PipelineOptions options);

// Recognises the catalog's objects in a set of images of one static scene, with the options that
// ResolveOptions gives.
// Errors: INVALID_ARGUMENT (no image, wrong type or size, hint count, variants that are none, more
// objects than are searched for at once, options), NOT_FOUND (candidate or reference id unknown),
// CANCELLED (stop was requested), RESOURCE_EXHAUSTED (out of memory), INTERNAL (a library threw).
// Everything the images cannot decide is an AnswerReason, not an error.
absl::StatusOr<PipelineResult> RecognizeScene(const SceneRequest& request,
                                              const CatalogSnapshot& catalog,
                                              const PipelineOptions& options,
                                              const StopRequested& stop = {});

}  // namespace horopter
