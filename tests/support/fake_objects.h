// Stand-ins for the pipeline in tests of the service, which must not depend on what the stages
// recognise.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

// A prepared object that holds the model and nothing else. Only ModelOfFake may look inside.
// Errors: INVALID_ARGUMENT when the display name is "unpreparable".
absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareFake(ObjectModel model);

const ObjectModel& ModelOfFake(const PreparedObject& object);

// Prepares, stores and restores such objects; the data are the diameter and `version`.
ObjectPreparer FakePreparer(int version = 1);

}  // namespace horopter
