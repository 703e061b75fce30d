#include "tests/support/fake_objects.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace horopter {

namespace {

struct FakeObject {
  ObjectModel model;
  ObjectKeys keys;
};

}  // namespace

absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareFake(ObjectModel model) {
  if (model.display_name == "unpreparable")
    return absl::InvalidArgumentError("edges: no usable edge");
  // PreparedObject is incomplete here on purpose; the pointer is never followed as one.
  auto held = std::make_shared<FakeObject>();
  held->keys = ComputeObjectKeys(model);
  held->model = std::move(model);
  return std::shared_ptr<const PreparedObject>(held,
                                               reinterpret_cast<const PreparedObject*>(held.get()));
}

const ObjectModel& ModelOfFake(const PreparedObject& object) {
  return reinterpret_cast<const FakeObject&>(object).model;
}

ObjectPreparer FakePreparer(int version) {
  ObjectPreparer preparer;
  preparer.version = version;
  preparer.prepare = PrepareFake;
  preparer.encode = [version](const PreparedObject& object) -> PreparedBytes {
    return {absl::StrCat(version, " ", ModelOfFake(object).diameter_m),
            EncodeObjectKeys(reinterpret_cast<const FakeObject&>(object).keys)};
  };
  preparer.restore = [version](
                         ObjectModel model,
                         const PreparedBytes& bytes) -> absl::StatusOr<ObjectPreparer::Prepared> {
    if (bytes.data != absl::StrCat(version, " ", model.diameter_m)) {
      return absl::DataLossError("derived data of something else");
    }
    return PrepareFake(std::move(model));
  };
  preparer.decode_keys = DecodeObjectKeys;
  preparer.model_of = ModelOfFake;
  preparer.keys_of = [](const PreparedObject& object) -> const ObjectKeys& {
    return reinterpret_cast<const FakeObject&>(object).keys;
  };
  return preparer;
}

}  // namespace horopter
