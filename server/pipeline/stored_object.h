// An object of a catalog too large to be fixed in memory as a whole.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "absl/status/statusor.h"

namespace horopter {

struct PreparedObject;

// Reads the object when it is asked for. Whoever holds what Get() returned shares it with later
// callers; once Keep() was called it stays for this handle's life: the catalog keeps the last state
// of an object before it changes it, so that a snapshot never shows a later one. Thread-safe.
class StoredObject {
 public:
  using Prepared = std::shared_ptr<const PreparedObject>;
  using Loader = std::function<absl::StatusOr<Prepared>(const std::string& id)>;

  StoredObject(std::string id, Loader load) : id_(std::move(id)), load_(std::move(load)) {}

  const std::string& id() const { return id_; }

  // Errors: those of the loader.
  absl::StatusOr<Prepared> Get() const {
    const std::lock_guard lock(mutex_);
    if (Prepared known = kept_ != nullptr ? kept_ : recent_.lock()) return known;
    absl::StatusOr<Prepared> loaded = load_(id_);
    if (loaded.ok()) recent_ = *loaded;
    return loaded;
  }

  // Errors: those of the loader.
  absl::Status Keep() const {
    absl::StatusOr<Prepared> prepared = Get();
    if (!prepared.ok()) return prepared.status();
    const std::lock_guard lock(mutex_);
    kept_ = *std::move(prepared);
    return absl::OkStatus();
  }

 private:
  const std::string id_;
  const Loader load_;
  mutable std::mutex mutex_;
  mutable std::weak_ptr<const PreparedObject> recent_;  // guarded by mutex_
  mutable Prepared kept_;                               // guarded by mutex_
};

}  // namespace horopter
