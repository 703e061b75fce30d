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
// The same where their addresses are all that is read: 1 MB.
constexpr int kStoredLot = 10'000;
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

int ObjectsAfter(const std::vector<std::string>& known, const CatalogChanges& changes) {
  const auto made =
      std::count_if(changes.written.begin(), changes.written.end(), [&](const std::string& id) {
        return !std::binary_search(known.begin(), known.end(), id);
      });
  return static_cast<int>(std::ssize(known) + made - std::ssize(changes.removed));
}

}  // namespace

absl::Status CatalogStore::OnNewest(const std::function<absl::Status()>& write) {
  const std::lock_guard lock(write_mutex_);
  if (!catalog_->IsShared()) return write();
  for (int attempt = 0; attempt < kMostOvertaken; ++attempt) {
    HOROPTER_RETURN_IF_ERROR(CatchUp());
    if (seen_.generation != writer_->published->snapshot.generation) continue;
    rests_on_ = &seen_;
    const absl::Status written = write();
    rests_on_ = nullptr;
    if (!IsOvertaken(written)) return written;
  }
  return absl::UnavailableError("other servers write to the catalog all the time; try again");
}

absl::Status CatalogStore::CatchUp() {
  const int64_t before = writer_->published->snapshot.generation;
  const std::vector<std::string> known = KnownIds(*writer_->published);
  const Clock::time_point asked = Clock::now();
  const absl::StatusOr<CatalogChanges> changes = catalog_->ChangesSince(before, seen_, known);
  absl::Status caught_up = changes.status();
  bool outgrown = false;
  if (changes.ok()) {
    seen_ = changes->last;
    outgrown = load_report_.resident && ObjectsAfter(known, *changes) > options_.max_resident;
    if (seen_.generation > before && !outgrown) caught_up = TakeOver(*changes);
  }
  const bool other = IsOtherHistory(caught_up);  // what is here is of no moment of what is there
  if (other) spdlog::warn("{}; it is loaded anew", std::string(caught_up.message()));
  if (outgrown)
    spdlog::info("the catalog is held in memory no more: it is larger than max-resident");
  if (other || outgrown) {
    HOROPTER_ASSIGN_OR_RETURN(WriterState next, LoadAll(kFollowsOn));
    Adopt(std::move(next));
    ++restored_;
    caught_up = absl::OkStatus();
  }
  HOROPTER_RETURN_IF_ERROR(caught_up);
  caught_up_ns_ = asked.time_since_epoch().count();
  if (!writer_->published->pending.empty()) has_pending_.notify_all();
  return absl::OkStatus();
}

absl::Status CatalogStore::TakeOver(const CatalogChanges& changes) {
  const StopScope shield(kFollowsOn);
  const int64_t before = writer_->published->snapshot.generation;
  std::vector<std::string> to_load;
  if (load_report_.resident) to_load = changes.written;
  std::string after;  // addresses are taken up to that id
  bool more_stored = !load_report_.resident;
  size_t next = 0;
  bool last = false;
  while (!last) {
    CatalogDraft draft(*writer_, preparer_);
    if (more_stored) {
      HOROPTER_ASSIGN_OR_RETURN(more_stored, TakeStored(before, &after, &to_load, &draft));
    } else {
      const size_t lot = std::min(kFollowLot, to_load.size() - next);
      HOROPTER_RETURN_IF_ERROR(TakeLoaded(std::span(to_load).subspan(next, lot), &draft));
      next += lot;
    }
    last = !more_stored && next == to_load.size();
    if (last) {
      for (const std::string& id : changes.removed) draft.Remove(id);
    }
    HOROPTER_ASSIGN_OR_RETURN(WriterState state,
                              std::move(draft).Finish(last ? changes.last.generation : before));
    Adopt(std::move(state));
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> CatalogStore::TakeStored(int64_t since,
                                              std::string* after,
                                              std::vector<std::string>* without,
                                              CatalogDraft* draft) {
  HOROPTER_ASSIGN_OR_RETURN(
      std::vector<DerivedEntry> page,
      catalog_->ListDerived(*after, kStoredLot, preparer_.version, since, &seen_));
  for (DerivedEntry& entry : page) {
    *after = entry.id;
    if (entry.version == preparer_.version && !entry.address.empty()) {
      draft->PutStored(entry.id, std::move(entry.address), Handle(entry.id));
    } else {
      without->push_back(std::move(entry.id));
    }
  }
  return page.size() == kStoredLot;
}

absl::Status CatalogStore::TakeLoaded(std::span<const std::string> ids, CatalogDraft* draft) {
  // What was removed meanwhile is left to the next look.
  HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadedObject> objects,
                            catalog_->LoadObjects(ids, Wanted(), &seen_));
  std::vector<std::string> there;
  for (const LoadedObject& object : objects) there.push_back(object.model.id);
  std::vector<Loaded> loaded(objects.size());
  ParallelFor(static_cast<int>(objects.size()), options_.threads, [&](int i) {
    loaded[i] = LoadOne(std::move(objects[i]), !options_.prepare_beside);
  });
  for (size_t i = 0; i < there.size(); ++i) {
    const std::string& id = there[i];
    if (loaded[i].pending) {
      draft->Postpone(id);
      continue;
    }
    const absl::Status usable = loaded[i].object.status();
    if (usable.ok()) {
      HOROPTER_RETURN_IF_ERROR(draft->Put(id, *loaded[i].object, HandleFor(id)));
    } else if (absl::IsUnavailable(usable) || absl::IsCancelled(usable)) {
      return usable;
    } else {
      spdlog::error("left out of recognition: object {}: {}", id, std::string(usable.message()));
      draft->Remove(id);
      draft->LeaveOut(id, std::string(usable.message()));
    }
  }
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
