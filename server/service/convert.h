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
class Vector3;
}  // namespace horopter::v1

namespace horopter {

inline constexpr int kMaxCandidates = 10000;

// "objects/{id}" <-> id. Errors: INVALID_ARGUMENT naming `field`.
std::string ObjectName(std::string_view id);
absl::StatusOr<std::string> ObjectIdFromName(std::string_view name, std::string_view field);

// Quaternions are normalised. Errors: INVALID_ARGUMENT naming `field` (no rotation, not finite,
// norm off by more than 1 %).
absl::StatusOr<Rigid3> RigidFromProto(const v1::RigidTransform& proto, std::string_view field);
void VectorToProto(const Eigen::Vector3d& v, v1::Vector3* proto);
// w >= 0.
void RigidToProto(const Rigid3& a_from_b, v1::RigidTransform* proto);

// Decodes the images too, `threads` at a time. Errors: INVALID_ARGUMENT naming the field,
// CANCELLED, RESOURCE_EXHAUSTED.
absl::StatusOr<SceneRequest> SceneRequestFromProto(const v1::RecognizeSceneRequest& proto,
                                                   const ImageLimits& limits,
                                                   int threads,
                                                   const StopRequested& stop);

void ExplanationToProto(const AnswerExplanation& explanation, v1::Explanation* proto);

struct AnswerFormat {
  bool full = true;        // false: ANSWER_VIEW_BASIC
  double min_score = 0.0;  // of the objects that are told
};
// Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<AnswerFormat> AnswerFormatFromProto(const v1::RecognizeSceneRequest& proto);

// Objects are ordered by id and instance. `request` gives the image sizes.
void SceneAnswerToProto(const SceneAnswer& answer,
                        const SceneRequest& request,
                        const AnswerFormat& format,
                        v1::RecognizeSceneResponse* proto);

// What the request says of each image that is only given back. The answer has all its cameras.
void EchoImages(const v1::RecognizeSceneRequest& request, v1::RecognizeSceneResponse* proto);

}  // namespace horopter
