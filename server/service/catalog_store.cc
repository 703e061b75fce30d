#include "server/service/catalog_store.h"

#include <algorithm>
#include <atomic>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/crash_point.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

using Prepared = absl::StatusOr<std::shared_ptr<const PreparedObject>>;

std::vector<Prepared> PrepareAll(std::vector<ObjectModel> models,
                                 const PrepareFunction& prepare,
                                 int threads) {
  std::vector<Prepared> prepared(models.size(), absl::UnknownError("not prepared"));
  std::atomic<size_t> next{0};
  const auto work = [&] {
    for (size_t i = next++; i < models.size(); i = next++)
      prepared[i] = prepare(std::move(models[i]));
  };
  std::vector<std::thread> helpers;
  for (int i = 1; i < threads; ++i) helpers.emplace_back(work);
  work();
  for (std::thread& helper : helpers) helper.join();
  return prepared;
}

}  // namespace

bool PublishedCatalog::Contains(const std::string& id) const {
  return std::binary_search(ids.begin(), ids.end(), id);
}

CatalogStore::CatalogStore(std::unique_ptr<Catalog> catalog, PrepareFunction prepare)
    : catalog_(std::move(catalog)), prepare_(std::move(prepare)) {}

absl::StatusOr<std::unique_ptr<CatalogStore>> CatalogStore::Load(std::unique_ptr<Catalog> catalog,
                                                                 PrepareFunction prepare,
                                                                 int threads) {
  HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectModel> models, catalog->LoadAll());
  std::vector<std::string> ids;
  for (const ObjectModel& model : models) ids.push_back(model.id);
  const std::vector<Prepared> prepared = PrepareAll(std::move(models), prepare, threads);

  std::unique_ptr<CatalogStore> store(new CatalogStore(std::move(catalog), std::move(prepare)));
  auto published = std::make_shared<PublishedCatalog>();
  published->snapshot.generation = 1;
  for (size_t i = 0; i < ids.size(); ++i) {
    if (!prepared[i].ok()) {
      store->failures_.push_back(
          absl::StrCat("object ", ids[i], ": ", std::string(prepared[i].status().message())));
      continue;
    }
    published->ids.push_back(ids[i]);
    published->snapshot.objects.push_back(*prepared[i]);
  }
  store->published_ = std::move(published);
  return store;
}

std::shared_ptr<const PublishedCatalog> CatalogStore::Published() const {
  const std::lock_guard lock(published_mutex_);
  return published_;
}

absl::Status CatalogStore::Create(const CatalogRecord& record) {
  // A taken id is told before the time of a preparation is spent; the database decides in the end.
  if (catalog_->GetSummary(record.model.id).ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat("object '", record.model.id, "' is already in the catalog"));
  }
  HOROPTER_ASSIGN_OR_RETURN(std::shared_ptr<const PreparedObject> prepared, prepare_(record.model));
  const std::lock_guard lock(write_mutex_);
  HOROPTER_RETURN_IF_ERROR(catalog_->CreateObject(record));
  Publish(record.model.id, std::move(prepared));
  return absl::OkStatus();
}

absl::Status CatalogStore::Update(const std::string& id,
                                  const UpdateParts& parts,
                                  const MergeFunction& merge) {
  const std::lock_guard lock(write_mutex_);
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord current, catalog_->GetObject(id));
  HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord changed, merge(std::move(current)));
  HOROPTER_ASSIGN_OR_RETURN(std::shared_ptr<const PreparedObject> prepared,
                            prepare_(changed.model));
  HOROPTER_RETURN_IF_ERROR(catalog_->UpdateObject(changed, parts));
  Publish(id, std::move(prepared));
  return absl::OkStatus();
}

absl::Status CatalogStore::Delete(const std::string& id) {
  const std::lock_guard lock(write_mutex_);
  HOROPTER_RETURN_IF_ERROR(catalog_->DeleteObject(id));
  Publish(id, nullptr);
  return absl::OkStatus();
}

void CatalogStore::Publish(const std::string& id, std::shared_ptr<const PreparedObject> prepared) {
  CrashPoint("store.before_publish");
  auto next = std::make_shared<PublishedCatalog>(*Published());
  ++next->snapshot.generation;
  const auto at = std::lower_bound(next->ids.begin(), next->ids.end(), id);
  const auto object = next->snapshot.objects.begin() + (at - next->ids.begin());
  const bool known = at != next->ids.end() && *at == id;
  if (prepared == nullptr) {
    if (known) {
      next->snapshot.objects.erase(object);
      next->ids.erase(at);
    }
  } else if (known) {
    *object = std::move(prepared);
  } else {
    next->snapshot.objects.insert(object, std::move(prepared));
    next->ids.insert(at, id);
  }
  {
    const std::lock_guard lock(published_mutex_);
    published_ = std::move(next);
  }
  CrashPoint("store.after_publish");
}

}  // namespace horopter
