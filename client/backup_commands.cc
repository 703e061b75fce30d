// Copies of the catalog: backup, also in several goes, and restoring.
#include <chrono>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "absl/strings/str_cat.h"
#include "client/bop_results.h"
#include "client/commands.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/progress.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

constexpr int kTries = 5;
constexpr auto kBetweenTries = std::chrono::seconds(1);

// A file that is being written, with a note beside it that says of which copy it is, so that
// another run of the program can go on.
class UnfinishedBackup {
 public:
  explicit UnfinishedBackup(const std::string& path)
      : path_(path), file_name_(path + ".unfinished"), note_name_(path + ".unfinished.id") {
    std::ifstream note(note_name_);
    std::error_code error;
    if (note >> id_) offset_ = static_cast<int64_t>(fs::file_size(file_name_, error));
    if (id_.empty() || error) Restart();
  }

  const std::string& id() const { return id_; }
  int64_t offset() const { return offset_; }

  void Restart() {
    out_.close();
    id_.clear();
    offset_ = 0;
    std::error_code ignored;
    fs::remove(file_name_, ignored);
    fs::remove(note_name_, ignored);
  }

  absl::Status Append(const v1::BackupCatalogResponse& piece) {
    if (!out_.is_open()) {
      out_.open(file_name_, std::ios::binary | std::ios::app);
      id_ = piece.backup_id();
      std::ofstream(note_name_) << id_ << "\n";
    }
    out_.write(piece.chunk().data(), static_cast<std::streamsize>(piece.chunk().size()));
    out_.flush();
    if (!out_) return absl::ResourceExhaustedError(absl::StrCat(path_, ": cannot be written"));
    offset_ += static_cast<int64_t>(piece.chunk().size());
    total_ = piece.total_bytes();
    sha256_ = piece.sha256();
    return absl::OkStatus();
  }

  // Checks the whole and gives it its name. Errors: DATA_LOSS: the bytes are not the server's.
  absl::Status Finish() {
    out_.close();
    Sha256 sha;
    std::ifstream in(file_name_, std::ios::binary);
    std::string piece(size_t{1} << 20, '\0');
    while (in.read(piece.data(), static_cast<std::streamsize>(piece.size())) || in.gcount() > 0) {
      sha.Add(std::string_view(piece).substr(0, static_cast<size_t>(in.gcount())));
    }
    if (offset_ != total_ || sha.Hex() != sha256_) {
      Restart();
      return absl::DataLossError(absl::StrCat(path_, ": what came is not what the server sent"));
    }
    std::error_code error;
    fs::rename(file_name_, path_, error);
    if (error) return absl::FailedPreconditionError(absl::StrCat(path_, ": ", error.message()));
    fs::remove(note_name_, error);
    return absl::OkStatus();
  }

  const std::string& sha256() const { return sha256_; }

 private:
  const std::string path_, file_name_, note_name_;
  std::ofstream out_;
  std::string id_, sha256_;
  int64_t offset_ = 0, total_ = 0;
};

}  // namespace

absl::Status CatalogBackup(HoropterClient& client, const std::string& path) {
  std::error_code error;
  if (fs::exists(path, error)) return absl::AlreadyExistsError(absl::StrCat(path, ": is there"));
  HOROPTER_RETURN_IF_ERROR(CheckCanBeWritten(path));
  UnfinishedBackup backup(path);
  Progress progress("MB", 0);
  absl::Status status;
  for (int tries = 0; tries < kTries; ++tries) {
    status = client.BackupCatalog(
        backup.id(), backup.offset(), [&](const v1::BackupCatalogResponse& piece) {
          HOROPTER_RETURN_IF_ERROR(backup.Append(piece));
          progress.Update(backup.offset() / 1'000'000);
          return Interrupted() ? absl::CancelledError("interrupted; the same command goes on")
                               : absl::OkStatus();
        });
    if (absl::IsNotFound(status)) {  // the server was started again, or others made copies
      backup.Restart();
      continue;
    }
    if (!absl::IsUnavailable(status) || backup.offset() == 0) break;
    std::this_thread::sleep_for(kBetweenTries);
  }
  if (status.ok()) status = backup.Finish();
  progress.Clear();
  // Nothing came of it: no rest either.
  if (!status.ok() && backup.offset() == 0) backup.Restart();
  HOROPTER_RETURN_IF_ERROR(status);
  Say("%s: %lld bytes, SHA-256 %s\n",
      path.c_str(),
      static_cast<long long>(backup.offset()),
      backup.sha256().c_str());
  SayJson({{"file", path}, {"bytes", backup.offset()}, {"sha256", backup.sha256()}});
  return absl::OkStatus();
}

absl::Status CatalogRestore(HoropterClient& client, const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::RestoreCatalogResponse restored, client.RestoreCatalog(path));
  Say("%d objects restored; what was there before is beside the catalog's file\n",
      static_cast<int>(restored.objects()));
  SayJson({{"objects", restored.objects()}, {"catalog_generation", restored.catalog_generation()}});
  return absl::OkStatus();
}

}  // namespace horopter
