// CAD files that clients send: read by another program, in a process of its own that has little
// memory, little time and nothing of ours.
#pragma once

#include <mutex>
#include <string>

#include "absl/status/statusor.h"
#include "horopter/v1/catalog.pb.h"
#include "server/base/stop_token.h"

namespace horopter {

struct CadReaderOptions {
  std::string program;   // horopter-cad-reader; empty: the server reads no CAD
  int memory_mb = 2048;  // of address space; more: larger files
  int seconds = 120;     // of processor time; more: more intricate files
};

// Errors: INVALID_ARGUMENT naming the option, also of a program that cannot be run.
absl::Status Validate(const CadReaderOptions& options);

// The program of that name where it is installed or built: beside the running one, or in
// ../libexec/horopter; empty: nowhere.
std::string FindCadReader();

// Thread-safe.
class CadReader {
 public:
  // `most_bytes`: of the object that comes of a file, as a message.
  CadReader(CadReaderOptions options, int64_t most_bytes);

  // The object of a file, without a name, and the warnings. The file is put into `folder`, which is
  // made for it and removed. Errors: INVALID_ARGUMENT (file_name, content; the message is for
  // whoever sent it), UNIMPLEMENTED (no program), RESOURCE_EXHAUSTED (another file is being read:
  // with a time to try again; disk full), CANCELLED.
  absl::StatusOr<v1::ImportObjectResponse> Read(const v1::ImportObjectRequest& request,
                                                const std::string& folder,
                                                const StopRequested& stop);

 private:
  const CadReaderOptions options_;
  const int64_t most_bytes_;
  std::mutex one_at_a_time_;
};

}  // namespace horopter
