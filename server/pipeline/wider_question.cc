#include "server/pipeline/wider_question.h"

#include <algorithm>
#include <string>

#include "server/pipeline/select_objects.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

std::optional<SceneRequest> WiderQuestion(const SceneRequest& request,
                                          const CatalogSnapshot& catalog,
                                          const PipelineOptions& options) {
  const int all = ObjectCount(catalog);
  if (request.candidates.empty() || static_cast<int>(request.candidates.size()) >= all ||
      all > std::min(options.recognition.aspects.max_objects, options.max_searched_objects)) {
    return std::nullopt;
  }
  SceneRequest wider = request;
  wider.candidates.clear();
  return wider;
}

bool IsEnough(const RecognitionResult& recognition) {
  return !recognition.objects.empty() &&
         recognition.registered() == static_cast<int>(recognition.views.size());
}

void LeaveAsked(std::span<const std::shared_ptr<const PreparedObject>> asked, SceneAnswer* answer) {
  const auto is_other = [&](const std::string& id) {
    return std::none_of(
        asked.begin(), asked.end(), [&](const auto& object) { return object->model.id == id; });
  };
  std::erase_if(answer->objects, [&](const AnswerObject& o) { return is_other(o.object_id); });
  std::erase_if(answer->findings, [&](const AnswerFinding& f) {
    return !f.object_id.empty() && is_other(f.object_id);
  });
  const bool ambiguous = std::any_of(answer->objects.begin(),
                                     answer->objects.end(),
                                     [](const auto& o) { return !o.alternatives.empty(); });
  if (ambiguous) return;
  std::erase_if(answer->reasons,
                [](const AnswerReason& r) { return r.kind == ReasonKind::kAmbiguous; });
}

}  // namespace horopter
