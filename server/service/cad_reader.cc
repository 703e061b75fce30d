#include "server/service/cad_reader.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <spdlog/spdlog.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/cad_reader_exit.h"
#include "server/base/status_macros.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr char kProgram[] = "horopter-cad-reader";
constexpr int kLookMs = 20;
constexpr int kReadAgainMs = 2000;
constexpr size_t kMostNameBytes = 255;
constexpr int64_t kMostContentBytes = int64_t{128} << 20;
// Of a process that has used up its processor time on a busy machine, or that sleeps.
constexpr int kWallPerProcessorSecond = 10;

class Folder {
 public:
  explicit Folder(std::string path) : path_(std::move(path)) {}
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

 private:
  const std::string path_;
};

absl::Status CheckName(const std::string& name) {
  if (name.empty()) return InvalidField("file_name", "missing");
  if (name.size() > kMostNameBytes) return InvalidField("file_name", "has more than 255 bytes");
  const bool plain = std::all_of(name.begin(), name.end(), [](char c) {
    return static_cast<unsigned char>(c) >= 0x20 && c != 0x7F && c != '/';
  });
  if (!plain || name[0] == '.') {
    return InvalidField("file_name", "is no plain name: no folders, no control characters");
  }
  return absl::OkStatus();
}

// A process that is running. Killed with all that it has started when this goes.
class Child {
 public:
  Child(pid_t pid, int output) : pid_(pid), output_(output) {}
  ~Child() {
    close(output_);
    if (!ended_) Kill();
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  int output() const { return output_; }
  void Kill() {
    kill(-pid_, SIGKILL);
    while (waitpid(pid_, &status_, 0) < 0 && errno == EINTR) {
    }
    ended_ = true;
  }
  // Whether it has ended; then status() is that of waitpid.
  bool Ended() {
    if (!ended_ && waitpid(pid_, &status_, WNOHANG) == pid_) {
      ended_ = true;
      kill(-pid_, SIGKILL);  // whatever it may have left
    }
    return ended_;
  }
  int status() const { return status_; }

 private:
  const pid_t pid_;
  const int output_;
  int status_ = 0;
  bool ended_ = false;
};

// Starts the program with nothing of ours but a pipe, in the folder.
absl::StatusOr<std::unique_ptr<Child>> StartReader(const std::string& folder,
                                                   std::vector<std::string> arguments) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0) {
    return absl::ResourceExhaustedError(absl::StrCat("no pipe: ", std::strerror(errno)));
  }
  fcntl(ends[1], F_SETFL, 0);  // the program waits while we are slow
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  char language[] = "LC_ALL=C.UTF-8";
  char* environment[] = {language, nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, ends[1], 1);
  posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
  posix_spawn_file_actions_addclosefrom_np(&actions, 3);
  posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  sigset_t none, all;
  sigemptyset(&none);
  sigfillset(&all);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setsigdefault(&attributes, &all);
  posix_spawnattr_setpgroup(&attributes, 0);
  posix_spawnattr_setflags(&attributes,
                           POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
  pid_t pid = 0;
  const int failed = posix_spawn(&pid, argv[0], &actions, &attributes, argv.data(), environment);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  close(ends[1]);
  if (failed != 0) {
    close(ends[0]);
    return absl::InternalError(absl::StrCat(argv[0], ": ", std::strerror(failed)));
  }
  return std::make_unique<Child>(pid, ends[0]);
}

// What it writes until it ends.
absl::StatusOr<std::string> Collect(Child& child,
                                    int64_t most_bytes,
                                    Clock::time_point until,
                                    const StopRequested& stop) {
  std::string text;
  std::vector<char> piece(size_t{1} << 16);
  for (bool open = true; open || !child.Ended();) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    if (Clock::now() > until) return InvalidField("content", "takes too long to read");
    pollfd ready = {child.output(), POLLIN, 0};
    if (poll(&ready, open ? 1 : 0, kLookMs) <= 0) continue;
    const ssize_t got = read(child.output(), piece.data(), piece.size());
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) continue;
    open = got > 0;
    if (got > 0) text.append(piece.data(), static_cast<size_t>(got));
    if (static_cast<int64_t>(text.size()) > most_bytes) {
      return InvalidField("content", "makes a larger object than objects may be");
    }
  }
  return text;
}

}  // namespace

std::string FindCadReader() {
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  if (error) return "";
  for (const fs::path& path : {self.parent_path() / kProgram,
                               self.parent_path().parent_path() / "libexec/horopter" / kProgram}) {
    if (access(path.c_str(), X_OK) == 0) return path.string();
  }
  return "";
}

absl::Status Validate(const CadReaderOptions& options) {
  if (options.memory_mb < 64 || options.memory_mb > 1'000'000) {
    return absl::InvalidArgumentError(
        absl::StrCat("cad-memory-mb: ", options.memory_mb, " is outside 64..1000000"));
  }
  if (options.seconds < 1 || options.seconds > 3600) {
    return absl::InvalidArgumentError(
        absl::StrCat("cad-seconds: ", options.seconds, " is outside 1..3600"));
  }
  if (options.program.empty() || access(options.program.c_str(), X_OK) == 0) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrCat("cad-reader: ", options.program, ": ", std::strerror(errno)));
}

// It is started in another folder than ours.
CadReader::CadReader(CadReaderOptions options, int64_t most_bytes)
    : options_{.program = options.program.empty() ? "" : fs::absolute(options.program).string(),
               .memory_mb = options.memory_mb,
               .seconds = options.seconds},
      most_bytes_(most_bytes) {}

absl::StatusOr<v1::ImportObjectResponse> CadReader::Read(const v1::ImportObjectRequest& request,
                                                         const std::string& folder,
                                                         const StopRequested& stop) {
  if (options_.program.empty()) {
    return absl::UnimplementedError("this server reads no CAD files (cad-reader)");
  }
  HOROPTER_RETURN_IF_ERROR(CheckName(request.file_name()));
  if (request.content().empty()) return InvalidField("content", "missing");
  if (static_cast<int64_t>(request.content().size()) > kMostContentBytes) {
    return InvalidField("content", "has more than 128 MiB");
  }
  const std::unique_lock turn(one_at_a_time_, std::try_to_lock);
  if (!turn) return RetryLater("another CAD file is being read", kReadAgainMs);
  std::error_code error;
  fs::create_directory(folder, error);
  if (error) return absl::ResourceExhaustedError(absl::StrCat(folder, ": ", error.message()));
  const Folder removed(folder);
  {
    std::ofstream file(fs::path(folder) / request.file_name(), std::ios::binary);
    file.write(request.content().data(), static_cast<std::streamsize>(request.content().size()));
    file.close();
    if (!file) return absl::ResourceExhaustedError("the file cannot be put down: disk full?");
  }
  HOROPTER_ASSIGN_OR_RETURN(const std::unique_ptr<Child> child,
                            StartReader(folder,
                                        {options_.program,
                                         request.file_name(),
                                         request.unit(),
                                         absl::StrCat(options_.memory_mb),
                                         absl::StrCat(options_.seconds)}));
  const auto until =
      Clock::now() + std::chrono::seconds(int64_t{kWallPerProcessorSecond} * options_.seconds);
  HOROPTER_ASSIGN_OR_RETURN(const std::string text, Collect(*child, most_bytes_, until, stop));
  const int status = child->status();
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) {
    v1::ImportObjectResponse read;
    if (read.ParseFromString(text)) return read;
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) == kCadReaderRefused) {
    return InvalidField("content", text.substr(0, 1000));
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) == kCadReaderOutOfMemory) {
    return InvalidField(
        "content",
        absl::StrCat("takes more than the ", options_.memory_mb, " MB of memory that files may"));
  }
  if (WIFSIGNALED(status) && (WTERMSIG(status) == SIGXCPU || WTERMSIG(status) == SIGKILL)) {
    return InvalidField(
        "content",
        absl::StrCat(
            "takes more than the ", options_.seconds, " s of processor time that files may"));
  }
  const std::string how = WIFSIGNALED(status) ? absl::StrCat("signal ", WTERMSIG(status))
                                              : absl::StrCat("exit code ", WEXITSTATUS(status));
  spdlog::error("reading a CAD file of {} bytes ended with {}", request.content().size(), how);
  return InvalidField("content", absl::StrCat("cannot be read: reading it broke off (", how, ")"));
}

}  // namespace horopter
