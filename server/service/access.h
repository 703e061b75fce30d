// Who may call what: bearer tokens and client certificates with roles.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"

namespace grpc {
class CallbackServerContext;
}

namespace horopter {

// What a caller may do. Teacher and observer may do what a robot may, an admin what all may.
enum class Role {
  kNone,
  kRobot,     // recognise and read
  kTeacher,   // recognise in such a way that stations learn from it
  kObserver,  // see what others asked and were answered, with their images
  kAdmin,     // change the catalog, verify it, back it up
};

// Whether a caller of this role may do what needs that one.
bool Covers(Role has, Role needed);

// Who calls. The name is that of the access file; empty where nobody has to say who he is.
struct Caller {
  std::string name;
  Role role = Role::kNone;
};

// The access file, one entry a line, `#` begins a comment:
//
//   ROLE  NAME  sha256:HEX [until=YYYY-MM-DD]    a token, by the SHA-256 of its text
//   ROLE  NAME  cert:COMMON_NAME                 a client certificate (mutual TLS)
//
// ROLE is robot, teacher, observer or admin, NAME [A-Za-z0-9_.-]{1,63}. A token ends with its day,
// UTC.
struct AccessList {
  struct Entry {
    Caller caller;
    absl::Time until = absl::InfiniteFuture();
  };
  std::map<std::string, Entry, std::less<>> by_hash;         // of the token, lower-case hex
  std::map<std::string, Entry, std::less<>> by_certificate;  // common name
};

// Errors: INVALID_ARGUMENT naming the line.
absl::StatusOr<AccessList> ParseAccessList(std::string_view text);

// Name of the caller whom an error of Access::Authorize refuses; empty: not known.
std::string CallerOf(const absl::Status& refusal);

struct AccessOptions {
  std::string file = {};    // access file; empty: every caller is an admin without a name
  bool admin_calls = true;  // false: calls that need an admin are refused, whoever asks
};

// Thread-safe. The file is read again when it has changed, within a second; one that cannot be read
// leaves what was known in force and is logged once.
class Access {
 public:
  // Errors: FAILED_PRECONDITION (the file cannot be read), INVALID_ARGUMENT (its contents).
  static absl::StatusOr<std::unique_ptr<Access>> Open(const AccessOptions& options);

  // Reads the file again now.
  void Reload();

  // Who calls, when he may do what needs the role. A token in the metadata (`authorization: Bearer
  // TOKEN`) goes before the certificate. Errors: UNAUTHENTICATED (neither, unknown, expired),
  // PERMISSION_DENIED (another role; admin calls are switched off), with whose it is as far as that
  // is known (CallerOf).
  absl::StatusOr<Caller> Authorize(const grpc::CallbackServerContext& context, Role needed);

  // The same with what the context holds; for tests.
  absl::StatusOr<Caller> Authorize(std::string_view authorization,
                                   std::string_view common_name,
                                   Role needed,
                                   absl::Time now);

 private:
  struct FileStamp {
    int64_t inode = 0, size = 0, seconds = 0, nanoseconds = 0;
    bool operator==(const FileStamp&) const = default;
  };
  explicit Access(AccessOptions options) : options_(std::move(options)) {}
  static FileStamp StampOf(const std::string& path);
  std::shared_ptr<const AccessList> Current();

  const AccessOptions options_;
  std::mutex mutex_;
  std::shared_ptr<const AccessList> list_;  // guarded by mutex_, as all below
  FileStamp stamp_;
  std::chrono::steady_clock::time_point looked_;
};

}  // namespace horopter
