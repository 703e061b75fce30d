#include "server/pipeline/explain.h"

#include <span>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// Edges of every image that belong to no answered object.
std::vector<EdgeLines> FindUnexplained(
    const SceneTrace& trace,
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    int threads) {
  std::vector<EdgeLines> out(trace.features.size());
  ParallelFor(static_cast<int>(out.size()), threads, [&](int v) {
    const ImageFeatures& features = trace.features[v];
    PinholeCamera camera = CenteredCamera(features.width, features.height, features.width);
    std::vector<ExplainedObject> placed;
    if (trace.metric && trace.metric->cameras[v]) {
      camera = trace.metric->cameras[v]->camera;
      for (const PosedObject& o : trace.metric->objects) {
        placed.push_back({objects[o.object].get(),
                          trace.metric->cameras[v]->camera_from_scene * o.scene_from_object});
      }
    }
    out[v] = UnexplainedEdges(features, camera, placed);
  });
  return out;
}

}  // namespace

absl::Status ExplainAnswer(const RecognitionInput& input,
                           const RefusalLog& log,
                           const SceneRequest& request,
                           const SceneTrace& trace,
                           const RecognitionOptions& options,
                           const StopRequested& stop,
                           SceneAnswer* answer) {
  if (request.unexplained_edges)
    answer->unexplained_edges = FindUnexplained(trace, input.objects, options.threads);
  if (log.object < 0) return absl::OkStatus();
  const MetricScene* metric = trace.metric ? &*trace.metric : nullptr;
  HOROPTER_ASSIGN_OR_RETURN(Explanation found,
                            ExplainObject(input, log, trace.recognition, metric, options, stop));
  const std::string other = found.other < 0 ? std::string() : input.objects[found.other]->model.id;
  answer->explanation = AnswerExplanation{request.explained, other, std::move(found)};
  return absl::OkStatus();
}

}  // namespace horopter
