// The calls of the C++ client that stream.
#include <atomic>
#include <chrono>
#include <fstream>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/api_stubs.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kRestoreChunkBytes = size_t{1} << 20;

void SetDeadline(grpc::ClientContext& context, double timeout_s) {
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::milliseconds(static_cast<int64_t>(timeout_s * 1e3)));
}

// Cancels a call when the program is interrupted: reads and writes of a stream wait for the server
// as long as it likes.
class CancelOnInterrupt {
 public:
  CancelOnInterrupt(grpc::ClientContext* context, std::function<bool()> interrupted)
      : interrupted_(std::move(interrupted)) {
    if (!interrupted_) return;
    watch_ = std::thread([this, context] {
      while (!over_ && !interrupted_()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
      }
      if (!over_) context->TryCancel();
    });
  }
  ~CancelOnInterrupt() {
    over_ = true;
    if (watch_.joinable()) watch_.join();
  }
  CancelOnInterrupt(const CancelOnInterrupt&) = delete;
  CancelOnInterrupt& operator=(const CancelOnInterrupt&) = delete;

  // The call's status, said to be interrupted where that ended it.
  absl::Status Of(absl::Status status) const {
    const bool ours = absl::IsCancelled(status) && interrupted_ && interrupted_();
    return ours ? absl::CancelledError("interrupted") : status;
  }

 private:
  const std::function<bool()> interrupted_;
  std::atomic<bool> over_ = false;
  std::thread watch_;
};

// Calls `visit` with the file's bytes, piece by piece. Errors: NOT_FOUND, those of `visit`.
absl::Status ReadInPieces(const std::string& path,
                          const std::function<absl::Status(std::string piece)>& visit) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be read"));
  while (file) {
    std::string piece(kRestoreChunkBytes, '\0');
    file.read(piece.data(), static_cast<std::streamsize>(piece.size()));
    piece.resize(static_cast<size_t>(file.gcount()));
    if (!piece.empty()) HOROPTER_RETURN_IF_ERROR(visit(std::move(piece)));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<v1::VerifyCatalogResponse> HoropterClient::VerifyCatalog(
    bool recompute, const std::function<void(double)>& progress) {
  HOROPTER_RETURN_IF_ERROR(stubs_->ready);
  grpc::ClientContext context;
  SetDeadline(context, options_.timeout_s);
  v1::VerifyCatalogRequest request;
  request.set_recompute(recompute);
  const CancelOnInterrupt watch(&context, options_.interrupted);
  const auto reader = stubs_->catalog->VerifyCatalog(&context, request);
  v1::VerifyCatalogResponse all, message;
  while (reader->Read(&message)) {
    all.MergeFrom(message);
    if (progress) progress(all.progress());
  }
  HOROPTER_RETURN_IF_ERROR(watch.Of(ToAbsl(reader->Finish(), context, address_)));
  return all;
}

absl::Status HoropterClient::BackupCatalog(
    const std::string& backup_id,
    int64_t offset,
    const std::function<absl::Status(const v1::BackupCatalogResponse& piece)>& write) {
  HOROPTER_RETURN_IF_ERROR(stubs_->ready);
  grpc::ClientContext context;
  SetDeadline(context, options_.timeout_s);
  v1::BackupCatalogRequest request;
  request.set_backup_id(backup_id);
  request.set_offset(offset);
  const CancelOnInterrupt watch(&context, options_.interrupted);
  const auto reader = stubs_->catalog->BackupCatalog(&context, request);
  v1::BackupCatalogResponse piece;
  while (reader->Read(&piece)) {
    if (const absl::Status status = write(piece); !status.ok()) {
      context.TryCancel();
      reader->Finish();
      return status;
    }
  }
  return watch.Of(ToAbsl(reader->Finish(), context, address_));
}

absl::StatusOr<v1::RestoreCatalogResponse> HoropterClient::RestoreCatalog(const std::string& path) {
  HOROPTER_RETURN_IF_ERROR(stubs_->ready);
  Sha256 sha;
  int64_t bytes = 0;
  HOROPTER_RETURN_IF_ERROR(ReadInPieces(path, [&](const std::string& piece) {
    sha.Add(piece);
    bytes += static_cast<int64_t>(piece.size());
    return absl::OkStatus();
  }));
  grpc::ClientContext context;
  SetDeadline(context, options_.timeout_s);
  v1::RestoreCatalogResponse response;
  const CancelOnInterrupt watch(&context, options_.interrupted);
  const auto writer = stubs_->catalog->RestoreCatalog(&context, &response);
  bool first = true;
  const absl::Status sent = ReadInPieces(path, [&](std::string piece) {
    v1::RestoreCatalogRequest message;
    if (std::exchange(first, false)) {
      message.set_total_bytes(bytes);
      message.set_sha256(sha.Hex());
    }
    message.set_chunk(std::move(piece));
    // The server's reason comes with the status.
    return writer->Write(message) ? absl::OkStatus() : absl::AbortedError("refused");
  });
  writer->WritesDone();
  HOROPTER_RETURN_IF_ERROR(watch.Of(ToAbsl(writer->Finish(), context, address_)));
  HOROPTER_RETURN_IF_ERROR(sent);
  return response;
}

}  // namespace horopter
