// The keys of the published objects: in the index of a catalog that is in memory, in segments of a
// larger one.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/service/catalog_store.h"

namespace horopter {
namespace {

using Prepared = std::shared_ptr<const PreparedObject>;

// Objects whose keys are read at once, 5 MB: others wait for the database meanwhile.
constexpr int kKeyPage = 256;

}  // namespace

absl::Status CatalogStore::ReadKeys(const PublishedCatalog& published,
                                    std::span<const int> wanted,
                                    const KeySegments::TakeKeys& take,
                                    const StopRequested& stop,
                                    std::vector<std::string>* damaged) const {
  for (size_t begin = 0; begin < wanted.size();) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    // Objects that follow each other are read by one question.
    size_t end = begin + 1;
    while (end < wanted.size() && end - begin < kKeyPage && wanted[end] == wanted[end - 1] + 1)
      ++end;
    const std::string after = wanted[begin] > 0 ? published.ids[wanted[begin] - 1] : "";
    std::string read_to = after;
    std::vector<std::pair<int, absl::StatusOr<ObjectKeys>>> found;
    while (read_to < published.ids[wanted[end - 1]]) {
      HOROPTER_ASSIGN_OR_RETURN(
          const std::vector<StoredKeys> page,
          catalog_->LoadKeys(read_to, static_cast<int>(end - begin), preparer_.version));
      if (page.empty()) break;
      read_to = page.back().id;
      std::vector<absl::StatusOr<ObjectKeys>> decoded(page.size(), absl::NotFoundError("none"));
      ParallelFor(static_cast<int>(page.size()), options_.threads, [&](int i) {
        if (page[i].version == preparer_.version)
          decoded[i] = preparer_.decode_keys(page[i].keys, page[i].vertex_count);
      });
      for (size_t i = 0, k = begin; i < page.size(); ++i) {
        while (k < end && published.ids[wanted[k]] < page[i].id) ++k;
        if (k == end || published.ids[wanted[k]] != page[i].id) continue;
        // Written since: the next look has its new address.
        if (page[i].version == preparer_.version &&
            page[i].address != published.addresses[wanted[k]])
          continue;
        found.emplace_back(wanted[k], std::move(decoded[i]));
      }
    }
    for (const auto& [i, keys] : found) {
      if (keys.ok()) {
        take(i, *keys);
        continue;
      }
      damaged->push_back(published.ids[i]);
      const absl::StatusOr<Prepared> object = published.snapshot.stored[i]->Get();
      if (object.ok()) take(i, preparer_.keys_of(**object));
    }
    begin = end;
  }
  return absl::OkStatus();
}

absl::Status CatalogStore::MakeSegments(const PublishedCatalog& published,
                                        const StopRequested& stop) const {
  std::vector<std::string> damaged;
  const absl::Status covered = segments_.Cover(
      published.addresses,
      [&](std::span<const int> wanted, const KeySegments::TakeKeys& take) {
        return ReadKeys(published, wanted, take, stop, &damaged);
      },
      stop);
  const std::lock_guard lock(damaged_mutex_);
  damaged_.insert(damaged.begin(), damaged.end());
  return covered;
}

absl::Status CatalogStore::CoverKeys(const PublishedCatalog& published, const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(MakeSegments(published, stop));
  std::set<std::string> damaged;
  {
    const std::lock_guard lock(damaged_mutex_);
    damaged.swap(damaged_);
  }
  for (const std::string& id : damaged) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    const absl::Status rebuilt = Rebuild(id).status();
    if (!rebuilt.ok() && !absl::IsNotFound(rebuilt)) return rebuilt;
  }
  return absl::OkStatus();
}

absl::Status CatalogStore::CheckSegments(const PublishedCatalog& published,
                                         const StopRequested& stop) const {
  HOROPTER_RETURN_IF_ERROR(MakeSegments(published, stop));
  std::vector<KeySegmentView::Tally> there(published.ids.size());
  const int covered = segments_.ForEachTally(
      published.addresses, [&](int i, const KeySegmentView::Tally& tally) { there[i] = tally; });
  if (covered != std::ssize(published.ids)) {
    return absl::InternalError(absl::StrCat(
        "segments hold the keys of ", covered, " of ", published.ids.size(), " objects"));
  }
  for (int i = 0; i < ObjectCount(published.snapshot); ++i) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    HOROPTER_ASSIGN_OR_RETURN(const Prepared object, ObjectAt(published.snapshot, i));
    if (KeySegmentView::TallyOf(preparer_.keys_of(*object)) == there[i]) continue;
    return absl::InternalError(
        absl::StrCat("segments hold other keys of object '", published.ids[i], "'"));
  }
  return absl::OkStatus();
}

absl::Status CatalogStore::CheckIndex(const StopRequested& stop) const {
  const auto published = Published();
  const CatalogSnapshot& snapshot = published->snapshot;
  if (!snapshot.stored.empty()) return CheckSegments(*published, stop);
  KeyTally keys;
  for (int i = 0; i < ObjectCount(snapshot); ++i) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    HOROPTER_ASSIGN_OR_RETURN(const Prepared object, ObjectAt(snapshot, i));
    keys.Add(snapshot.slots[i], preparer_.keys_of(*object));
  }
  return snapshot.keys.CheckAgainst(keys);
}

absl::StatusOr<std::vector<int>> CatalogStore::LookAlikeCandidates(
    const PublishedCatalog& published, const std::string& id, int most, const StopRequested& stop) {
  const CatalogSnapshot& snapshot = published.snapshot;
  const int objects = ObjectCount(snapshot);
  const auto named = std::lower_bound(published.ids.begin(), published.ids.end(), id);
  if (named == published.ids.end() || *named != id) {
    return absl::NotFoundError(absl::StrCat("object '", id, "' is not published"));
  }
  const int at = static_cast<int>(named - published.ids.begin());
  std::vector<int> candidates;
  if (snapshot.stored.empty()) {
    for (int i = 0; i < objects; ++i) {
      if (i != at) candidates.push_back(i);
    }
    return candidates;
  }
  HOROPTER_RETURN_IF_ERROR(CoverKeys(published, stop));
  HOROPTER_ASSIGN_OR_RETURN(const Prepared object, snapshot.stored[at]->Get());
  const std::vector<int> shared =
      segments_.SharedKeys(published.addresses, preparer_.keys_of(*object));
  std::vector<std::pair<int, int>> ranked;  // minus keys shared, object
  for (int i = 0; i < objects; ++i) {
    if (i != at && shared[i] > 0) ranked.emplace_back(-shared[i], i);
  }
  std::sort(ranked.begin(), ranked.end());
  for (const auto& [keys, i] : ranked) {
    if (static_cast<int>(candidates.size()) < most) candidates.push_back(i);
  }
  return candidates;
}

}  // namespace horopter
