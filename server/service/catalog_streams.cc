// The catalog's calls that stream: verification, backup, restoring.
#include <google/protobuf/message.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/service/backup_shelf.h"
#include "server/service/catalog_service.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/service/stream_call.h"

namespace horopter {
namespace {

constexpr size_t kChunkBytes = size_t{1} << 20;
// Of the work of a verification: reading the file; the rest is the derived data.
constexpr double kFileShare = 0.5;
constexpr auto kBetweenMessages = std::chrono::milliseconds(100);

class VerifyReactor final : public StreamReactor<v1::VerifyCatalogResponse> {
 public:
  VerifyReactor(CatalogStore& store,
                bool recompute,
                const CallGate& gate,
                grpc::CallbackServerContext* context)
      : StreamReactor({.name = "VerifyCatalog"}, gate, context),
        store_(store),
        recompute_(recompute) {}

 private:
  bool PostsByItself() const override { return true; }

  absl::Status Begin() override {
    Tell(0, 0.0);
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<Catalog::Problem> problems,
                              store_.catalog().Verify(stop(), [this](int done, int total) {
                                TellSometimes(0, kFileShare * done / std::max(total, 1));
                              }));
    for (const Catalog::Problem& problem : problems) Report(problem.object_id, problem.what);
    HOROPTER_RETURN_IF_ERROR(CheckWhatIsUsed());
    Tell(checked_, 1.0);
    Complete(absl::OkStatus());
    return absl::OkStatus();
  }

  // The derived data, and that recognition uses what the file holds.
  absl::Status CheckWhatIsUsed() {
    HOROPTER_ASSIGN_OR_RETURN(const CatalogStore::Contents contents, store_.Compare(stop()));
    for (const std::string& id : contents.stored) {
      if (IsStopRequested(stop())) return absl::CancelledError("stopped");
      ++checked_;
      TellSometimes(checked_,
                    kFileShare + (1.0 - kFileShare) * checked_ /
                                     static_cast<double>(contents.stored.size() + 1));
      if (const auto failure = contents.unusable.find(id); failure != contents.unusable.end()) {
        Report(id, absl::StrCat("recognition does not use it: ", failure->second));
        continue;
      }
      if (contents.pending.count(id) > 0) continue;
      if (contents.published.count(id) == 0) Report(id, "stored, but recognition does not use it");
      const absl::Status derived = store_.CheckDerived(id, recompute_, stop());
      if (absl::IsCancelled(derived)) return derived;
      if (!derived.ok() && !absl::IsNotFound(derived)) {  // removed meanwhile
        Report(id, std::string(derived.message()));
      }
    }
    const absl::Status index = store_.CheckIndex(stop());
    if (absl::IsCancelled(index)) return index;
    if (!index.ok()) Report("", std::string(index.message()));
    for (const std::string& id : contents.published) {
      if (contents.stored.count(id) == 0) Report(id, "recognition uses it, but it is not stored");
    }
    return absl::OkStatus();
  }

  void Report(const std::string& id, const std::string& what) {
    v1::VerifyCatalogResponse message;
    auto* problem = message.add_problems();
    if (!id.empty()) problem->set_name(ObjectName(id));
    problem->set_what(what);
    Post(message);
  }
  void Tell(int objects, double progress) {
    v1::VerifyCatalogResponse message;
    message.set_objects(objects);
    message.set_progress(progress);
    Post(message);
    told_ = std::chrono::steady_clock::now();
  }
  void TellSometimes(int objects, double progress) {
    if (std::chrono::steady_clock::now() - told_ > kBetweenMessages) Tell(objects, progress);
  }

  CatalogStore& store_;
  const bool recompute_;
  int checked_ = 0;
  std::chrono::steady_clock::time_point told_;
};

class BackupReactor final : public StreamReactor<v1::BackupCatalogResponse> {
 public:
  BackupReactor(Catalog& catalog,
                BackupShelf& shelf,
                const v1::BackupCatalogRequest& request,
                const CallGate& gate,
                grpc::CallbackServerContext* context)
      : StreamReactor({.name = "BackupCatalog"}, gate, context),
        catalog_(catalog),
        shelf_(shelf),
        wanted_(request.backup_id()),
        offset_(request.offset()) {}

 private:
  bool PostsByItself() const override { return false; }

  absl::Status Begin() override {
    if (wanted_.empty() && offset_ != 0) return InvalidField("offset", "only with backup_id");
    HOROPTER_ASSIGN_OR_RETURN(
        copy_, wanted_.empty() ? shelf_.Make(catalog_, stop()) : shelf_.Find(wanted_));
    shelf_.Keep(copy_);
    record().resource = copy_->id();
    if (offset_ < 0 || offset_ > copy_->bytes()) {
      return InvalidField("offset", "outside of the copy");
    }
    return OnSent();
  }

  absl::Status OnSent() override {
    v1::BackupCatalogResponse message;
    HOROPTER_ASSIGN_OR_RETURN(*message.mutable_chunk(), copy_->Read(offset_, kChunkBytes));
    offset_ += static_cast<int64_t>(message.chunk().size());
    if (message.chunk().empty()) {
      shelf_.Forget(copy_->id());
      Complete(absl::OkStatus());
      return absl::OkStatus();
    }
    message.set_total_bytes(copy_->bytes());
    message.set_backup_id(copy_->id());
    message.set_sha256(copy_->sha256());
    Post(message);
    return absl::OkStatus();
  }

  Catalog& catalog_;
  BackupShelf& shelf_;
  const std::string wanted_;
  int64_t offset_;
  std::shared_ptr<const BackupCopy> copy_;
};

// Takes the copy in on gRPC's threads, then restores on one of the pool. Deletes itself.
class RestoreReactor final : public grpc::ServerReadReactor<v1::RestoreCatalogRequest> {
 public:
  RestoreReactor(CatalogStore& store,
                 const CallGate& gate,
                 grpc::CallbackServerContext* context,
                 v1::RestoreCatalogResponse* response)
      : store_(store),
        gate_(gate),
        call_({.name = "RestoreCatalog"}, gate, context),
        response_(response) {}

  void Start() {
    const absl::Status begun = CatchExceptions([this]() -> absl::Status {
      HOROPTER_RETURN_IF_ERROR(call_.Authorize());
      // A folder of its own: what opening the copy leaves beside it goes with it.
      folder_ = BesideCatalog(store_.catalog(), "restore");
      std::error_code error;
      std::filesystem::create_directory(folder_, error);
      if (error) return absl::PermissionDeniedError(absl::StrCat(folder_, ": ", error.message()));
      file_.open(folder_ + "/catalog.db", std::ios::binary);
      return absl::OkStatus();
    });
    if (begun.ok()) {
      StartRead(&message_);
    } else {
      End(begun);
    }
  }

 private:
  void OnReadDone(bool ok) override {
    const absl::Status status = CatchExceptions([&]() -> absl::Status {
      if (ok) return Append();
      HOROPTER_RETURN_IF_ERROR(CheckWhole());
      return SubmitStream(gate_, call_, [this] {
        call_.Begin();
        End(CatchExceptions([this] { return Restore(); }));
      });
    });
    if (!status.ok()) {
      End(status);
    } else if (ok) {
      StartRead(&message_);
    }
  }

  absl::Status Append() {
    if (received_ == 0) {
      total_ = message_.total_bytes();
      sha256_ = message_.sha256();
    }
    received_ += static_cast<int64_t>(message_.chunk().size());
    if (received_ > total_) return InvalidField("total_bytes", "more bytes came than it says");
    sha_.Add(message_.chunk());
    file_.write(message_.chunk().data(), static_cast<std::streamsize>(message_.chunk().size()));
    return file_ ? absl::OkStatus()
                 : absl::ResourceExhaustedError("the copy cannot be written: disk full?");
  }

  absl::Status CheckWhole() {
    file_.close();
    if (!file_) return absl::ResourceExhaustedError("the copy cannot be written: disk full?");
    if (received_ != total_ || total_ == 0) {
      return InvalidField("total_bytes", absl::StrCat("received ", received_, " of ", total_));
    }
    if (sha_.Hex() != sha256_) return InvalidField("sha256", "is not that of the bytes");
    call_.record().request_bytes = received_;
    call_.record().resource = sha256_;
    return absl::OkStatus();
  }

  absl::Status Restore() {
    HOROPTER_RETURN_IF_ERROR(store_.Restore(folder_ + "/catalog.db"));
    HOROPTER_ASSIGN_OR_RETURN(const int objects, store_.catalog().CountObjects());
    response_->set_objects(objects);
    response_->set_catalog_generation(store_.Published()->snapshot.generation);
    return absl::OkStatus();
  }

  void End(const absl::Status& status) noexcept {
    std::error_code ignored;
    if (!folder_.empty()) std::filesystem::remove_all(folder_, ignored);
    Finish(call_.End(status));
  }

  void OnCancel() override {}  // the read that is under way fails
  void OnDone() override { delete this; }

  CatalogStore& store_;
  const CallGate gate_;
  CallRecord call_;
  v1::RestoreCatalogResponse* const response_;
  v1::RestoreCatalogRequest message_;
  std::string folder_;
  std::ofstream file_;
  Sha256 sha_;
  std::string sha256_;
  int64_t received_ = 0, total_ = 0;
};

}  // namespace

grpc::ServerWriteReactor<v1::VerifyCatalogResponse>* CatalogService::VerifyCatalog(
    grpc::CallbackServerContext* context, const v1::VerifyCatalogRequest* request) {
  auto* reactor = new VerifyReactor(store_, request->recompute(), gate_, context);
  reactor->Start();
  return reactor;
}

grpc::ServerWriteReactor<v1::BackupCatalogResponse>* CatalogService::BackupCatalog(
    grpc::CallbackServerContext* context, const v1::BackupCatalogRequest* request) {
  auto* reactor = new BackupReactor(store_.catalog(), shelf_, *request, gate_, context);
  reactor->Start();
  return reactor;
}

grpc::ServerReadReactor<v1::RestoreCatalogRequest>* CatalogService::RestoreCatalog(
    grpc::CallbackServerContext* context, v1::RestoreCatalogResponse* response) {
  auto* reactor = new RestoreReactor(store_, gate_, context, response);
  reactor->Start();
  return reactor;
}

}  // namespace horopter
