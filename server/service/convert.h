// Wire <-> domain of recognition; each way checked.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/pipeline/scene.h"
#include "server/service/image_decode.h"

namespace horopter::v1 {
class Explanation;
class RecognizeSceneRequest;
class RecognizeSceneResponse;
class RigidTransform;
}  // namespace horopter::v1

namespace horopter {

inline constexpr int kMaxCandidates = 10000;

// "objects/{id}" <-> id. Errors: INVALID_ARGUMENT naming `field`.
std::string ObjectName(std::string_view id);
absl::StatusOr<std::string> ObjectIdFromName(std::string_view name, std::string_view field);

// Quaternions are normalised. Errors: INVALID_ARGUMENT naming `field` (no rotation, not finite,
// norm off by more than 1 %).
absl::StatusOr<Rigid3> RigidFromProto(const v1::RigidTransform& proto, std::string_view field);
// w >= 0.
void RigidToProto(const Rigid3& a_from_b, v1::RigidTransform* proto);

// Decodes the images too, `threads` at a time. Errors: INVALID_ARGUMENT naming the field,
// CANCELLED, RESOURCE_EXHAUSTED.
absl::StatusOr<SceneRequest> SceneRequestFromProto(const v1::RecognizeSceneRequest& proto,
                                                   const ImageLimits& limits,
                                                   int threads,
                                                   const StopRequested& stop);

void ExplanationToProto(const AnswerExplanation& explanation, v1::Explanation* proto);

// Objects are ordered by id and instance. `request` gives the image sizes.
void SceneAnswerToProto(const SceneAnswer& answer,
                        const SceneRequest& request,
                        v1::RecognizeSceneResponse* proto);

}  // namespace horopter
