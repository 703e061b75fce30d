// What became of each true instance in hypotheses, verification and answer.
#pragma once

#include <vector>

#include "server/pipeline/pipeline.h"
#include "tests/diagnose/feature_report.h"
#include "tests/diagnose/ground_truth.h"
#include "tests/diagnose/scene_report.h"

namespace horopter {

// Largest distance of a projected mesh vertex from its true place, in pixels at 640 px image width,
// best over the symmetries. The estimate is seen through its own camera, the truth through the true
// one.
double ProjectionError(const ObjectModel& model,
                       const PinholeCamera& camera,
                       const Rigid3& camera_from_object,
                       const BopImage& image,
                       const Rigid3& true_camera_from_object);

// Fates of the instances that are targets: visible to >= 0.1 in at least two views. object_ids[k]
// is the catalog id of prepared object k.
std::vector<ObjectFate> FollowObjects(const PipelineResult& result,
                                      const std::vector<std::string>& object_ids,
                                      const BopScene& scene,
                                      const TrueModels& models,
                                      const std::vector<TrueView>& truth,
                                      const std::vector<FeatureFinding>& findings);

}  // namespace horopter
