#include "tests/support/fake_objects.h"

#include <utility>

namespace horopter {

absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareFake(ObjectModel model) {
  if (model.display_name == "unpreparable")
    return absl::InvalidArgumentError("edges: no usable edge");
  // PreparedObject is incomplete here on purpose; the pointer is never followed as one.
  auto held = std::make_shared<const ObjectModel>(std::move(model));
  return std::shared_ptr<const PreparedObject>(held,
                                               reinterpret_cast<const PreparedObject*>(held.get()));
}

const ObjectModel& ModelOfFake(const PreparedObject& object) {
  return reinterpret_cast<const ObjectModel&>(object);
}

}  // namespace horopter
