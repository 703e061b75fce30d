// The robot's base by reference objects: every pose of it that agrees with all that is said, and
// which of them it is.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/pipeline/scene.h"
#include "server/vision/euclidean/transform_graph.h"

namespace horopter {

// What an answer's frames and covariances are drawn from. Objects of the answer are ordered by
// score: metric index of answer object i is order[i].
struct AnswerFrames {
  TransformGraph graph;
  SceneFrames frames;
  std::vector<std::size_t> order;
  int base = -1;  // frame of the graph; -1: no base frame

  int FrameOfObject(std::size_t answer_object) const {
    return frames.objects[order[answer_object]];
  }
};

// Of a perturbation with these deviations of each rotation and each coordinate.
Matrix6d DiagonalCovariance(double rotation_sigma_rad, double position_sigma_m);

// What references say of the base.
enum class ReferenceVerdict {
  kDecided,  // frames->base is tied to the scene, answer->base_from_scene is set
  kOpen,     // they agree with the cameras that are in the base, and say no more than these
  kNone,     // no base frame; the answer says why
};

// Every instance of a reference, in every pose that its symmetries allow, is a hypothesis of the
// base. Those stay that the most of the other references confirm and that no camera in the base
// contradicts. One that stays is the base. More than one, a reference that images do not tell from
// another pose of it, or whose pose has a direction that the images leave open, leave it to the
// cameras in the base (kOpen), else the base is ambiguous. Fills the answer's reasons, findings,
// base_from_scene, base_alternatives and base_from_camera_by_reference. Errors: those of the graph.
absl::StatusOr<ReferenceVerdict> BaseFromReferences(
    const SceneRequest& request,
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    AnswerFrames* frames,
    SceneAnswer* answer);

// A conflict of references as a finding and a reason.
void AddReferenceConflict(const std::string& detail, double value, SceneAnswer* answer);

}  // namespace horopter
