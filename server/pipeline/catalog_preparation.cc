#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/object/prepared_blob.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

namespace {

// What the catalog keeps of an object.
constexpr PrepareOptions kCatalogPreparation{.aspects = true};

}  // namespace

absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareCatalogObject(ObjectModel model) {
  return PrepareObject(std::move(model), kCatalogPreparation);
}

const ObjectModel& ModelOf(const PreparedObject& object) {
  return object.model;
}

ObjectPreparer CatalogPreparer() {
  ObjectPreparer preparer;
  preparer.version = kPreparedVersion;
  preparer.prepare = PrepareCatalogObject;
  preparer.encode = [](const PreparedObject& object) {
    return EncodePrepared(object, kCatalogPreparation);
  };
  preparer.restore = [](ObjectModel model, const PreparedBytes& bytes) {
    return RestorePrepared(std::move(model), bytes, kCatalogPreparation);
  };
  preparer.decode_keys = DecodePreparedKeys;
  preparer.model_of = ModelOf;
  preparer.keys_of = [](const PreparedObject& object) -> const ObjectKeys& { return object.keys; };
  return preparer;
}

}  // namespace horopter
