#include "server/service/access.h"

#include <grpcpp/server_context.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include <algorithm>
#include <fstream>
#include <sstream>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/cord.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr auto kLookAgain = std::chrono::seconds(1);
constexpr char kBearer[] = "bearer ";
constexpr size_t kHashDigits = 64;
constexpr char kCallerPayload[] = "horopter/caller";

absl::Status RefusalOfCaller(absl::Status status, const std::string& caller) {
  if (!caller.empty()) status.SetPayload(kCallerPayload, absl::Cord(caller));
  return status;
}

absl::Status BadLine(int line, const char* what) {
  return absl::InvalidArgumentError(absl::StrCat("access file, line ", line, ": ", what));
}

bool IsName(std::string_view name) {
  return !name.empty() && name.size() <= 63 && std::all_of(name.begin(), name.end(), [](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '.' || c == '-';
  });
}

// The end of the day.
absl::StatusOr<absl::Time> ParseUntil(const std::string& word, int line) {
  absl::Time day;
  std::string error;
  if (!absl::StartsWith(word, "until=") ||
      !absl::ParseTime("%Y-%m-%d", word.substr(6), &day, &error)) {
    return BadLine(line, "after the token comes nothing but until=YYYY-MM-DD");
  }
  return day + absl::Hours(24);
}

absl::Status AddEntry(const std::vector<std::string>& words, int line, AccessList* list) {
  if (words.size() < 3) return BadLine(line, "expected ROLE NAME sha256:HEX or cert:COMMON_NAME");
  AccessList::Entry entry;
  entry.caller.name = words[1];
  if (words[0] == "robot") entry.caller.role = Role::kRobot;
  if (words[0] == "teacher") entry.caller.role = Role::kTeacher;
  if (words[0] == "observer") entry.caller.role = Role::kObserver;
  if (words[0] == "admin") entry.caller.role = Role::kAdmin;
  if (entry.caller.role == Role::kNone) {
    return BadLine(line, "the role is robot, teacher, observer or admin");
  }
  if (!IsName(entry.caller.name)) return BadLine(line, "the name is [A-Za-z0-9_.-]{1,63}");
  if (absl::StartsWith(words[2], "cert:") && words[2].size() > 5) {
    if (words.size() > 3) return BadLine(line, "a certificate says itself until when it is good");
    const bool added = list->by_certificate.emplace(words[2].substr(5), entry).second;
    return added ? absl::OkStatus() : BadLine(line, "the certificate is there already");
  }
  if (!absl::StartsWith(words[2], "sha256:")) {
    return BadLine(line, "expected sha256:HEX or cert:COMMON_NAME");
  }
  const std::string hash = words[2].substr(7);
  if (hash.size() != kHashDigits || hash.find_first_not_of("0123456789abcdef") != hash.npos) {
    return BadLine(line, "a SHA-256 has 64 lower-case hex digits");
  }
  if (words.size() > 4) return BadLine(line, "too many words");
  if (words.size() == 4) {
    HOROPTER_ASSIGN_OR_RETURN(entry.until, ParseUntil(words[3], line));
  }
  const bool added = list->by_hash.emplace(hash, entry).second;
  return added ? absl::OkStatus() : BadLine(line, "the token is there already");
}

absl::StatusOr<std::shared_ptr<const AccessList>> ReadList(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) return absl::FailedPreconditionError(absl::StrCat(path, ": cannot be read"));
  HOROPTER_ASSIGN_OR_RETURN(AccessList list, ParseAccessList(text.str()));
  return std::make_shared<const AccessList>(std::move(list));
}

// The token of `Bearer TOKEN`; empty: none.
std::string_view TokenOf(std::string_view authorization) {
  constexpr size_t kPrefix = sizeof(kBearer) - 1;
  const bool bearer =
      authorization.size() > kPrefix &&
      std::equal(kBearer, kBearer + kPrefix, authorization.begin(), [](char a, char b) {
        return a == absl::ascii_tolower(static_cast<unsigned char>(b));
      });
  return bearer ? authorization.substr(kPrefix) : std::string_view();
}

absl::StatusOr<Caller> FindCaller(const AccessList& list,
                                  std::string_view authorization,
                                  std::string_view common_name,
                                  absl::Time now) {
  if (!authorization.empty()) {
    // Looked up by its hash: what the comparison takes says nothing of the token.
    const auto found = list.by_hash.find(Sha256Hex(TokenOf(authorization)));
    if (found == list.by_hash.end()) return absl::UnauthenticatedError("the token is not known");
    if (now >= found->second.until) {
      return RefusalOfCaller(absl::UnauthenticatedError("the token has expired"),
                             found->second.caller.name);
    }
    return found->second.caller;
  }
  const auto found = list.by_certificate.find(common_name);
  if (!common_name.empty() && found != list.by_certificate.end()) return found->second.caller;
  return absl::UnauthenticatedError("a bearer token is required");
}

const char* NameOfRole(Role role) {
  switch (role) {
    case Role::kNone:
      return "none";
    case Role::kRobot:
      return "robot";
    case Role::kTeacher:
      return "teacher";
    case Role::kObserver:
      return "observer";
    case Role::kAdmin:
      return "admin";
  }
  return "";
}

}  // namespace

bool Covers(Role has, Role needed) {
  if (has == Role::kAdmin || has == needed || needed == Role::kNone) return true;
  return needed == Role::kRobot && has != Role::kNone;
}

absl::StatusOr<AccessList> ParseAccessList(std::string_view text) {
  AccessList list;
  int number = 0;
  for (const absl::string_view whole :
       absl::StrSplit(absl::string_view(text.data(), text.size()), '\n')) {
    ++number;
    const absl::string_view line = whole.substr(0, whole.find('#'));
    const std::vector<std::string> words =
        absl::StrSplit(line, absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
    if (!words.empty()) HOROPTER_RETURN_IF_ERROR(AddEntry(words, number, &list));
  }
  return list;
}

std::string CallerOf(const absl::Status& refusal) {
  const auto name = refusal.GetPayload(kCallerPayload);
  return name ? std::string(*name) : "";
}

absl::StatusOr<std::unique_ptr<Access>> Access::Open(const AccessOptions& options) {
  std::unique_ptr<Access> access(new Access(options));
  if (options.file.empty()) return access;
  access->stamp_ = StampOf(options.file);
  HOROPTER_ASSIGN_OR_RETURN(access->list_, ReadList(options.file));
  access->looked_ = std::chrono::steady_clock::now();
  return access;
}

Access::FileStamp Access::StampOf(const std::string& path) {
  struct stat info = {};
  if (::stat(path.c_str(), &info) != 0) return {};
  return {
      static_cast<int64_t>(info.st_ino), info.st_size, info.st_mtim.tv_sec, info.st_mtim.tv_nsec};
}

std::shared_ptr<const AccessList> Access::Current() {
  const std::lock_guard lock(mutex_);
  const auto now = std::chrono::steady_clock::now();
  if (now - looked_ < kLookAgain) return list_;
  looked_ = now;
  const FileStamp stamp = StampOf(options_.file);
  if (stamp == stamp_) return list_;
  stamp_ = stamp;
  auto read = ReadList(options_.file);
  if (read.ok()) {
    list_ = *std::move(read);
    spdlog::info("access file read again: {} tokens, {} certificates",
                 list_->by_hash.size(),
                 list_->by_certificate.size());
  } else {
    spdlog::error("the access file as it was stays in force: {}",
                  std::string(read.status().message()));
  }
  return list_;
}

void Access::Reload() {
  if (options_.file.empty()) return;
  {
    const std::lock_guard lock(mutex_);
    looked_ = {};
    stamp_ = {};
  }
  Current();
}

absl::StatusOr<Caller> Access::Authorize(std::string_view authorization,
                                         std::string_view common_name,
                                         Role needed,
                                         absl::Time now) {
  if (needed == Role::kAdmin && !options_.admin_calls) {
    const absl::Status closed =
        absl::PermissionDeniedError("this listener does not serve calls that need an admin");
    if (options_.file.empty()) return closed;
    const absl::StatusOr<Caller> who = FindCaller(*Current(), authorization, common_name, now);
    return RefusalOfCaller(closed, who.ok() ? who->name : CallerOf(who.status()));
  }
  if (options_.file.empty()) return Caller{"", Role::kAdmin};
  HOROPTER_ASSIGN_OR_RETURN(Caller caller, FindCaller(*Current(), authorization, common_name, now));
  if (!Covers(caller.role, needed)) {
    const std::string why = absl::StrCat("'",
                                         caller.name,
                                         "' has the role ",
                                         NameOfRole(caller.role),
                                         ", the call needs ",
                                         needed == Role::kObserver ? "observer or " : "",
                                         "admin");
    return RefusalOfCaller(absl::PermissionDeniedError(why), caller.name);
  }
  return caller;
}

absl::StatusOr<Caller> Access::Authorize(const grpc::CallbackServerContext& context, Role needed) {
  std::string_view authorization;
  const auto& metadata = context.client_metadata();
  if (const auto found = metadata.find("authorization"); found != metadata.end()) {
    authorization = {found->second.data(), found->second.size()};
  }
  std::string common_name;
  if (const auto peer = context.auth_context(); peer != nullptr && peer->IsPeerAuthenticated()) {
    const auto names = peer->FindPropertyValues("x509_common_name");
    if (names.size() == 1) common_name.assign(names[0].data(), names[0].size());
  }
  return Authorize(authorization, common_name, needed, absl::Now());
}

}  // namespace horopter
