// Objects that are prepared beside what is served: those of a catalog of another version.
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"
#include "server/service/catalog_store.h"

namespace horopter {
namespace {

constexpr auto kTellEvery = std::chrono::seconds(5);

const StopRequested kStopsNever;  // what is begun is published

// Lines of progress, not one for each lot.
class Progress {
 public:
  void Tell(size_t left) {
    const auto now = std::chrono::steady_clock::now();
    if (left > 0 && now - told_ < kTellEvery) return;
    told_ = now;
    if (left > 0) {
      spdlog::info("{} objects are still to be prepared; recognition does without them", left);
    } else {
      spdlog::info("all objects are prepared");
    }
  }

 private:
  std::chrono::steady_clock::time_point told_ = std::chrono::steady_clock::now();
};

// At most so many of them. Servers that share a catalog begin at different ones: what one has
// prepared the others find done.
std::vector<std::string> SomeOf(const std::set<std::string>& all, size_t most, bool shared) {
  static std::mt19937 random(std::random_device{}());
  auto at = all.begin();
  if (shared) std::advance(at, static_cast<std::ptrdiff_t>(random() % all.size()));
  std::vector<std::string> some;
  while (some.size() < std::min(most, all.size())) {
    some.push_back(*at);
    if (++at == all.end()) at = all.begin();
  }
  return some;
}

}  // namespace

void CatalogStore::PrepareBeside() {
  // Requests come first: half of the threads.
  const auto most = static_cast<size_t>(std::max(1, options_.threads / 2));
  Progress progress;
  while (true) {
    std::vector<std::string> ids;
    int restored = 0;
    int64_t generation = 0;
    {
      std::unique_lock lock(write_mutex_);
      has_pending_.wait(lock, [this] { return closing_ || !writer_->published->pending.empty(); });
      if (closing_) return;
      restored = restored_;
      generation = writer_->published->snapshot.generation;
      ids = SomeOf(writer_->published->pending, most, catalog_->IsShared());
    }
    std::vector<Loaded> loaded = PrepareLot(ids);
    const absl::Status published = OnNewest([&]() -> absl::Status {
      if (closing_ || restored != restored_) return absl::OkStatus();  // of another catalog
      return CatchExceptions([&]() -> absl::Status {
        HOROPTER_RETURN_IF_ERROR(DropChanged(generation, &ids, &loaded));
        return PublishLot(ids, loaded);
      });
    });
    if (closing_) return;
    if (absl::IsUnavailable(published)) {  // the database is out of reach
      std::unique_lock lock(write_mutex_);
      has_pending_.wait_for(lock, kTellEvery, [this] { return closing_.load(); });
      continue;
    }
    if (!published.ok()) {
      spdlog::error("objects cannot be prepared, the next start tries again: {}",
                    std::string(published.message()));
      return;
    }
    progress.Tell(Published()->pending.size());
  }
}

absl::Status CatalogStore::DropChanged(int64_t since,
                                       std::vector<std::string>* ids,
                                       std::vector<Loaded>* loaded) {
  if (!catalog_->IsShared()) return absl::OkStatus();
  for (size_t i = 0; i < ids->size();) {
    const absl::StatusOr<ObjectSummary> now = catalog_->GetSummary((*ids)[i]);
    if (!now.ok() && !absl::IsNotFound(now.status())) return now.status();
    const auto at = static_cast<std::ptrdiff_t>(i);
    if (now.ok() && now->record.revision <= since) {
      ++i;
    } else {
      ids->erase(ids->begin() + at);
      loaded->erase(loaded->begin() + at);
    }
  }
  return absl::OkStatus();
}

std::vector<CatalogStore::Loaded> CatalogStore::PrepareLot(const std::vector<std::string>& ids) {
  std::vector<Loaded> loaded(ids.size());
  const StopRequested stop = [this] { return closing_.load(); };
  const absl::Status done = CatchExceptions([&] {
    const StopScope scope(stop);
    ParallelFor(static_cast<int>(ids.size()), static_cast<int>(ids.size()), [&](int i) {
      absl::StatusOr<LoadedObject> object = catalog_->LoadObject(ids[i], Wanted());
      if (object.ok()) {
        loaded[i] = LoadOne(*std::move(object), /*prepare=*/true);
      } else {
        loaded[i].object = object.status();
      }
    });
    return absl::OkStatus();
  });
  for (Loaded& one : loaded) {
    if (!done.ok() && absl::IsUnknown(one.object.status())) one.object = done;
  }
  return loaded;
}

absl::Status CatalogStore::PublishLot(const std::vector<std::string>& ids,
                                      const std::vector<Loaded>& loaded) {
  const StopScope shield(kStopsNever);
  HOROPTER_ASSIGN_OR_RETURN(const int64_t generation, NextGeneration());
  std::vector<std::pair<std::string, DerivedData>> made;
  CatalogDraft draft(*writer_, preparer_);
  for (size_t i = 0; i < ids.size(); ++i) {
    // Whoever has written it meanwhile has prepared it.
    if (writer_->published->pending.count(ids[i]) == 0) continue;
    if (!loaded[i].object.ok()) {
      const std::string why(loaded[i].object.status().message());
      spdlog::error("left out of recognition: object {}: {}", ids[i], why);
      draft.LeaveOut(ids[i], why);
      continue;
    }
    HOROPTER_RETURN_IF_ERROR(draft.Put(ids[i], *loaded[i].object, HandleFor(ids[i])));
    if (loaded[i].made) made.emplace_back(ids[i], Derive(**loaded[i].object));
  }
  HOROPTER_ASSIGN_OR_RETURN(WriterState next, std::move(draft).Finish(generation));
  const absl::Status stored = catalog_->StoreDerived(made, /*counts=*/true, rests_on_);
  if (IsOvertaken(stored) || absl::IsUnavailable(stored)) return stored;
  if (!stored.ok()) {
    // A full disk is no reason not to serve; the number of the state is that of the file.
    spdlog::warn("derived data cannot be stored, the next start prepares them again: {}",
                 std::string(stored.message()));
    CatalogDraft again(next, preparer_);
    HOROPTER_ASSIGN_OR_RETURN(next, std::move(again).Finish(generation - 1));
  }
  Adopt(std::move(next));
  return absl::OkStatus();
}

}  // namespace horopter
