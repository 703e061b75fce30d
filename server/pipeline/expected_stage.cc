#include "server/pipeline/expected_stage.h"

#include <algorithm>
#include <string>
#include <vector>

#include "server/base/status_macros.h"
#include "server/pipeline/answer.h"
#include "server/pipeline/select_objects.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

FoundPart PartOf(const AnswerObject& o, const std::vector<ReferenceObject>& references) {
  FoundPart part;
  part.object_id = o.object_id;
  part.score = o.score;
  part.scene_from_object = o.scene_from_object;
  part.alternatives = o.alternatives;
  part.is_reference = std::any_of(references.begin(), references.end(), [&](const auto& r) {
    return r.object_id == o.object_id;
  });
  return part;
}

// Whether what is not in the answer may be taken for not found.
bool WasSearched(const SceneAnswer& answer) {
  return !answer.time_limited && answer.unsearched.empty() &&
         !HasReason(answer, ReasonKind::kTooFewFeatures) &&
         !HasReason(answer, ReasonKind::kEmptyCatalog);
}

}  // namespace

absl::Status TellExpected(const SceneRequest& request,
                          const CatalogSnapshot& catalog,
                          SceneAnswer* answer) {
  if (request.expected_parts.empty()) return absl::OkStatus();
  ExpectedScene scene;
  scene.searched = WasSearched(*answer);
  scene.base_from_scene = answer->base_from_scene;
  scene.joint_covariance = answer->joint_covariance;
  const std::vector<ReferenceObject> references = ReferencesOf(request);
  std::vector<std::string> ids = ExpectedIds(request);
  for (const AnswerObject& o : answer->objects) {
    scene.parts.push_back(PartOf(o, references));
    ids.push_back(o.object_id);
    if (!answer->base_from_scene || !o.base_from_object) continue;
    // About the scene's axes.
    const Matrix6d turn = SecondInProduct(answer->base_from_scene->Inverse());
    scene.covariances_in_base.push_back(turn * o.base_from_object->covariance * turn.transpose());
  }
  if (scene.covariances_in_base.size() != scene.parts.size()) scene.covariances_in_base.clear();
  for (const auto& camera : answer->cameras) {
    if (camera) scene.cameras.push_back({camera->camera, camera->camera_from_scene});
  }
  for (const std::string& id : ids) {
    if (scene.shapes.contains(id)) continue;
    HOROPTER_ASSIGN_OR_RETURN(const auto object, ObjectById(catalog, id));
    scene.shapes[id] = {object->center, object->radius_m, object->model.symmetries};
  }
  answer->expected = JudgeExpected(request.expected_parts, scene);
  return absl::OkStatus();
}

}  // namespace horopter
