// How a server that shares its catalog with others publishes what they write.
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"
#include "server/service/catalog_store.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

// Without a notification the database is asked this often.
constexpr auto kFollowEvery = std::chrono::milliseconds(400);
// Objects that are read and published together.
constexpr size_t kFollowLot = 64;
// Writes of others that may come before one of ours: each of them ended.
constexpr int kMostOvertaken = 200;
// Between two looks whether somebody who waits for a generation has gone.
constexpr auto kAwaitStep = std::chrono::milliseconds(20);

const StopRequested kFollowsOn;

std::vector<std::string> KnownIds(const PublishedCatalog& published) {
  std::vector<std::string> known = published.ids;
  for (const auto& [id, why] : published.unusable) known.push_back(id);
  known.insert(known.end(), published.pending.begin(), published.pending.end());
  std::sort(known.begin(), known.end());
  return known;
}

}  // namespace

absl::Status CatalogStore::OnNewest(const std::function<absl::Status()>& write) {
  const std::lock_guard lock(write_mutex_);
  if (!catalog_->IsShared()) return write();
  for (int attempt = 0; attempt < kMostOvertaken; ++attempt) {
    HOROPTER_RETURN_IF_ERROR(CatchUp());
    rests_on_ = writer_->published->snapshot.generation;
    const absl::Status written = write();
    rests_on_ = std::nullopt;
    if (!IsOvertaken(written)) return written;
  }
  return absl::UnavailableError("other servers write to the catalog all the time; try again");
}

absl::Status CatalogStore::CatchUp() {
  const PublishedCatalog& now = *writer_->published;
  const Clock::time_point asked = Clock::now();
  HOROPTER_ASSIGN_OR_RETURN(const CatalogChanges changes,
                            catalog_->ChangesSince(now.snapshot.generation, KnownIds(now)));
  if (changes.generation < now.snapshot.generation) {
    // The database was put back to an earlier day: what is here is of no day.
    spdlog::warn("the catalog went back from generation {} to {}; it is loaded anew",
                 now.snapshot.generation,
                 changes.generation);
    HOROPTER_ASSIGN_OR_RETURN(WriterState next, LoadAll(kFollowsOn));
    Adopt(std::move(next));
    ++restored_;
  } else if (changes.generation > now.snapshot.generation) {
    HOROPTER_RETURN_IF_ERROR(TakeOver(changes));
  }
  caught_up_ns_ = asked.time_since_epoch().count();
  return absl::OkStatus();
}

absl::Status CatalogStore::TakeOver(const CatalogChanges& changes) {
  const StopScope shield(kFollowsOn);
  const int64_t before = writer_->published->snapshot.generation;
  size_t next = 0;
  do {
    const size_t lot = std::min(kFollowLot, changes.written.size() - next);
    std::vector<absl::Status> read(lot);
    std::vector<Loaded> loaded(lot);
    ParallelFor(static_cast<int>(lot), options_.threads, [&](int i) {
      absl::StatusOr<LoadedObject> object =
          catalog_->LoadObject(changes.written[next + i], Wanted());
      read[i] = object.status();
      if (object.ok()) loaded[i] = LoadOne(*std::move(object), !options_.prepare_beside);
    });
    CatalogDraft draft(*writer_, preparer_);
    for (size_t i = 0; i < lot; ++i) {
      const std::string& id = changes.written[next + i];
      if (absl::IsNotFound(read[i])) continue;  // removed meanwhile, which the next look tells
      if (read[i].ok() && loaded[i].pending) {
        draft.Postpone(id);
        continue;
      }
      const absl::Status usable = read[i].ok() ? loaded[i].object.status() : read[i];
      if (usable.ok()) {
        HOROPTER_RETURN_IF_ERROR(draft.Put(id, *loaded[i].object, HandleFor(id)));
      } else if (absl::IsUnavailable(usable) || absl::IsCancelled(usable)) {
        return usable;
      } else {
        spdlog::error("left out of recognition: object {}: {}", id, std::string(usable.message()));
        draft.Remove(id);
        draft.LeaveOut(id, std::string(usable.message()));
      }
    }
    next += lot;
    const bool last = next == changes.written.size();
    if (last) {
      for (const std::string& id : changes.removed) draft.Remove(id);
    }
    HOROPTER_ASSIGN_OR_RETURN(WriterState state,
                              std::move(draft).Finish(last ? changes.generation : before));
    Adopt(std::move(state));
  } while (next < changes.written.size());
  if (!writer_->published->pending.empty()) has_pending_.notify_all();
  return absl::OkStatus();
}

void CatalogStore::Follow() {
  bool lost = false;
  while (!closing_) {
    absl::Status followed = CatchExceptions([&] { return catalog_->AwaitWrite(kFollowEvery); });
    if (closing_) return;
    std::unique_lock lock(write_mutex_);
    followed.Update(CatchExceptions([&] { return CatchUp(); }));
    if (followed.ok()) {
      if (lost) spdlog::info("the catalog's database answers again");
    } else if (!lost) {
      spdlog::error("the catalog cannot be followed; what is published stays: {}",
                    std::string(followed.message()));
    }
    lost = !followed.ok();
    if (lost) has_pending_.wait_for(lock, kFollowEvery, [this] { return closing_.load(); });
  }
}

absl::Status CatalogStore::AwaitGeneration(int64_t generation,
                                           double most_s,
                                           const StopRequested& stop) const {
  const auto until = Clock::now() + std::chrono::duration<double>(most_s);
  std::unique_lock lock(published_mutex_);
  while (published_->snapshot.generation < generation) {
    if (Clock::now() >= until || IsStopRequested(stop)) {
      return absl::UnavailableError(absl::StrCat("this server has generation ",
                                                 published_->snapshot.generation,
                                                 " of the catalog, generation ",
                                                 generation,
                                                 " is asked for"));
    }
    published_changed_.wait_for(lock, kAwaitStep);
  }
  return absl::OkStatus();
}

double CatalogStore::SecondsBehind() const {
  if (!catalog_->IsShared()) return 0.0;
  const Clock::time_point caught_up{Clock::duration(caught_up_ns_.load())};
  return std::chrono::duration<double>(Clock::now() - caught_up).count();
}

}  // namespace horopter
