#include "server/service/catalog_draft.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "db/object_digest.h"
#include "server/base/status_macros.h"

namespace horopter {

bool PublishedCatalog::Contains(const std::string& id) const {
  return std::binary_search(ids.begin(), ids.end(), id);
}

CatalogDraft::CatalogDraft(const WriterState& from, const ObjectPreparer& preparer)
    : preparer_(preparer),
      next_(std::make_shared<PublishedCatalog>(*from.published)),
      index_(from.index),
      free_slots_(from.free_slots) {}

void CatalogDraft::EraseKeys(int at) {
  const int slot = next_->snapshot.slots[at];
  const absl::StatusOr<Prepared> object = ObjectAt(next_->snapshot, at);
  if (object.ok() && index_.Erase(slot, preparer_.keys_of(**object)).ok()) return;
  // An object that can no longer be read, or whose keys were not those of its geometry.
  index_.EraseSlot(slot);
}

absl::Status CatalogDraft::Put(const std::string& id, const Prepared& prepared, Handle handle) {
  if (handle != nullptr) {
    PutStored(
        id, DerivedAddress(preparer_.model_of(*prepared), preparer_.version), std::move(handle));
    return absl::OkStatus();
  }
  next_->unusable.erase(id);
  next_->pending.erase(id);
  const auto at = std::lower_bound(next_->ids.begin(), next_->ids.end(), id) - next_->ids.begin();
  return PutResident(id, prepared, at);
}

void CatalogDraft::PutStored(const std::string& id, std::string address, Handle handle) {
  CatalogSnapshot& snapshot = next_->snapshot;
  next_->unusable.erase(id);
  next_->pending.erase(id);
  const auto at = std::lower_bound(next_->ids.begin(), next_->ids.end(), id) - next_->ids.begin();
  if (at != std::ssize(next_->ids) && next_->ids[at] == id) {
    snapshot.stored[at] = std::move(handle);
    next_->addresses[at] = std::move(address);
    return;
  }
  snapshot.stored.insert(snapshot.stored.begin() + at, std::move(handle));
  next_->addresses.insert(next_->addresses.begin() + at, std::move(address));
  next_->ids.insert(next_->ids.begin() + at, id);
}

absl::Status CatalogDraft::PutResident(const std::string& id,
                                       const Prepared& prepared,
                                       std::ptrdiff_t at) {
  CatalogSnapshot& snapshot = next_->snapshot;
  if (at != std::ssize(next_->ids) && next_->ids[at] == id) {
    EraseKeys(static_cast<int>(at));
    snapshot.objects[at] = prepared;
    return index_.Insert(snapshot.slots[at], preparer_.keys_of(*prepared));
  }
  int slot = static_cast<int>(next_->ids.size());  // every lower one is in use or free
  if (!free_slots_.empty()) {
    slot = free_slots_.back();
    free_slots_.pop_back();
  }
  snapshot.objects.insert(snapshot.objects.begin() + at, prepared);
  snapshot.slots.insert(snapshot.slots.begin() + at, slot);
  next_->ids.insert(next_->ids.begin() + at, id);
  return index_.Insert(slot, preparer_.keys_of(*prepared));
}

void CatalogDraft::Remove(const std::string& id) {
  CatalogSnapshot& snapshot = next_->snapshot;
  next_->unusable.erase(id);
  next_->pending.erase(id);
  const auto at = std::lower_bound(next_->ids.begin(), next_->ids.end(), id) - next_->ids.begin();
  if (at == std::ssize(next_->ids) || next_->ids[at] != id) return;
  if (snapshot.stored.empty()) {
    EraseKeys(static_cast<int>(at));
    free_slots_.push_back(snapshot.slots[at]);
    snapshot.objects.erase(snapshot.objects.begin() + at);
    snapshot.slots.erase(snapshot.slots.begin() + at);
  } else {
    snapshot.stored.erase(snapshot.stored.begin() + at);
    next_->addresses.erase(next_->addresses.begin() + at);
  }
  next_->ids.erase(next_->ids.begin() + at);
}

void CatalogDraft::LeaveOut(const std::string& id, const std::string& why) {
  next_->pending.erase(id);
  next_->unusable[id] = why;
}

void CatalogDraft::Postpone(const std::string& id) {
  Remove(id);
  next_->pending.insert(id);
}

absl::StatusOr<WriterState> CatalogDraft::Finish(int64_t generation) && {
  next_->snapshot.generation = generation;
  HOROPTER_RETURN_IF_ERROR(index_.RefreshTransforms(static_cast<uint32_t>(generation)));
  next_->snapshot.keys = index_.Snapshot();
  return WriterState{std::move(next_), std::move(index_), std::move(free_slots_)};
}

}  // namespace horopter
