#include "server/pipeline/wider_question.h"

#include <algorithm>
#include <string>
#include <vector>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
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
  // How parts lie over each other is remembered, and takes milliseconds when it is new.
  const auto& objects = whole.objects;
  std::vector<char> left_out(objects.size(), 0);
  ParallelFor(static_cast<int>(objects.size()), options.threads, [&](int i) {
    LeaveIfStopped();
    if (std::find(asked.objects.begin(), asked.objects.end(), objects[i]) != asked.objects.end())
      return;
    left_out[i] = std::any_of(asked.objects.begin(), asked.objects.end(), [&](const auto& wanted) {
      return !LookAlikeAlignments(wanted, objects[i]).empty();
    });
  });
  Selection wider;
  for (std::size_t i = 0; i < objects.size(); ++i) {
    if (left_out[i]) continue;
    wider.objects.push_back(objects[i]);
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
