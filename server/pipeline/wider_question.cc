#include "server/pipeline/wider_question.h"

#include <algorithm>
#include <string>

#include "server/base/status_macros.h"
#include "server/vision/recognition/object/look_alikes.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

absl::StatusOr<std::optional<Selection>> WiderQuestion(const SceneRequest& request,
                                                       const Selection& asked,
                                                       const CatalogSnapshot& catalog,
                                                       const PipelineOptions& options) {
  const int all = ObjectCount(catalog);
  if (request.candidates.empty() || std::ssize(asked.objects) >= all ||
      all > std::min(options.recognition.aspects.max_objects, options.max_searched_objects)) {
    return std::nullopt;
  }
  SceneRequest unrestricted = request;
  unrestricted.candidates.clear();
  HOROPTER_ASSIGN_OR_RETURN(const Selection whole,
                            SelectObjects(unrestricted, catalog, options.max_searched_objects));
  Selection wider;
  for (std::size_t i = 0; i < whole.objects.size(); ++i) {
    const auto& object = whole.objects[i];
    const auto is_ruled_out = [&](const auto& wanted) {
      return !LookAlikeAlignments(wanted, object).empty();
    };
    const bool is_asked =
        std::find(asked.objects.begin(), asked.objects.end(), object) != asked.objects.end();
    if (!is_asked && std::any_of(asked.objects.begin(), asked.objects.end(), is_ruled_out))
      continue;
    wider.objects.push_back(object);
    if (!whole.slots.empty()) wider.slots.push_back(whole.slots[i]);
  }
  return wider;
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
