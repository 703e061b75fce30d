// The catalog's maintenance calls: look-alikes, verification, backup.
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"
#include "server/service/catalog_service.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/service/unary_call.h"
#include "server/vision/invariants/look_alike.h"

namespace horopter {
namespace {

constexpr int kPageSize = 500;
// Objects that a look-alike is looked for among when the catalog is not in memory.
constexpr int kMostCompared = 500;
constexpr size_t kChunkBytes = size_t{1} << 20;

v1::LookAlike::Kind ToProto(LookAlikeKind kind) {
  switch (kind) {
    case LookAlikeKind::kCongruent:
      return v1::LookAlike::KIND_CONGRUENT;
    case LookAlikeKind::kSimilar:
      return v1::LookAlike::KIND_SIMILAR;
    case LookAlikeKind::kMirror:
      return v1::LookAlike::KIND_MIRROR;
    case LookAlikeKind::kAffine:
      return v1::LookAlike::KIND_AFFINE;
    case LookAlikeKind::kProjective:
      return v1::LookAlike::KIND_PROJECTIVE;
  }
  return v1::LookAlike::KIND_UNSPECIFIED;
}

void AddVertices(const ObjectModel& model,
                 const std::vector<int>& indices,
                 google::protobuf::RepeatedField<double>* out) {
  for (const int i : indices) {
    for (const double x : model.vertices[i]) out->Add(x);
  }
}

// Calls `visit(summary)` for every object of the catalog; stops at its first error.
template <typename Visit>
absl::Status ForEachObject(Catalog& catalog, const StopRequested& stop, Visit visit) {
  std::string after;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<ObjectSummary> page,
                              catalog.ListObjects(after, kPageSize));
    for (const ObjectSummary& summary : page) {
      if (IsStopRequested(stop)) return absl::CancelledError("stopped");
      HOROPTER_RETURN_IF_ERROR(visit(summary));
    }
    if (page.size() < kPageSize) return absl::OkStatus();
    after = page.back().record.model.id;
  }
}

// Makes the copy on a pool thread, then sends it piece by piece. Deletes itself when gRPC is done
// with it.
class BackupReactor : public grpc::ServerWriteReactor<v1::BackupCatalogResponse> {
 public:
  BackupReactor(Catalog& catalog, grpc::CallbackServerContext* context)
      : catalog_(catalog), context_(context) {
    static std::atomic<int> next{0};
    const std::string beside = catalog.path() == ":memory:"
                                   ? (std::filesystem::temp_directory_path() / "horopter").string()
                                   : catalog.path();
    path_ = absl::StrCat(beside, ".", getpid(), ".", next++, ".backup");
  }

  void Run() noexcept {
    FinishUnlessOk([this] { return Begin(); });
  }

  void FinishWith(const absl::Status& status) noexcept {
    try {
      spdlog::log(status.ok() ? spdlog::level::info : spdlog::level::warn,
                  "method=BackupCatalog peer={} code={} bytes={}",
                  context_->peer(),
                  absl::StatusCodeToString(status.code()),
                  total_);
    } catch (...) {  // no memory for words
    }
    Finish(ToRpcStatus(status, context_));
  }

 private:
  // Step by step on threads of gRPC, which no exception may reach.
  template <typename Step>
  void FinishUnlessOk(const Step& step) noexcept {
    const absl::Status status = CatchExceptions(step);
    if (!status.ok()) FinishWith(status);
  }

  absl::Status Begin() {
    HOROPTER_RETURN_IF_ERROR(catalog_.Backup(path_));
    std::error_code error;
    total_ = static_cast<int64_t>(std::filesystem::file_size(path_, error));
    file_.open(path_, std::ios::binary);
    // The name is no longer needed: an open file is read to its end, and nothing can be left over.
    std::filesystem::remove(path_, error);
    if (!file_) return absl::InternalError("the backup cannot be read");
    return SendNext();
  }

  void OnWriteDone(bool ok) override {
    FinishUnlessOk([&]() -> absl::Status {
      return ok ? SendNext() : absl::CancelledError("the client went away");
    });
  }
  void OnCancel() override {}
  void OnDone() override { delete this; }

  // OK: a chunk is on its way, or all is sent.
  absl::Status SendNext() {
    std::string* chunk = response_.mutable_chunk();
    chunk->resize(kChunkBytes);
    file_.read(chunk->data(), static_cast<std::streamsize>(kChunkBytes));
    chunk->resize(static_cast<size_t>(file_.gcount()));
    if (chunk->empty()) {
      if (!file_.eof()) return absl::InternalError("the backup cannot be read");
      FinishWith(absl::OkStatus());
      return absl::OkStatus();
    }
    response_.set_total_bytes(total_);
    StartWrite(&response_);
    return absl::OkStatus();
  }

  Catalog& catalog_;
  grpc::CallbackServerContext* context_;
  std::string path_;
  std::ifstream file_;
  int64_t total_ = 0;
  v1::BackupCatalogResponse response_;
};

}  // namespace

grpc::ServerUnaryReactor* CatalogService::ListLookAlikes(grpc::CallbackServerContext* context,
                                                         const grpc::ByteBuffer* bytes,
                                                         grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ListLookAlikesRequest, v1::ListLookAlikesResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ListLookAlikes", .needs = Role::kRobot},
       [this](const v1::ListLookAlikesRequest& request,
              const CallInfo& info,
              v1::ListLookAlikesResponse* response) -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
         HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord named, store_.catalog().GetObject(id));
         const auto published = store_.Published();
         HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> candidates,
                                   store_.LookAlikeCandidates(*published, id, kMostCompared));
         for (const int i : candidates) {
           if (IsStopRequested(info.limits.stop)) return absl::CancelledError("stopped");
           response->set_compared(response->compared() + 1);
           HOROPTER_ASSIGN_OR_RETURN(const auto object, ObjectAt(published->snapshot, i));
           const ObjectModel& other = store_.ModelOf(*object);
           const auto found = FindLookAlike(named.model, other);
           if (!found) continue;
           v1::LookAlike* look_alike = response->add_look_alikes();
           look_alike->set_name(absl::StrCat("objects/", published->ids[i]));
           look_alike->set_kind(ToProto(found->kind));
           for (const double s : found->stretch) look_alike->add_stretch(s);
           look_alike->set_matched_vertices(found->matched);
           AddVertices(named.model, found->only_in_a, look_alike->mutable_only_in_named_m());
           AddVertices(other, found->only_in_b, look_alike->mutable_only_in_other_m());
         }
         std::stable_sort(
             response->mutable_look_alikes()->begin(),
             response->mutable_look_alikes()->end(),
             [](const v1::LookAlike& a, const v1::LookAlike& b) { return a.kind() < b.kind(); });
         return absl::OkStatus();
       }});
}

grpc::ServerUnaryReactor* CatalogService::VerifyCatalog(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* bytes,
                                                        grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::VerifyCatalogRequest, v1::VerifyCatalogResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{"VerifyCatalog"},
       [this](const v1::VerifyCatalogRequest& request,
              const CallInfo& info,
              v1::VerifyCatalogResponse* response) -> absl::Status {
         const bool recompute = request.recompute();
         const auto report = [&](const std::string& id, const std::string& what) {
           auto* problem = response->add_problems();
           if (!id.empty()) problem->set_name(absl::StrCat("objects/", id));
           problem->set_what(what);
         };
         HOROPTER_ASSIGN_OR_RETURN(const std::vector<Catalog::Problem> problems,
                                   store_.catalog().Verify());
         for (const Catalog::Problem& problem : problems) report(problem.object_id, problem.what);

         // Read last: an object enrolled meanwhile is published by the time it is listed or soon
         // after, so only differences that persist in a second look count.
         std::set<std::string> stored, published;
         for (int look = 0; look < 2; ++look) {
           stored.clear();
           response->set_objects(0);
           HOROPTER_RETURN_IF_ERROR(
               ForEachObject(store_.catalog(), info.limits.stop, [&](const ObjectSummary& summary) {
                 stored.insert(summary.record.model.id);
                 response->set_objects(response->objects() + 1);
                 return absl::OkStatus();
               }));
           const auto snapshot = store_.Published();
           published = {snapshot->ids.begin(), snapshot->ids.end()};
           if (stored == published) break;
         }
         for (const std::string& id : stored) {
           if (published.count(id) == 0) report(id, "stored, but recognition does not use it");
           if (IsStopRequested(info.limits.stop)) return absl::CancelledError("stopped");
           const absl::Status derived = store_.CheckDerived(id, recompute);
           if (!derived.ok() && !absl::IsNotFound(derived)) {  // removed meanwhile
             report(id, std::string(derived.message()));
           }
         }
         if (const absl::Status index = store_.CheckIndex(); !index.ok()) {
           report("", std::string(index.message()));
         }
         for (const std::string& id : published) {
           if (stored.count(id) == 0) report(id, "recognition uses it, but it is not stored");
         }
         return absl::OkStatus();
       }});
}

grpc::ServerUnaryReactor* CatalogService::RebuildObject(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* bytes,
                                                        grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::RebuildObjectRequest, v1::RebuildObjectResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{"RebuildObject"},
       [this](const v1::RebuildObjectRequest& request,
              const CallInfo&,
              v1::RebuildObjectResponse* response) -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
         HOROPTER_ASSIGN_OR_RETURN(const bool changed, store_.Rebuild(id));
         response->set_changed(changed);
         return absl::OkStatus();
       }});
}

grpc::ServerWriteReactor<v1::BackupCatalogResponse>* CatalogService::BackupCatalog(
    grpc::CallbackServerContext* context, const v1::BackupCatalogRequest*) {
  auto* reactor = new BackupReactor(store_.catalog(), context);
  if (const auto caller = gate_.access->Authorize(*context, Role::kAdmin); !caller.ok()) {
    reactor->FinishWith(caller.status());
    return reactor;
  }
  switch (gate_.pool->TrySubmit([reactor] { reactor->Run(); }).admission) {
    case WorkerPool::Admission::kAccepted:
      break;
    case WorkerPool::Admission::kQueueFull:
    case WorkerPool::Admission::kTooLate:
      reactor->FinishWith(QueueFull(gate_.pool->RetryAfterMs()));
      break;
    case WorkerPool::Admission::kClosed:
      reactor->FinishWith(absl::UnavailableError("the server is stopping"));
      break;
  }
  return reactor;
}

}  // namespace horopter
